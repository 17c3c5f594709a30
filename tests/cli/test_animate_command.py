"""The command `animate` (S15): frames free of intersections, files, exact resume, bad input."""

import dataclasses
import json

import numpy as np
import pytest
from moving_body import write_moving_body

from dress_jax.application.animate import WORK, AnimateOptions, animate, slip_along_body
from dress_jax.application.moving_body import MotionOptions
from dress_jax.geometry.intersection import count_intersections
from dress_jax.io.point_caches import read_pc2
from dress_jax.io.results import read_state
from dress_jax.io.trajectory import read_trajectory

FRAMES = 6


@pytest.fixture(scope="module")
def skirt(inputs, run, tmp_path_factory):
    """A skirt on a body that can move."""
    folder = tmp_path_factory.mktemp("moving")
    body = write_moving_body(folder / "body.npz")
    result = run(
        *("drape", inputs / "skirt.json", "--body", body, "--edge-length", 0.06),
        *("--out", folder / "skirt"),
    )
    assert result.exit_code == 0, result.output
    return folder / "skirt"


@pytest.fixture(scope="module")
def swayed(skirt, run, tmp_path_factory):
    """An animation of the skirt, and what the command printed."""
    folder = tmp_path_factory.mktemp("animated") / "sway"
    options = ("--motion", "sway", "--frames", FRAMES, "--ease", 0.1, "--preview-size", 32)
    result = run("animate", skirt, *options, "--out", folder)
    assert result.exit_code == 0, result.output
    return folder, result


@pytest.mark.slow
def test_every_frame_is_free_of_intersections(skirt, swayed):
    """Counted again from the file, cloth with itself and with the body of its frame."""
    folder, result = swayed
    times, objects = read_trajectory(folder / "trajectory.h5")
    (cloth, faces), (body, body_faces) = objects["cloth"], objects["body"]
    np.testing.assert_allclose(times, np.arange(FRAMES) / 30.0)
    assert cloth.shape[0] == body.shape[0] == FRAMES
    for x, b in zip(cloth, body, strict=True):
        found = count_intersections(x, faces, b, body_faces)
        assert (found.self, found.body) == (0, 0)
    state = read_state(skirt / "drape.h5")
    np.testing.assert_array_equal(cloth[0], state.garment.vertices)
    np.testing.assert_array_equal(body[0], state.body_vertices)
    assert np.abs(body[-1] - body[0]).max() > 0.003
    assert "0 self, 0 body" in result.output


@pytest.mark.slow
def test_the_waist_rides_on_the_body(skirt, swayed):
    folder, result = swayed
    report = json.loads((folder / "report.json").read_text())
    state = read_state(skirt / "drape.h5")
    assert report["waist"] == {"held_by": "pins that ride on the body", "vertices": len(state.pins)}
    assert len(state.pins) > 0
    assert "pins that ride" in result.output
    (row,) = report["slip"]
    assert not row["slipped"]
    assert row["median_m"] < 0.02


@pytest.mark.slow
def test_the_report_has_a_row_a_frame(swayed):
    report = json.loads((swayed[0] / "report.json").read_text())
    assert report["frames"] == FRAMES
    for values in report["per_frame"].values():
        assert len(values) == FRAMES - 1
    assert report["steps"] >= FRAMES - 1
    assert report["newton_iterations"] == sum(report["per_frame"]["newton_iterations"]) > 0
    assert report["body"]["frames"] == FRAMES - 1
    assert report["intersections"] == {"self": 0, "body": 0}


@pytest.mark.slow
def test_all_files_are_there_and_agree(swayed):
    folder = swayed[0]
    report = json.loads((folder / "report.json").read_text())
    names = {path.name for path in folder.iterdir()}
    assert names == {*report["files"], "report.json"}
    assert {"animation.glb", "garment.pc2", "garment.mdd", "trajectory.h5"} <= names
    _, objects = read_trajectory(folder / "trajectory.h5")
    cache = read_pc2(folder / "garment.pc2")
    np.testing.assert_allclose(cache.frames, objects["cloth"][0], atol=1e-6)


class Stop(Exception):
    """Raised in the middle of a run."""


@pytest.mark.slow
def test_a_resumed_run_repeats_an_uninterrupted_one_bit_by_bit(skirt, swayed, run, tmp_path):
    def stop(stage, done, total, *, loss=None):
        if stage == "animate" and done == 3:
            raise Stop

    state = read_state(skirt / "drape.h5")
    options = AnimateOptions(motion=MotionOptions(frames=FRAMES, ease=0.1))
    with pytest.raises(Stop):
        animate(state, "sway", tmp_path / "out", options=options, progress=stop)
    assert len(list((tmp_path / "out" / WORK).glob("frame_*.h5"))) == 3
    result = run(
        *("animate", skirt, "--motion", "sway", "--frames", FRAMES, "--ease", 0.1),
        *("--preview-size", 0, "--resume", "--out", tmp_path / "out"),
    )
    assert result.exit_code == 0, result.output
    found = read_trajectory(tmp_path / "out" / "trajectory.h5")[1]
    whole = read_trajectory(swayed[0] / "trajectory.h5")[1]
    for name in ("cloth", "body"):
        np.testing.assert_array_equal(found[name][0], whole[name][0])
    assert not (tmp_path / "out" / WORK).exists()


def test_other_inputs_are_not_resumed(skirt, run, tmp_path):
    def stop(stage, done, total, *, loss=None):
        if stage == "animate":
            raise Stop

    state = read_state(skirt / "drape.h5")
    options = AnimateOptions(motion=MotionOptions(frames=3))
    with pytest.raises(Stop):
        animate(state, "sway", tmp_path / "out", options=options, progress=stop)
    result = run(
        *("animate", skirt, "--motion", "turn", "--frames", 3, "--no-friction"),
        *("--resume", "--out", tmp_path / "out"),
    )
    assert result.exit_code == 2
    assert "another motion and options" in result.stderr


def test_nothing_to_resume_is_said(skirt, run, tmp_path):
    result = run("animate", skirt, "--frames", 3, "--resume", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "leave --resume out" in result.stderr


def test_a_static_mesh_cannot_move(draped, run, tmp_path):
    result = run("animate", draped[0], "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "a static mesh cannot move" in result.stderr


def test_another_body_under_the_old_name_is_refused(skirt, run, tmp_path):
    state = read_state(skirt / "drape.h5")
    other = dataclasses.replace(state, body_vertices=state.body_vertices + 0.01)
    from dress_jax.io.results import write_state

    write_state(tmp_path / "drape.h5", other)
    result = run("animate", tmp_path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "not the one that its settings name" in result.stderr


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (("--motion", "fly"), "walk, turn, sway"),
        (("--motion", "none.bvh"), "check the path"),
        (("--frames", "1"), "2 frames or more"),
        (("--fps", "0"), "1 to 240"),
        (("--gap-mm", "80"), "gap below the depth"),
        (("--preview-size", "33"), "even number"),
    ],
)
def test_bad_options_of_animate_are_named(skirt, run, tmp_path, options, part):
    result = run("animate", skirt, *options, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert part in result.stderr


@pytest.mark.slow
def test_a_file_is_cut_and_resampled(skirt, run, tmp_path):
    """A clip of 60 frames per second at 15, and one that is shorter than asked for."""
    poses = np.zeros((31, 165))
    poses[:, 0] = np.pi / 2  # +z up
    poses[:, 2] = 0.0
    path = tmp_path / "stand.npz"
    np.savez(path, poses=poses, trans=np.zeros((31, 3)), mocap_frame_rate=60.0)
    options = ("--motion", path, "--fps", 15, "--ease", 0.2, "--preview-size", 0)
    result = run("animate", skirt, *options, "--frames", 3, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    _, objects = read_trajectory(tmp_path / "out" / "trajectory.h5")
    assert len(objects["body"][0]) == 3
    # The body stands where it stood.
    assert np.abs(objects["body"][0][-1] - objects["body"][0][0]).max() < 0.02
    result = run("animate", skirt, *options, "--frames", 100, "--out", tmp_path / "more")
    assert result.exit_code == 2
    assert "or fewer" in result.stderr
    result = run("animate", skirt, *options, "--start", 9, "--out", tmp_path / "late")
    assert result.exit_code == 2
    assert "0.50 s long" in result.stderr


def test_a_garment_that_slips_off_is_told(skirt):
    state = read_state(skirt / "drape.h5")
    stays = slip_along_body(state, state.garment.vertices, state.body_vertices)
    assert not stays[0]["slipped"] and stays[0]["largest_m"] < 1e-9
    fallen = slip_along_body(state, state.garment.vertices - [0.0, 0.3, 0.0], state.body_vertices)
    assert fallen[0]["slipped"]
    assert fallen[0]["median_m"] == pytest.approx(0.3)
    assert set(fallen[0]["panels"]) == set(state.garment.panels)
