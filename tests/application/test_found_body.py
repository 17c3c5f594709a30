"""Bodies kept in a folder, and the way from a bundle's world into the wearer's (S7, S8.6)."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.application.body_views import body_views, read_body_views
from dress_jax.application.found_body import (
    BodyOptions,
    _estimate,
    _keep_rigged,
    find_body,
    load_wearer,
    measurements_of,
    moved_bundle,
    why_no_fit,
)
from dress_jax.application.wearer import fitted_wearer, pelvis_of
from dress_jax.body.poses import relaxed_pose
from dress_jax.body.skeleton import joint_index
from dress_jax.capture import BodyEstimate, Bundle, Landmarks, Surface, View
from dress_jax.capture.body import BodyFamily
from dress_jax.capture.landmarks import COUNT
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import load_default_body
from dress_jax.io.capture.bundles import save_bundle
from dress_jax.reconstruction import body_in_world
from dress_jax.reconstruction.parameters import make_parameters
from dress_jax.render.cameras import perspective_camera, project

SIZE = 32
SAME = 1e-6  # [m]
TETRAHEDRON = np.array([[0.0, 0.1, 0.0], [0.2, 0.1, 0.0], [0.0, 1.8, 0.0], [0.0, 0.1, 0.2]])
FACES = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


@pytest.fixture(scope="module")
def model():
    return load_default_body()


@pytest.fixture(scope="module")
def found(model):
    """A body that leans, looks aside, is small, and stands away from the origin."""
    pose = relaxed_pose()
    pose[0] = [0.1, 0.4, 0.05]
    rng = np.random.default_rng(2)
    return make_parameters(
        model,
        pose=pose,
        shape=0.5 * rng.normal(size=6),
        scale=0.9,
        translation=np.array([0.3, 0.2, -2.5]),
    )


def camera():
    return perspective_camera(
        rotation=np.eye(3), position=np.zeros(3), focal=40.0, height=SIZE, width=SIZE
    )


def test_a_fitted_wearer_turns_about_its_pelvis_from_floor_and_t_pose(model, found):
    pose, shape = np.array(found.pose), np.array(found.shape)
    wearer = fitted_wearer(model, pose, shape, scale=found.scale)
    assert wearer.start[:, 1].min() == pytest.approx(0.0, abs=SAME)
    pelvis = pelvis_of(model, shape, scale=found.scale)
    world = body_in_world(model, found)
    offset = pelvis - np.asarray(world.joints)[0]
    np.testing.assert_allclose(np.asarray(world.vertices) + offset, wearer.vertices, atol=SAME)
    # No joint turns further than 5 degrees a frame, which the arms' 65 degrees need 13 for.
    assert len(wearer.way) == 13


def test_what_is_kept_comes_back_and_is_seen_in_the_same_pixels(tmp_path, model, found):
    _keep_rigged(tmp_path, model, BodyOptions(), found)
    wearer, offset = load_wearer(tmp_path)
    world = np.asarray(body_in_world(model, found).vertices)
    np.testing.assert_allclose(world + offset, wearer.vertices, atol=SAME)
    bundle = Bundle(views=(View("a", camera()),), scan=Surface(world, np.asarray(model.faces)))
    moved = moved_bundle(bundle, offset)
    assert moved.scan is not None
    np.testing.assert_allclose(moved.scan.vertices, wearer.vertices, atol=SAME)
    before = project(bundle.views[0].camera, jnp.asarray(world))
    after = project(moved.views[0].camera, jnp.asarray(wearer.vertices))
    np.testing.assert_allclose(before, after, atol=1e-3)
    measures = measurements_of(tmp_path)
    assert 0.6 < measures.chest < 1.0 and 0.0 < measures.crotch_height < measures.hips_height


def test_a_named_body_is_not_fitted(tmp_path):
    options = BodyOptions(pose="relaxed")
    bundle = Bundle(views=(View("a", camera()),))
    assert options.known and "options" in why_no_fit(bundle, options)
    assert find_body(tmp_path, bundle, options=options) == (True, ())
    wearer, offset = load_wearer(tmp_path)
    assert not offset.any() and len(wearer.way) and measurements_of(tmp_path).waist > 0.5
    assert not BodyOptions().known and not BodyOptions(body="smplx.npz").known
    assert BodyOptions(body="body.obj").known and BodyOptions(shape="male").known


def test_a_mesh_of_the_bundle_is_put_on_the_floor(tmp_path):
    bundle = Bundle(views=(View("a", camera()),), body_mesh=Surface(TETRAHEDRON, FACES))
    assert "mesh" in why_no_fit(bundle, BodyOptions())
    find_body(tmp_path, bundle)
    wearer, offset = load_wearer(tmp_path)
    np.testing.assert_allclose(offset, [0.0, -0.1, 0.0])
    np.testing.assert_allclose(np.sort(wearer.vertices[:, 1]), [0.0, 0.0, 0.0, 1.7], atol=SAME)
    with pytest.raises(InputError, match=r"mesh without joints.*--pattern"):
        measurements_of(tmp_path)


def estimate(family=BodyFamily.SMPLX):
    hand = np.zeros((15, 3))
    return BodyEstimate(
        betas=np.zeros(10),
        global_orient=np.zeros(3),
        body_pose=np.zeros((21, 3)),
        left_hand_pose=hand,
        right_hand_pose=hand,
        jaw_pose=np.zeros(3),
        left_eye_pose=np.zeros(3),
        right_eye_pose=np.zeros(3),
        expression=np.zeros(0),
        transl=np.array([0.1, 0.2, 0.3]),
        family=family,
    )


def test_an_estimate_is_kept_on_its_own_model_only(tmp_path, model):
    views = (View("a", camera()),)
    options = BodyOptions(keep_estimate=True)
    with pytest.raises(InputError, match="no estimate of the body to keep"):
        find_body(tmp_path, Bundle(views=views), options=options)
    with pytest.raises(InputError, match="is for smplx, and the body is another one"):
        find_body(tmp_path, Bundle(views=views, body=estimate()), options=options)
    nameless = dataclasses.replace(model, shape_names=())  # as an SMPL-X file's
    with pytest.raises(InputError, match="is for smplh"):
        _estimate(Bundle(views=views, body=estimate(BodyFamily.SMPLH)), nameless)
    kept = _estimate(Bundle(views=views, body=estimate()), nameless)
    pelvis = np.asarray(model.joint_template)[joint_index("pelvis")]
    np.testing.assert_allclose(kept.translation, pelvis + np.array([0.1, 0.2, 0.3]), atol=SAME)


def landmarks(rng):
    return Landmarks(SIZE * rng.random((COUNT, 2)), 1.3 * rng.random(COUNT))


def test_views_of_a_bundle_are_what_a_body_fit_looks_at(tmp_path):
    rng = np.random.default_rng(1)
    gray = [rng.integers(0, 256, (SIZE, SIZE), dtype=np.uint8) for _ in range(3)]
    view = View(
        "a",
        camera(),
        rgb=np.full((SIZE, SIZE, 3), 51, np.uint8),
        matte=gray[0],
        mask=gray[1],
        hidden=gray[2],
        landmarks=landmarks(rng),
    )
    bare = View("b", camera(), matte=gray[0])  # without landmarks, so it takes no part
    seen = body_views(Bundle(views=(view, bare)))
    assert seen.count == 1 and float(seen.confidence.max()) == 1.0
    np.testing.assert_allclose(seen.mask[0], gray[0] / 255.0, atol=1e-6)
    hidden = np.maximum(gray[1], gray[2]) / 255.0
    np.testing.assert_allclose(seen.visible[0], 1.0 - hidden, atol=1e-6)
    alpha = np.repeat(gray[0][..., None] / 255.0, 3, axis=2)
    np.testing.assert_allclose(seen.color[0], 0.2 * alpha + 1.0 - alpha, atol=1e-6)
    save_bundle(tmp_path / "b.h5", Bundle(views=(view, bare)))
    again = read_body_views(tmp_path / "b.h5")
    np.testing.assert_array_equal(again.landmarks, seen.landmarks)
    with pytest.raises(InputError, match="a bundle has landmarks of its own"):
        read_body_views(tmp_path / "b.h5", tmp_path / "marks.npz")
    with pytest.raises(InputError, match=r"comes without landmarks.*--landmarks"):
        read_body_views(tmp_path)
    with pytest.raises(InputError, match=r"no view has landmarks.*--body-pose"):
        body_views(Bundle(views=(bare,)))
    # Pictures that one view lacks are left out.
    third = dataclasses.replace(view, name="c", matte=None)
    assert body_views(Bundle(views=(view, third))).mask is None


def test_a_damaged_wearer_is_named(tmp_path):
    find_body(tmp_path, Bundle(views=(View("a", camera()),)), options=BodyOptions(pose="t"))
    path = tmp_path / "wearer.json"
    document = json.loads(path.read_text())
    del document["offset_m"]
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"wearer\.json: is damaged"):
        load_wearer(tmp_path)
