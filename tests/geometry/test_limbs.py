"""Arms and legs of a body: where they are, and how arms are drawn in."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_contraction import elliptic_capsule

from dress_jax.body.model import forward, named_shape
from dress_jax.body.poses import named_pose
from dress_jax.geometry.contraction import curve_skeleton
from dress_jax.geometry.limbs import LimbKind, drawn_in
from dress_jax.io.bodies import load_default_body

# A skeleton point may lie this far outside of the mesh, near finger tips and toes [m].
OUTSIDE = 0.01


def posed(pose: str):
    """The default body."""
    model = load_default_body()
    shape = jnp.asarray(named_shape(model, "average"))
    state = forward(model, jnp.asarray(named_pose(pose)), shape, jnp.zeros(3))
    return np.asarray(state.vertices), np.asarray(model.faces)


def winding_numbers(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """1 inside of a closed surface, 0 outside (van Oosterom and Strackee)."""
    numbers = []
    for point in points:
        a, b, c = (triangles[:, k] - point for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.sum(a * np.cross(b, c), axis=1)
        rest = la * lb * lc + np.sum(a * b, 1) * lc + np.sum(b * c, 1) * la + np.sum(c * a, 1) * lb
        numbers.append(np.sum(2.0 * np.arctan2(volume, rest)) / (4.0 * np.pi))
    return np.array(numbers)


@pytest.fixture(scope="module", params=["t", "a"])
def person(request):
    vertices, faces = posed(request.param)
    return vertices, faces, curve_skeleton(vertices, faces)


def test_a_person_has_two_arms_and_two_legs_on_their_sides(person):
    vertices, _, skeleton = person
    assert [limb.kind for limb in skeleton.limbs] == [LimbKind.ARM] * 2 + [LimbKind.LEG] * 2
    for right, left in (skeleton.limbs[:2], skeleton.limbs[2:]):
        assert {np.sign(vertices[limb.part, 0].mean()) for limb in (right, left)} == {-1.0, 1.0}
        assert not (right.part & left.part).any()
    for arm in skeleton.limbs[:2]:
        assert np.abs(vertices[arm.part, 0]).min() > 0.1  # no part of the chest
        assert 0.5 < arm.stations[-1] < 0.8  # from shoulder to finger tips [m]
    for leg in skeleton.limbs[2:]:
        assert vertices[leg.part, 1].max() < vertices[:, 1].min() + 1.0


def test_the_skeleton_runs_inside_of_the_body(person):
    """Seen from the crown alone, it would leave the body at the armpits and the crotch."""
    vertices, faces, skeleton = person
    curves = np.concatenate([limb.curve for limb in skeleton.limbs])
    outside = winding_numbers(curves, vertices[faces]) < 0.5
    distance, _ = cKDTree(vertices).query(curves)
    assert distance[outside].max(initial=0.0) < OUTSIDE
    assert outside.mean() < 0.1


def test_arms_that_are_drawn_in_end_at_the_shoulders(person):
    _, _, skeleton = person
    arms = skeleton.limbs[:2]
    whole = drawn_in(skeleton.targets, arms, remaining=1.0)
    np.testing.assert_allclose(whole, skeleton.targets, atol=1e-12)
    trunk = ~(arms[0].part | arms[1].part)
    previous = np.inf
    for remaining in (0.75, 0.5, 0.25, 0.0):
        moved = drawn_in(skeleton.targets, arms, remaining=remaining)
        np.testing.assert_array_equal(moved[trunk], skeleton.targets[trunk])
        reach = max(np.linalg.norm(moved[arm.part] - arm.curve[0], axis=1).max() for arm in arms)
        assert reach < previous
        previous = reach
    assert previous < 0.03


def test_a_body_without_limbs_has_none():
    assert curve_skeleton(*elliptic_capsule(rings=30, around=24)).limbs == ()
