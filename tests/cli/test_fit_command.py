"""The fit command: files, report, interruption and exact resumption."""

import json
import re
import shutil

import jax
import numpy as np
import pytest

from dress_jax.application import fit_run
from dress_jax.application.drape import DrapeOptions
from dress_jax.application.fit import fit_pattern, scheduled
from dress_jax.application.fit_run import FitInterrupted
from dress_jax.application.fit_session import fingerprint
from dress_jax.application.targets import read_targets
from dress_jax.application.wearer import find_wearer
from dress_jax.io.meshes import read_garment_obj
from dress_jax.io.patterns import load_pattern, save_pattern
from dress_jax.optimisation import Landmark
from dress_jax.optimisation.landmarks import landmark_weights
from dress_jax.pattern import discretize
from dress_jax.pattern.scaling import scaled

EDGE_LENGTH = 0.06
ITERATIONS = 3
FRONT, BACK = "skirt_front", "skirt_back"
RULE = {"rule": "equal", "edges": [[FRONT, 1], [BACK, 1]]}


def test_fingerprints_tell_inputs_apart():
    base = fingerprint({"a": np.arange(3.0)}, "text", 1)
    assert base == fingerprint({"a": np.arange(3.0)}, "text", 1)
    assert base != fingerprint({"a": np.arange(3.0) + 1e-12}, "text", 1)
    assert base != fingerprint({"a": np.arange(3)}, "text", 1)
    assert base != fingerprint({"b": np.arange(3.0)}, "text", 1)


@pytest.fixture(scope="module")
def fitted(draped, inputs, run, tmp_path_factory):
    """A short fit of a skirt that is too short: its folder, and the command to repeat it."""
    root = tmp_path_factory.mktemp("fit")
    save_pattern(
        scaled(load_pattern(inputs / "skirt.json"), {"*": (1.0, 0.9)}), root / "start.json"
    )
    assert (
        run("render", draped[0], "--views", 4, "--size", 64, "--out", root / "targets").exit_code
        == 0
    )
    command = (
        *("fit", root / "start.json", "--targets", root / "targets"),
        *("--body", inputs / "body.obj", "--edge-length", EDGE_LENGTH),
        *("--iterations", ITERATIONS, "--truth", inputs / "skirt.json"),
        *("--landmarks", root / "landmarks.json", "--rules", root / "rules.json"),
    )
    # The ends of the true front's first edge, and side seams that stay alike.
    mesh = discretize(load_pattern(inputs / "skirt.json"), EDGE_LENGTH)
    garment = read_garment_obj(root / "targets" / "garment.obj").vertices
    ends = [Landmark(FRONT, 0, t, (0.0, 0.0, 0.0)) for t in (0.0, 1.0)]
    marks = [
        {"panel": FRONT, "edge": 0, "at": mark.at, "position_m": place.tolist()}
        for mark, place in zip(ends, landmark_weights(ends, mesh).dot(garment), strict=True)
    ]
    (root / "landmarks.json").write_text(json.dumps({"landmarks": marks}))
    (root / "rules.json").write_text(json.dumps({"rules": [RULE]}))
    result = run(*command, "--out", root / "whole")
    assert result.exit_code == 0, result.output
    return root, command


def test_a_fit_writes_every_file_and_gets_better(fitted):
    folder = fitted[0] / "whole"
    names = {path.name for path in folder.iterdir()}
    assert names >= {
        *("pattern.json", "pattern.svg", "garment.obj", "garment.glb", "body.obj", "drape.h5"),
        *("preview.png", "loss.png", "comparison.png", "known.png"),
        *("report.json", "checkpoint.h5"),
    }
    report = json.loads((folder / "report.json").read_text())
    assert len(report["loss"]) == report["iterations"] == ITERATIONS
    assert report["intersections"] == {"self": 0, "body": 0}
    assert report["iou"]["end"] > report["iou"]["start"]
    assert min(report["chamfer_cm"].values()) > 0.0
    errors = report["edge_length_error"]
    assert set(errors) == {"start", "end"}
    assert errors["start"]["max"] == pytest.approx(0.1, abs=0.02)
    assert errors["end"]["median"] < errors["start"]["median"]
    assert report["landmarks_cm"]["end"] < report["landmarks_cm"]["start"]
    assert report["rules"] == [f"equal lengths of edges 1 of {FRONT!r}, 1 of {BACK!r}"]
    assert report["versions"]["jax"]
    assert set(report["seconds"]) == {"compile", "run"}


def test_the_report_says_what_is_known(fitted):
    report = json.loads((fitted[0] / "whole" / "report.json").read_text())
    known = report["known"]
    assert {(e["panel"], e["edge"]) for e in known["edges"]} >= {(FRONT, 0), (BACK, 3)}
    for edge in known["edges"]:
        low, high = edge["interval_95_cm"]
        assert low < edge["length_cm"] < high and 0.0 <= edge["told"] <= 1.0
    assert set(known["fabric"]) == {"stretching", "bending"}
    for name, own in known["fabric"].items():
        assert own["interval_95"][0] < own["value"] < own["interval_95"][1]
        assert own["value"] == pytest.approx(report["fabric"][name])
    sizes = [direction["deviation_cm"] for direction in known["open_directions"]]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > 0.0
    assert set(known["remaining_differences"]) == {"outlines", "normals", "landmarks"}


@pytest.mark.parametrize(
    "option, entries, message",
    [
        ("landmarks", [{"panel": FRONT}], "landmark 0.*has keys"),
        ("landmarks", [{"edge": 1.5, "position_m": [0, 0, 0]}], "whole numbers"),
        ("landmarks", [{"edge": 1, "position_m": [0]}], "not 3 numbers"),
        ("landmarks", [{"edge": 1, "view": 7, "pixel": [0, 0]}], "no view 7"),
        ("rules", [{"rule": "straight"}], "rule 0.*'straight' is no rule"),
        ("rules", None, "no list 'rules'"),
    ],
)
def test_landmarks_and_rules_that_cannot_be_read(fitted, run, tmp_path, option, entries, message):
    whole = {"panel": FRONT, "at": 0.5}
    listed = [e if "panel" in e or "rule" in e else whole | e for e in entries or []]
    document = {option: listed} if entries else {}
    (tmp_path / "own.json").write_text(json.dumps(document))
    result = run(*fitted[1], f"--{option}", tmp_path / "own.json", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert re.search(message, " ".join(result.stderr.split()))


@pytest.mark.slow
def test_an_interrupted_fit_resumes_exactly(fitted, run, monkeypatch):
    """From the same initial drape, stopping in between changes no bit."""
    root, command = fitted
    out = root / "stopped"
    out.mkdir()
    shutil.copy(root / "whole" / "start.h5", out)
    whole = fit_run.fit

    def stopping(problem, state, *, on_iteration, clock):
        def after(state, info):
            on_iteration(state, info)
            if info.iteration == 0:
                raise KeyboardInterrupt

        return whole(problem, state, on_iteration=after, clock=clock)

    monkeypatch.setattr(fit_run, "fit", stopping)
    stopped = run(*command, "--resume", "--out", out)
    assert stopped.exit_code == 130
    assert "--resume" in stopped.stderr
    assert not (out / "report.json").exists()
    monkeypatch.setattr(fit_run, "fit", whole)

    other = run(*command, "--fabric", "denim", "--resume", "--out", out)
    assert other.exit_code == 2
    assert "options" in other.stderr

    assert run(*command, "--resume", "--out", out).exit_code == 0
    expected = json.loads((root / "whole" / "report.json").read_text())
    resumed = json.loads((out / "report.json").read_text())
    for key in ("loss", "iou", "chamfer_cm", "edge_length_error"):
        assert resumed[key] == expected[key], key


@pytest.mark.slow
def test_a_fit_remeshes_and_resumes_exactly(fitted, inputs, tmp_path):
    """With a threshold that the first mesh soon reaches: the fit goes on with another (S13)."""
    root, _ = fitted
    views = read_targets(root / "targets")
    wearer = find_wearer(inputs / "body.obj")

    def run(folder, **options):
        folder.mkdir(exist_ok=True)
        return fit_pattern(
            load_pattern(root / "start.json"),
            wearer,
            views,
            folder,
            drape_options=DrapeOptions(edge_length=EDGE_LENGTH),
            fit_options=scheduled(ITERATIONS + 2, remesh_distortion=1.05),
            truth=load_pattern(inputs / "skirt.json"),
            **options,
        )

    whole = run(tmp_path / "whole")
    (record, *_) = whole.course.remeshed
    assert record["outcome"] == "accepted" and record["distortion"] > 1.05
    assert whole.course.mesh == len(whole.course.remeshed)
    before = whole.course.history[record["iteration"] - 1]
    # S13.8: another mesh, in triangles of 6 cm, has folds of its own.
    assert record["loss"] < 2.0 * before["loss"]
    assert whole.good and whole.after.iou > whole.before.iou
    assert whole.after.median_length_error < whole.before.median_length_error

    # Stop in the first iteration on the second mesh.
    stopped = tmp_path / "stopped"
    stopped.mkdir()
    shutil.copy(tmp_path / "whole" / "start.h5", stopped)
    wanted = record["iteration"] + 1

    def interrupting(stage, done, total, **_):
        if stage == "fit" and done == wanted:
            raise KeyboardInterrupt

    with pytest.raises(FitInterrupted):
        run(stopped, resume=True, progress=interrupting)
    assert (stopped / "mesh_1.h5").is_file()
    resumed = run(stopped, resume=True)
    assert _same(resumed.end.unknowns, whole.end.unknowns)
    assert np.array_equal(resumed.end.positions, whole.end.positions)


def _same(a, b):
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y) for x, y in pairs)


def test_a_fit_needs_something_to_fit_to(inputs, run, tmp_path):
    result = run("fit", inputs / "skirt.json", "--out", tmp_path)
    assert result.exit_code == 2 and "--scan" in result.stderr
    empty = tmp_path / "empty.ply"
    empty.write_text("not a mesh")
    result = run("fit", inputs / "skirt.json", "--scan", empty, "--out", tmp_path)
    assert result.exit_code == 2 and "empty.ply" in result.stderr


@pytest.mark.slow
def test_a_fit_to_a_scan(draped, inputs, fitted, run, tmp_path):
    """The true drape's mesh, as a scanner would give it: no picture, no pattern."""
    command = (
        *("fit", fitted[0] / "start.json", "--scan", draped[0] / "garment.obj"),
        *("--scan-complete", "--body", inputs / "body.obj", "--edge-length", EDGE_LENGTH),
        *("--iterations", 6, "--truth", inputs / "skirt.json"),
    )
    result = run(*command, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["iou"] is None
    assert report["scan_cm"]["end"] < 0.6 * report["scan_cm"]["start"]
    errors = report["edge_length_error"]
    assert errors["end"]["median"] < 0.5 * errors["start"]["median"]
