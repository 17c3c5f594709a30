"""`dress-jax reconstruct` on six small views of a draped skirt, on a body that is known."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from command_scenes import small_skirt

from dress_jax.io.patterns import load_pattern, save_pattern
from dress_jax.io.results import read_state
from dress_jax.pattern import scaled

EDGE_LENGTH = 0.06
STAGES = ["bundle", "body", "pattern", "drape", "fit", "texture", "report"]


@pytest.fixture(scope="module")
def scene(inputs, run, draped, tmp_path_factory):
    """A folder with target views and the wrong pattern that the reconstruction begins with."""
    folder = tmp_path_factory.mktemp("scene")
    result = run("render", draped[0], "--views", 6, "--size", 96, "--out", folder / "targets")
    assert result.exit_code == 0, result.output
    save_pattern(scaled(small_skirt(), {"*": (1.1, 0.85)}), folder / "wrong.json")
    return folder


def arguments(inputs, scene, out, *, iterations=2):
    return (
        "reconstruct", scene / "targets", "--source", "targets", "--out", out,
        "--body", inputs / "body.obj", "--pattern", scene / "wrong.json",
        "--truth", inputs / "skirt.json", "--edge-length", EDGE_LENGTH,
        "--iterations", iterations,
    )  # fmt: skip


def endings(result):
    """Stage and ending from the lines on standard error."""
    lines = re.findall(r"^(\w+): (done|kept|skipped)", result.stderr, re.M)
    return dict(lines)


@pytest.mark.slow
def test_stages_until_the_drape_are_made_once(run, inputs, scene, tmp_path):
    out = tmp_path / "out"
    given = (*arguments(inputs, scene, out), "--until", "drape")
    first = run(*given)
    assert first.exit_code == 0, first.output
    assert list(endings(first).values()) == ["done", "skipped", "done", "done"]
    assert "given by options" in first.stderr and "2 panels or pairs" in first.stderr
    assert sorted(p.name for p in out.iterdir()) == ["body", "bundle", "drape", "pattern"]
    before = (out / "drape" / "drape.h5").stat().st_mtime_ns
    again = run(*given)
    assert list(endings(again).values()) == ["kept", "skipped", "kept", "kept"]
    assert (out / "drape" / "drape.h5").stat().st_mtime_ns == before
    # A pattern that was edited by hand is draped.
    pattern = load_pattern(out / "pattern" / "pattern.json")
    save_pattern(scaled(pattern, {"*": (1.0, 0.95)}), out / "pattern" / "pattern.json")
    edited = run(*given)
    assert endings(edited)["pattern"] == "kept" and endings(edited)["drape"] == "done"
    assert "drape: done (changed: stage pattern)" in edited.stderr
    assert (out / "drape" / "drape.h5").stat().st_mtime_ns > before
    # A drape of another mesh is not what the fit begins with.
    assert read_state(out / "drape" / "drape.h5").settings["edge_length"] == EDGE_LENGTH


def test_a_failure_names_its_stage(run, inputs, scene, tmp_path):
    out = tmp_path / "out"
    bad = tmp_path / "bad.json"
    bad.write_text("{}")
    given = list(arguments(inputs, scene, out))
    given[given.index(scene / "wrong.json")] = bad
    result = run(*given)
    assert result.exit_code == 2
    [line] = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert line.startswith("error: stage 'pattern', ") and "bad.json" in line
    assert (out / "body" / "wearer.json").is_file() and not (out / "pattern").exists()
    for options, message in (
        (("--from", "sewing"), "--from: there is no stage 'sewing'"),
        (("--from", "fit", "--until", "body"), "comes after stage 'body'"),
        (("--edge-length", 9), "edge length"),
        (("--frame", "1"), "--frame: does not apply to targets"),
    ):
        result = run(*arguments(inputs, scene, out), *options)
        assert result.exit_code == 2 and message in result.stderr, result.output


@pytest.mark.slow  # fits a pattern: compiles the solver's sensitivities
def test_all_stages_with_a_page(run, inputs, scene, tmp_path):
    out = tmp_path / "out"
    result = run(*arguments(inputs, scene, out))
    assert result.exit_code == 0, result.output
    assert list(endings(result)) == STAGES
    report = json.loads((out / "fit" / "report.json").read_text())
    assert report["iou"]["end"] > report["iou"]["start"] + 0.1
    errors = {name: own["median"] for name, own in report["edge_length_error"].items()}
    assert errors["end"] < errors["start"]
    assert report["intersections"] == {"self": 0, "body": 0} and report["certificate"]["stable"]
    # The fit began with the drape of the stage before it, not with one of its own.
    begun, kept = (read_state(out / p) for p in ("fit/start.h5", "drape/drape.h5"))
    np.testing.assert_array_equal(begun.garment.vertices, kept.garment.vertices)
    page = (out / "report" / "index.html").read_text(encoding="utf-8")
    assert page.count("<section>") == 9 and "3D view" in page
    assert f"{report['iou']['start']:.3f} → {report['iou']['end']:.3f}" in page
    assert not re.search(r"https?://(?!www\.w3\.org)", page)
    # From the texture on, the fit stays.
    again = run(*arguments(inputs, scene, out), "--from", "texture")
    assert list(endings(again).values()) == [
        "kept",
        "skipped",
        "kept",
        "kept",
        "kept",
        "done",
        "done",
    ]


@pytest.mark.slow  # a process of its own that is stopped in the middle of a fit
def test_an_interrupted_fit_goes_on_where_it_was(run, inputs, scene, tmp_path):
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert run(*arguments(inputs, scene, whole, iterations=4)).exit_code == 0
    command = [str(a) for a in arguments(inputs, scene, stopped, iterations=4)]
    process = subprocess.Popen(
        [sys.executable, "-c", "from dress_jax.cli.main import main; main()", *command],
        stderr=subprocess.PIPE,
        env=dict(os.environ),
        text=True,
    )
    checkpoint = stopped / "fit.unfinished" / "checkpoint.h5"
    for _ in range(3000):
        if checkpoint.exists() or process.poll() is not None:
            break
        time.sleep(0.1)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert "stopped in stage 'fit'; the same command goes on from there" in errors
    assert (stopped / "drape" / "drape.h5").is_file() and not (stopped / "fit").exists()
    result = run(*command)
    assert result.exit_code == 0, result.output
    assert endings(result)["drape"] == "kept" and endings(result)["fit"] == "done"
    states = [read_state(folder / "fit" / "drape.h5") for folder in (whole, stopped)]
    np.testing.assert_array_equal(states[0].garment.vertices, states[1].garment.vertices)
