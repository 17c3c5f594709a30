"""`dress-jax fit-body` on a person of four views."""

import json

import numpy as np
import pytest

from benchmarks.body_reconstruction.scene import make_scene, random_truth
from dress_jax.io.bodies import load_default_body
from dress_jax.io.images import Targets, save_targets, write_mask
from dress_jax.io.obj import read_obj
from dress_jax.io.person import read_body
from dress_jax.reconstruction import body_in_world
from dress_jax.reconstruction.landmarks import TABLE
from dress_jax.render.cameras import cameras_to_dict, unstack_cameras

VIEWS, SIZE = 4, 96
AZIMUTHS = (0, 90, 180, 270)


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    """A folder with views and `landmarks.npz`, and the true vertices."""
    folder = tmp_path_factory.mktemp("person")
    model = load_default_body()
    truth = random_truth(model, 1)
    views = make_scene(model, truth, views=VIEWS, size=SIZE, noise=0.2, hidden_noise=0.5).views
    cameras = cameras_to_dict(unstack_cameras(views.cameras))["cameras"]
    save_targets(
        folder,
        Targets(AZIMUTHS, tuple(cameras), rgb=np.asarray(views.color), mask=np.asarray(views.mask)),
    )
    for azimuth, seen in zip(AZIMUTHS, np.asarray(views.visible), strict=True):
        write_mask(folder / "occluded" / f"{azimuth:03d}.png", 1.0 - seen)
    np.savez(
        folder / "landmarks.npz",
        landmarks=np.asarray(views.landmarks),
        confidence=np.asarray(views.confidence),
        ids=np.array([target.index for target in TABLE]),
    )
    return folder, np.asarray(body_in_world(model, truth).vertices)


def test_landmarks_of_other_views_are_refused(run, person, tmp_path):
    np.savez(tmp_path / "two.npz", landmarks=np.zeros((2, 17, 2)), confidence=np.ones((2, 17)))
    result = run("fit-body", person[0], "--landmarks", tmp_path / "two.npz", "--out", tmp_path)
    assert result.exit_code == 2
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1 and "2 views" in lines[0] and "one row per view" in lines[0]


@pytest.mark.slow  # compiles the whole reconstruction for four views of 96 pixels
def test_a_body_is_written_with_report_and_picture(run, person, tmp_path):
    folder, vertices = person
    out = tmp_path / "body"
    arguments = ("fit-body", folder, "--landmarks", folder / "landmarks.npz", "--out", out)
    result = run(*arguments, "--iterations", 20, "--views-per-iteration", 4)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in out.iterdir()) == [
        "body.npz",
        "body.obj",
        "comparison.png",
        "report.json",
    ]
    mesh = read_obj(out / "body.obj")
    assert np.linalg.norm(mesh.vertices - vertices, axis=1).mean() < 0.02  # [m]
    report = json.loads((out / "report.json").read_text())
    assert report["good"] and report["fine"]["iterations"] == 20
    saved = read_body(out / "body.npz")
    assert saved.scale == pytest.approx(report["scale"])
    # The file is an estimate for another run; without steps it gives the same body.
    again = tmp_path / "again"
    result = run(*arguments[:-1], again, "--estimate", out / "body.npz", "--iterations", 0)
    assert result.exit_code == 0, result.output
    there = read_obj(again / "body.obj")
    assert np.linalg.norm(there.vertices - mesh.vertices, axis=1).mean() < 0.02
