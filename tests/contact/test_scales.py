"""Lengths of contact that follow the mesh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import KINDS, SETTINGS, contact_of, facing_sheets, with_pairs
from scenes import grid, two_layers
from scipy.spatial import Delaunay

from dress_jax.contact.barrier import contact_settings
from dress_jax.contact.broad_phase import find_candidates, make_collision_mesh
from dress_jax.contact.candidates import make_candidates, pair_scales
from dress_jax.contact.ccd import step_bound
from dress_jax.contact.friction import Friction, friction_energy
from dress_jax.contact.potential import PairKind, active_pairs, contact_blocks, contact_energy
from dress_jax.contact.scales import contact_scales
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.geometry.host_distance import edge_edge, point_triangle
from tests.central_differences import check_energy_derivatives

KIND = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
LENGTHS = contact_settings(dhat=3e-3, thickness=3e-4)
REACH = 3.3e-3
# Central differences with step 1e-6; as in the tests of the potential with lengths of its own.
FINITE_DIFFERENCE = 1e-4

energy = jax.jit(contact_energy)


def _scales(rest, faces, settings=LENGTHS):
    return contact_scales(rest[faces], faces, len(rest), settings)


def _uneven_mesh(seed: int = 0):
    """A flat mesh whose triangles shrink to a hundredth towards one corner, with slivers."""
    rng = np.random.default_rng(seed)
    points = 0.2 * rng.uniform(size=(250, 2)) ** 3
    return points, Delaunay(points).simplices


def _with_scales(contact, seed: int = 5):
    """The same contact, every pair with a scale of its own."""
    scales = np.random.default_rng(seed).uniform(0.5, 1.0, contact.pairs.indices.shape[1])
    return with_pairs(contact, scales=jnp.asarray(scales))


def test_large_triangles_keep_the_lengths():
    rest, faces = grid(4, spacing=0.02)
    np.testing.assert_array_equal(_scales(rest[:, [0, 2]], faces), 1.0)


def test_scale_of_one_triangle():
    """The distance from the far side, not from the line through it."""
    rest = np.array([[0.0, 0.0], [4e-3, 0.0], [5e-3, 1e-3]])
    clearance = np.array([4e-3, 4e-3 / np.sqrt(26.0), 2.0**0.5 * 1e-3])
    # Sides are too short for the grading to matter less than the clearances.
    wanted = np.minimum(1.0, 0.6 * clearance / REACH)
    graded = np.minimum(wanted, wanted[1] + 0.25 * np.array([4e-3, 0.0, 2**0.5 * 1e-3]) / REACH)
    np.testing.assert_allclose(_scales(rest, np.array([[0, 1, 2]])), graded, rtol=1e-12)
    # A thickness that is large beside dhat stays below a quarter of the clearance.
    thick = contact_settings(dhat=1e-4, thickness=1e-3)
    assert _scales(rest, np.array([[0, 1, 2]]), thick)[1] == pytest.approx(
        0.25 * clearance[1] / 1e-3, rel=1e-12
    )


@pytest.mark.parametrize("seed", range(3))
def test_no_pair_of_a_flat_mesh_is_within_reach(seed):
    """So contact neither pushes on a cloth at rest nor stiffens it."""
    rest, faces = _uneven_mesh(seed)
    scales = _scales(rest, faces)
    assert scales.min() < 0.01 and np.mean(scales == 1.0) > 0.05
    flat = np.c_[rest, np.zeros(len(rest))]
    mesh = make_collision_mesh(faces, len(rest))
    assert not any(map(len, find_candidates(mesh, flat, flat, REACH * scales)))
    # With the lengths unscaled there would be hundreds.
    assert min(map(len, find_candidates(mesh, flat, flat, REACH))) > 300


def test_the_reach_grows_slowly():
    rest, faces = _uneven_mesh()
    scales = _scales(rest, faces)
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    lengths = np.linalg.norm(rest[sides[:, 0]] - rest[sides[:, 1]], axis=1)
    rise = REACH * np.abs(scales[sides[:, 0]] - scales[sides[:, 1]])
    assert np.all(rise <= 0.25 * lengths + 1e-15)
    assert np.any(rise > 0.249 * lengths)


def test_welded_panels_share_the_smaller_length():
    """A vertex between two panels is as fine as the finer of them."""
    rest = np.array([[0.0, 0.0], [0.02, 0], [0, 0.02], [0, 0], [2e-3, 0], [0, 2e-3]])
    own = np.array([[0, 1, 2], [3, 4, 5]])
    welded = np.array([[0, 1, 2], [0, 3, 1]])
    scales = contact_scales(rest[own], welded, 4, LENGTHS)
    assert scales[0] == pytest.approx(0.6 * 2.0**0.5 * 1e-3 / REACH)
    assert scales[2] > scales[0]


@pytest.mark.parametrize("last", [[0.5, 0.0], [0.0, np.nan]])
def test_a_triangle_without_area_is_refused(last):
    rest = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], last])
    with pytest.raises(InputError, match="rest triangle 1"):
        _scales(rest, np.array([[0, 1, 2], [0, 1, 3]]))


@KIND
def test_a_scaled_pair_is_a_pair_in_other_units(kind):
    """Scale s at positions s x: the energy is s times, the pressure the same."""
    positions, contact = facing_sheets(kind)
    for scale in (0.3, 0.8):
        scales = jnp.full(contact.pairs.indices.shape[1], scale)
        scaled = with_pairs(contact, scales=scales)
        np.testing.assert_allclose(
            energy(scale * positions, scaled), scale * energy(positions, contact), rtol=1e-12
        )
        force, own = (jax.grad(contact_energy)(scale * positions, scaled), jax.grad(contact_energy))
        np.testing.assert_allclose(force, own(positions, contact), rtol=0, atol=1e-11)
        start = positions + 0.01 * jnp.sin(jnp.arange(positions.size)).reshape(positions.shape)
        friction = [
            friction_energy(s * positions, Friction(c, s * start, jnp.asarray(0.4), s * slip))
            for s, c, slip in ((scale, scaled, jnp.asarray(0.05)), (1.0, contact, 0.05))
        ]
        np.testing.assert_allclose(friction[0], scale * friction[1], rtol=1e-11)


@KIND
def test_derivatives(kind):
    positions, contact = facing_sheets(kind)
    contact = _with_scales(contact)

    def value(positions, areas, stiffness):
        changed = replace(contact, areas=areas, barrier_stiffness=stiffness)
        return contact_energy(positions, changed)

    arguments = (positions, contact.areas, contact.barrier_stiffness)
    check_energy_derivatives(value, arguments, step=1e-6, tolerance=FINITE_DIFFERENCE)


@KIND
def test_derivatives_of_friction(kind):
    start, contact = facing_sheets(kind)
    contact = _with_scales(contact)
    end = start + 0.04 * jnp.asarray(np.random.default_rng(4).normal(size=start.shape))

    def value(end, start):
        return friction_energy(end, Friction(contact, start, jnp.asarray(0.4), jnp.asarray(0.05)))

    check_energy_derivatives(value, (end, start), step=1e-6, tolerance=FINITE_DIFFERENCE)


def test_the_block_of_a_pair_is_its_second_derivative():
    """A vertex over the inside of a face: along the normal there is nothing else."""
    positions = jnp.array([[0.2, 0.15, 0.2], [0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    contact = contact_of(np.arange(4)[:, None], np.ones(4), PairKind.VERTEX_FACE)
    contact = with_pairs(contact, scales=jnp.array([0.4]))
    exact = jax.hessian(contact_energy)(positions, contact)[0, 1, 0, 1]
    assert float(exact) > 1.0
    np.testing.assert_allclose(contact_blocks(positions, contact).stiffness, [exact], rtol=1e-11)


@KIND
def test_active_pairs_follow_their_own_dhat(kind):
    positions, contact = facing_sheets(kind)
    contact = _with_scales(contact)
    found = active_pairs(positions, contact.pairs, SETTINGS)
    whole = active_pairs(positions, facing_sheets(kind)[1].pairs, SETTINGS)
    assert 0 < int(found.mask.sum()) < int(whole.mask.sum())
    assert float(found.smallest) == float(whole.smallest)
    assert float(found.smallest_scaled) > float(found.smallest)
    # Exactly those pairs have energy.
    for column in range(0, contact.pairs.indices.shape[1], 37):
        one = with_pairs(
            contact,
            indices=contact.pairs.indices[:, column : column + 1],
            scales=contact.pairs.scales[column : column + 1],
            count=jnp.asarray(1),
        )
        assert (float(energy(positions, one)) > 0.0) == bool(found.mask[column])


@pytest.mark.parametrize("seed", range(2))
def test_candidates_within_a_radius_at_each_vertex(seed):
    positions, faces = two_layers(5, gap=0.004, seed=seed)
    radii = np.random.default_rng(seed).uniform(2e-3, 8e-3, len(positions))
    mesh = make_collision_mesh(faces, len(positions))
    found = find_candidates(mesh, positions, positions, radii)
    wide = find_candidates(mesh, positions, positions, radii.max())
    for rows, everything, squared in zip(found, wide, (point_triangle, edge_edge), strict=True):
        distance = np.array([squared(*positions[row]) for row in everything]) ** 0.5
        near = distance <= radii[everything].min(axis=1)
        assert 0 < near.sum() < len(everything)
        np.testing.assert_array_equal(rows, everything[near])


def test_a_pair_stops_at_its_own_thickness():
    """Two vertices fall onto faces; each is bounded by its distance and its scale."""
    face = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    one = np.concatenate([[[0.2, 1.0, 0.2]], face])
    both = np.concatenate([one, one + np.array([5.0, 0.0, 0.0])])
    rows, empty = np.array([[0, 1, 2, 3], [4, 5, 6, 7]]), np.zeros((0, 4), np.int32)
    scales = np.array([1.0, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(pair_scales(scales, rows.T), [0.5, 1.0])
    for fast, thickness in ((0, 0.2), (4, 0.4)):
        d = np.zeros_like(both)
        d[fast, 1] = -2.0
        bound = step_bound(
            jnp.asarray(both),
            jnp.asarray(d),
            make_candidates(rows, empty, scales=scales),
            min_distance=0.4,
        )
        hit = 0.5 * (1.0 - thickness)
        assert 0.8 * hit < float(bound) < hit
