"""The commands end to end on a small skirt: files, report, pictures, and the exact check."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
from command_scenes import small_skirt

from dress_jax.application.check import check_result
from dress_jax.io.images import load_targets
from dress_jax.io.meshes import read_garment_obj, write_garment_obj
from dress_jax.io.patterns import load_pattern, save_pattern
from dress_jax.io.results import read_result, write_state
from dress_jax.pattern import scaled
from dress_jax.render.cameras import cameras_from_dict

FILES = (
    "garment.obj",
    "body.obj",
    "garment.glb",
    "preview.png",
    "pattern.json",
    "pattern.svg",
    "drape.h5",
    "report.json",
)
REPORT_KEYS = {
    "vertices",
    "faces",
    "panels",
    "seams",
    "max_seam_gap_m",
    "intersections",
    "min_distance_m",
    "converged",
    "residual",
    "certificate",
    "newton_iterations",
    "max_strain",
    "median_strain",
    "strain_p99",
    "seconds",
    "peak_memory_mb",
    "versions",
}
# A loose skirt hangs by its own weight only: cotton stretches far less than this in the middle.
LARGEST_MEDIAN_STRAIN = 0.05


def test_drape_writes_every_file(draped):
    folder, result = draped
    for name in FILES:
        assert (folder / name).stat().st_size > 0, name
    assert {path.name for path in folder.iterdir()} == set(FILES)
    assert str(folder) in result.stdout.replace("\n", "")


def test_the_report_holds_what_it_must(draped):
    report = json.loads((draped[0] / "report.json").read_text())
    assert set(report) >= REPORT_KEYS
    assert report["converged"] is True
    assert report["intersections"] == {"self": 0, "body": 0}
    assert (report["panels"], report["seams"]) == (2, 4)
    assert report["max_seam_gap_m"] == 0.0
    assert 0.0 < report["min_distance_m"] < 0.05
    certificate = report["certificate"]
    assert certificate["stable"] is (certificate["smallest_eigenvalue"] > 0.0)
    # A few grams of cloth weigh far more than what is out of balance on any vertex.
    assert 0.0 <= certificate["residual"] < 1e-3
    assert 0.0 < report["median_strain"] < LARGEST_MEDIAN_STRAIN
    assert report["median_strain"] <= report["strain_p99"] <= report["max_strain"]
    assert set(report["seconds"]) == {"compile", "run"}
    assert min(report["seconds"].values()) >= 0.0
    assert report["versions"]["jax"]


def test_the_mesh_is_welded_textured_and_grouped_by_panel(draped, inputs):
    folder, _ = draped
    state, pattern = read_result(folder)
    written = read_garment_obj(folder / "garment.obj")
    assert written.panels == tuple(panel.name for panel in pattern.panels)
    np.testing.assert_array_equal(written.vertices, state.garment.vertices)
    np.testing.assert_array_equal(written.rest_positions, state.garment.rest_positions)
    assert len(written.rest_positions) > len(written.vertices)  # seams are welded
    original = load_pattern(inputs / "skirt.json")
    for kept, first in zip(pattern.panels, original.panels, strict=True):
        np.testing.assert_allclose(kept.vertices, first.vertices, atol=1e-15)


def test_check_passes_a_sound_result(draped, run):
    result = run("check", draped[0])
    assert result.exit_code == 0, result.output
    assert "intersection-free" in result.output


def test_check_finds_intersections_in_the_exact_state(draped, run, tmp_path):
    folder = shutil.copytree(draped[0], tmp_path / "result")
    state, _ = read_result(folder)
    moved = state.garment.vertices + np.array([0.08, 0.0, 0.0])  # into the body at one side
    garment = dataclasses.replace(state.garment, vertices=moved)
    write_state(folder / "drape.h5", dataclasses.replace(state, garment=garment))
    assert run("check", folder).exit_code == 3
    exact, written = check_result(folder)
    assert exact.body_intersections > 0
    assert exact.self_intersections == 0
    assert written.good


def test_check_finds_intersections_in_the_written_mesh(draped, run, tmp_path):
    folder = shutil.copytree(draped[0], tmp_path / "result")
    garment = read_garment_obj(folder / "garment.obj")
    vertices = garment.vertices.copy()
    low = np.argmin(vertices[:, 1])
    opposite = vertices[low] * np.array([-1.5, 1.0, -1.5])  # through the other side of the skirt
    vertices[low] = opposite
    write_garment_obj(folder / "garment.obj", dataclasses.replace(garment, vertices=vertices))
    assert run("check", folder).exit_code == 3
    exact, written = check_result(folder)
    assert exact.good
    assert not written.intersection_free


def test_check_finds_an_open_seam(draped, run, tmp_path):
    folder = shutil.copytree(draped[0], tmp_path / "result")
    state, _ = read_result(folder)
    garment = read_garment_obj(folder / "garment.obj")
    split = state.weld_map[state.seam_vertices[0, 0]]
    faces, rest_faces = garment.faces.copy(), garment.rest_faces
    faces[rest_faces == state.seam_vertices[0, 1]] = len(garment.vertices)
    gap = np.array([0.0, 1e-6, 0.0])
    vertices = np.concatenate([garment.vertices, garment.vertices[[split]] + gap])
    apart = dataclasses.replace(garment, vertices=vertices, faces=faces)
    write_garment_obj(folder / "garment.obj", apart)
    assert run("check", folder).exit_code == 3
    exact, written = check_result(folder)
    assert exact.open_seams == 0
    assert written.open_seams >= 1
    assert written.seam_gap == pytest.approx(1e-6, rel=1e-6)


def test_render_writes_a_target_folder(draped, run, tmp_path):
    targets = tmp_path / "targets"
    result = run("render", draped[0], "--views", 4, "--size", 48, "--out", targets)
    assert result.exit_code == 0, result.output
    names = ["000.png", "090.png", "180.png", "270.png"]
    for kind in ("rgb", "normal", "mask"):
        assert sorted(path.name for path in (targets / kind).iterdir()) == names
    loaded = load_targets(targets)
    assert loaded.azimuths == (0, 90, 180, 270)
    assert loaded.mask is not None and loaded.rgb is not None and loaded.normal is not None
    assert loaded.mask.shape == (4, 48, 48)
    assert (loaded.mask > 0.5).any(axis=(1, 2)).all()
    np.testing.assert_allclose(loaded.rgb[:, 0, 0], 1.0, atol=0.01)  # white corners
    # MagicMan's 90 degrees look from the wearer's right.
    cameras = cameras_from_dict({"cameras": list(loaded.cameras)})
    np.testing.assert_allclose(cameras[1].rotation[2], [-1.0, 0.0, 0.0], atol=1e-12)
    front = loaded.normal[0][loaded.mask[0] > 0.99]
    assert front[:, 2].mean() > 0.5


def test_a_drape_that_stops_early_is_written_and_told(inputs, run, tmp_path):
    out = tmp_path / "early"
    result = run(
        *("drape", inputs / "skirt.json", "--body", inputs / "body.obj"),
        *("--edge-length", 0.06, "--newton-limit", 1, "--out", out),
    )
    assert result.exit_code == 3, result.output
    report = json.loads((out / "report.json").read_text())
    assert report["converged"] is False
    assert "iteration limit" in report["result"]
    assert report["intersections"] == {"self": 0, "body": 0}


@pytest.mark.slow
def test_a_garment_of_two_fabrics_that_tells_warp_from_weft(inputs, run, tmp_path):
    """The front of the skirt is of heavy denim: more mass hangs in front."""
    result = run(
        *("drape", inputs / "skirt.json", "--body", inputs / "body.obj"),
        *("--edge-length", 0.06, "--fabric", "silk", "--fabric-of", "*front*=denim"),
        *("--membrane", "orthotropic", "--out", tmp_path),
    )
    assert result.exit_code == 0, result.output
    settings = json.loads((tmp_path / "report.json").read_text())["settings"]
    assert settings["fabric"] == "silk"
    assert settings["panel_fabrics"] == [["*front*", "denim"]]
    assert settings["membrane"] == "orthotropic"


@pytest.mark.slow
def test_a_skirt_that_is_too_narrow_is_put_on_all_the_same(inputs, run, draped, tmp_path):
    """It is tight on the hips, where it is placed, and slides up to the waist."""
    save_pattern(scaled(small_skirt(), {"*": (0.72, 1.0)}), tmp_path / "narrow.json")
    result = run(
        *("drape", tmp_path / "narrow.json", "--body", inputs / "body.obj"),
        *("--edge-length", 0.06, "--out", tmp_path / "narrow"),
    )
    assert result.exit_code == 0, result.output
    narrow, fitting = (
        json.loads((folder / "report.json").read_text())
        for folder in (tmp_path / "narrow", draped[0])
    )
    assert fitting["tight_panels"] == {}
    assert narrow["max_strain"] > fitting["max_strain"]
    upper = [
        read_garment_obj(folder / "garment.obj").vertices[:, 1].max()
        for folder in (tmp_path / "narrow", draped[0])
    ]
    assert upper[0] > upper[1] + 0.01


@pytest.mark.slow
def test_a_strain_limit_and_friction(inputs, run, tmp_path):
    """Both act in the drape, are kept with it, and bad limits are refused."""
    drape = ("drape", inputs / "skirt.json", "--body", inputs / "body.obj", "--edge-length", 0.06)
    result = run(*drape, "--strain-limit", 1.2, "--friction", "--out", tmp_path / "limited")
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "limited" / "report.json").read_text())
    assert report["settings"]["strain_limit"] == 1.2
    assert report["settings"]["friction"] is True
    assert report["max_strain"] < 0.2
    result = run(*drape, "--strain-limit", 0.9, "--out", tmp_path / "refused")
    assert result.exit_code == 2
    assert "strain limit" in result.output
    assert not (tmp_path / "refused").exists()


@pytest.mark.slow
def test_friction_acts_where_it_is_asked_for(inputs, run, draped, tmp_path):
    result = run(
        *("drape", inputs / "skirt.json", "--body", inputs / "body.obj"),
        *("--edge-length", 0.06, "--friction", "--out", tmp_path),
    )
    assert result.exit_code == 0, result.output
    held, free = (
        read_garment_obj(folder / "garment.obj").vertices for folder in (tmp_path, draped[0])
    )
    # Runs are equal bit by bit; this skirt hardly slides.
    assert np.max(np.abs(held - free)) > 1e-6
