import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from contact_scenes import KINDS, SETTINGS, contact_of, facing_sheets, with_pairs
from scipy.spatial.transform import Rotation

from dress_jax.contact.barrier import barrier, barrier_derivatives, contact_settings
from dress_jax.contact.potential import (
    Contact,
    PairKind,
    Pairs,
    active_pairs,
    closest,
    contact_blocks,
    contact_energy,
    mollifier,
    pair_areas,
    squared_distances,
    stencils,
)
from dress_jax.core.buckets import pad_columns
from dress_jax.core.pytree import replace
from dress_jax.geometry.distance import edge_edge_closest, vertex_face_closest
from dress_jax.geometry.topology import unique_edges
from tests.central_differences import UNOPTIMIZED, check_energy_derivatives

KIND = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
# Central differences with step 1e-6 on quantities of order one; the barrier's higher derivatives
# grow like inverse powers of the gap, 0.3 of dhat here.
FINITE_DIFFERENCE = 1e-4
# Neighbours of the face below come within dhat near its edges (a few times dhat over the triangle's
# side), and the crossings along the border are few.
SHEET_TOLERANCE = 0.15
# Room for the finest of the two facing meshes, so that all of them run one program.
LARGEST_MESH, MOST_PAIRS = 2048, 32768

energy = jax.jit(contact_energy)
force = jax.jit(jax.grad(contact_energy))
matrices = jax.jit(contact_blocks)
distances = jax.jit(lambda x, pairs: squared_distances(stencils(x, pairs)[0], pairs.kind))


@KIND
def test_derivatives(kind):
    """In positions, areas and stiffness, to second order."""
    positions, contact = facing_sheets(kind)

    def value(x, areas, stiffness):
        return contact_energy(x, replace(contact, areas=areas, barrier_stiffness=stiffness))

    arguments = (positions, contact.areas, contact.barrier_stiffness)
    check_energy_derivatives(value, arguments, step=1e-6, tolerance=FINITE_DIFFERENCE)


@KIND
def test_rest_shape_derivative(kind):
    """S9.7: the areas carry a derivative; it is the energy that each unit of area costs."""
    positions, contact = facing_sheets(kind)
    by_areas = jax.jit(
        jax.grad(lambda areas: contact_energy(positions, replace(contact, areas=areas)))
    )
    derivative = by_areas(contact.areas)
    assert np.count_nonzero(derivative) >= 6
    # Linear in the areas.
    value = energy(positions, contact)
    np.testing.assert_allclose(np.vdot(derivative, contact.areas), value, rtol=1e-13)


@KIND
def test_force_and_torque_vanish(kind):
    """The energy does not change under rigid motions, so forces and torques add up to zero."""
    positions, contact = facing_sheets(kind)
    f = np.asarray(force(positions, contact))
    scale = np.abs(f).max()
    assert scale > 0.1
    np.testing.assert_allclose(f.sum(0), 0.0, atol=1e-12 * scale)
    np.testing.assert_allclose(np.cross(positions, f).sum(0), 0.0, atol=1e-11 * scale)
    turn = Rotation.random(random_state=np.random.default_rng(1)).as_matrix()
    moved = jnp.asarray(np.asarray(positions) @ turn.T + np.array([1.0, -2.0, 0.5]))
    np.testing.assert_allclose(energy(moved, contact), energy(positions, contact), rtol=1e-12)
    turned = force(moved, contact)
    np.testing.assert_allclose(turned, f @ turn.T, rtol=0, atol=1e-11 * scale)


@KIND
def test_padding_and_order_do_not_matter(kind):
    positions, contact = facing_sheets(kind)
    pairs, count = contact.pairs.indices, contact.pairs.count
    shuffled = np.asarray(pairs)[:, np.random.default_rng(2).permutation(pairs.shape[1])]
    reference = energy(positions, contact)
    gradient = force(positions, contact)
    shuffled = with_pairs(contact, indices=jnp.asarray(shuffled))
    np.testing.assert_allclose(energy(positions, shuffled), reference, rtol=1e-13)
    np.testing.assert_allclose(force(positions, shuffled), gradient, atol=1e-12)
    # More padding; what stands in it, here pairs at a distance of zero, is not looked at.
    wider = jnp.pad(shuffled.pairs.indices, [(0, 0), (0, 37)])
    padded = with_pairs(contact, indices=wider, scales=jnp.ones(wider.shape[1]))
    np.testing.assert_allclose(energy(positions, padded), reference, rtol=1e-13)
    few = with_pairs(contact, count=count - 30)
    garbage = with_pairs(few, indices=pairs.at[:, -30:].set(0))
    np.testing.assert_array_equal(force(positions, garbage), force(positions, few))
    blocks = matrices(positions, garbage)
    np.testing.assert_array_equal(blocks.stiffness[-30:], 0.0)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(blocks))

    none = with_pairs(garbage, count=0 * count)
    assert float(energy(positions, none)) == 0.0
    assert not np.any(force(positions, none))
    active, smallest, _ = active_pairs(positions, none.pairs, SETTINGS)
    assert not active.any() and float(smallest) == np.inf


@KIND
def test_vertices_may_be_numbered_in_any_order(kind):
    positions, contact = facing_sheets(kind)
    order = np.random.default_rng(3).permutation(len(positions))
    inverse = np.argsort(order)
    other = contact_of(inverse[contact.pairs.indices], contact.areas[order], kind)
    np.testing.assert_allclose(
        energy(positions[order], other), energy(positions, contact), rtol=1e-13
    )


@KIND
def test_active_pairs_are_those_with_energy(kind):
    positions, contact = facing_sheets(kind)
    active, smallest, _ = active_pairs(positions, contact.pairs, SETTINGS)
    squared = distances(positions, contact.pairs)
    np.testing.assert_array_equal(active, np.asarray(barrier(squared, SETTINGS)) > 0.0)
    assert 0 < int(active.sum()) < len(active)
    assert float(smallest) == float(squared.min())
    # No pair beyond dhat has a force.
    far = facing_sheets(kind, gap=2.0)
    assert not np.any(force(*far))


def test_energy_of_one_vertex_above_a_face():
    """k w dhat b(d), with half of the vertex's own area."""
    d, area = 0.2, 0.7
    positions = jnp.array([[0.2, d, 0.2], [0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    areas = jnp.array([area, 5.0, 6.0, 7.0])
    one = np.arange(4)[:, None]
    value = energy(positions, contact_of(one, areas, PairKind.VERTEX_FACE))
    expected = 1.3 * 0.5 * area * 0.6 * float(barrier(jnp.asarray(d**2), SETTINGS))
    np.testing.assert_allclose(value, expected, rtol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 0.01, 0.5])
def test_energy_of_two_crossing_edges(angle):
    """Half the mean area of the four vertices, faded out as the edges become parallel."""
    d = 0.2
    cos, sin = np.cos(angle), np.sin(angle)
    positions = jnp.array([[-0.5, 0, 0], [0.5, 0, 0], [-cos, d, -sin], [cos, d, sin]])
    areas = jnp.array([0.1, 0.2, 0.3, 0.5])
    one = np.arange(4)[:, None]
    value = energy(positions, contact_of(one, areas, PairKind.EDGE_EDGE))
    ratio = min(sin**2 / 1e-3, 1.0)
    fade = (2.0 - ratio) * ratio
    expected = 1.3 * fade * 0.5 * 0.275 * 0.6 * float(barrier(jnp.asarray(d**2), SETTINGS))
    np.testing.assert_allclose(value, expected, rtol=1e-13)
    np.testing.assert_allclose(mollifier(positions[:, :, None]), [fade], rtol=1e-13)


@KIND
def test_blocks_are_the_part_along_the_normal(kind):
    """The Hessian of each pair without force times curvature of the distance.

    With D = d^2, v = w (x) n and E = c b(D): Hess E - c b' (Hess D - 2 v v^T).
    """
    positions, contact = facing_sheets(kind)
    squared, (points, _) = distances(positions, contact.pairs), stencils(positions, contact.pairs)
    reach = (float(SETTINGS.dhat) + float(SETTINGS.thickness)) ** 2
    keep = np.asarray(squared) < reach
    if kind is PairKind.EDGE_EDGE:
        keep &= np.asarray(mollifier(points)) == 1.0
    assert keep.sum() > 10
    weights, normal, stiffness = matrices(positions, contact)
    v = np.einsum("pm,km->mpk", weights, np.array(normal)).reshape(-1, 12)
    blocks = np.asarray(stiffness)[:, None, None] * v[:, :, None] * v[:, None, :]

    scale = contact.barrier_stiffness * SETTINGS.dhat * pair_areas(contact.areas, contact.pairs)

    @functools.partial(jax.jit, compiler_options=UNOPTIMIZED)
    @jax.vmap
    def oracle(x, c):
        def distance(x):
            return squared_distances(x[:, :, None], kind)[0]

        return jax.hessian(lambda x: c * barrier(distance(x), SETTINGS))(x), jax.hessian(distance)(
            x
        )

    full, curvature = (
        np.asarray(part).reshape(-1, 12, 12) for part in oracle(jnp.moveaxis(points, 2, 0), scale)
    )
    first = barrier_derivatives(squared, SETTINGS).first
    left_out = np.asarray(scale * first)[:, None, None] * (
        curvature - 2.0 * v[:, :, None] * v[:, None, :]
    )
    np.testing.assert_allclose(
        blocks[keep], (full - left_out)[keep], rtol=0, atol=1e-9 * np.abs(full).max()
    )
    # s >= 0 with s v v^T: positive semidefinite.
    stiffness = np.asarray(stiffness)
    assert np.all(stiffness[keep] > 0.0) and np.all(stiffness >= 0.0)


@KIND
def test_weights_and_normal_of_the_blocks(kind):
    positions, contact = facing_sheets(kind)
    weights, normal, _ = matrices(positions, contact)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1.0, rtol=1e-12)
    own = vertex_face_closest if kind is PairKind.VERTEX_FACE else edge_edge_closest
    points, _ = stencils(positions, contact.pairs)
    expected, squared = own(points)
    np.testing.assert_array_equal(closest(points, kind)[1], squared)
    np.testing.assert_allclose(weights, expected, rtol=0, atol=1e-14)


def _triangles(count: int, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Equilateral triangles on a rhombus, centred at the origin."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    flat = side * np.stack([(i + 0.5 * j).ravel(), np.sqrt(0.75) * j.ravel()], 1)
    k = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    p, q, r, s = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return flat - flat.mean(0), np.concatenate([np.stack([p, q, s], 1), np.stack([q, r, s], 1)])


def _sheet_energies(count: int, dhat: float) -> dict[PairKind, float]:
    """Energy per area of a unit sheet below a larger one, over k dhat b(d)."""
    settings = contact_settings(dhat=dhat, thickness=0.0)
    d, side = 0.5 * dhat, 1.0 / count
    lower, faces = _triangles(count, side)
    upper, upper_faces = _triangles(3 * count, side)
    cos, sin = np.cos(0.5), np.sin(0.5)
    upper = upper @ np.array([[cos, sin], [-sin, cos]]) + np.array([0.013, 0.027])
    n = len(lower)
    positions = np.zeros((LARGEST_MESH, 3))
    positions[:n, :2], positions[n : n + len(upper), :2] = lower, upper
    positions[n:, 2] = d
    all_faces = (faces, upper_faces + n)
    corner = np.sqrt(0.75) * side**2 / 6.0  # a third of a triangle
    areas = corner * np.bincount(np.concatenate(all_faces).ravel(), minlength=LARGEST_MESH)

    def near(first, second):
        centres = [positions[rows].mean(1)[:, :2] for rows in (first, second)]
        gaps = np.linalg.norm(centres[0][:, None] - centres[1][None], axis=2)
        a, b = np.nonzero(gaps < 1.01 * side + dhat)
        return np.concatenate([first[a], second[b]], axis=1)

    vertices = np.arange(n + len(upper))[:, None]
    rows = {
        PairKind.VERTEX_FACE: np.concatenate(
            [near(vertices[:n], all_faces[1]), near(vertices[n:], all_faces[0])]
        ),
        PairKind.EDGE_EDGE: near(*(unique_edges(part) for part in all_faces)),
    }
    unit = dhat * float(barrier(jnp.asarray(d**2), settings)) * np.sqrt(0.75)
    energies = {}
    for kind, pairs in rows.items():
        padded = jnp.asarray(pad_columns(pairs.T, MOST_PAIRS))
        padded = Pairs(padded, jnp.asarray(len(pairs)), jnp.ones(MOST_PAIRS), kind)
        stiffness = jnp.asarray(1.0, jnp.float64)
        contact = Contact(padded, jnp.asarray(areas), stiffness, settings)
        value = energy(jnp.asarray(positions), contact)
        energies[kind] = float(value) / unit
    return energies


def test_parallel_sheets_under_refinement():
    """The energy per area of two facing sheets does not depend on the mesh while dhat is small.

    Triangles are 80 to 250 times longer than dhat; a vertex then sees one face, and half of the
    area of either sheet adds up to one. The number of crossings of two edge networks per area is
    2/pi times the product of their lengths per area: for equilateral triangles in general position
    edge pairs add 6 sqrt(3) / pi = 3.31. (Once triangles are as short as dhat, a vertex sees
    several faces and the energy grows.)
    """
    by_kind = [_sheet_energies(count, dhat=1e-3) for count in (4, 8, 12)]
    for kind, limit in ((PairKind.VERTEX_FACE, 1.0), (PairKind.EDGE_EDGE, 6.0 * 3.0**0.5 / np.pi)):
        values = np.array([energies[kind] for energies in by_kind])
        np.testing.assert_allclose(values, limit, rtol=SHEET_TOLERANCE)


def test_one_bucket_is_one_program():
    """A new count or new indices of the same shape run the same program."""
    traces = []

    @jax.jit
    def counted(positions, contact):
        traces.append(contact.pairs.kind)
        return contact_energy(positions, contact)

    positions, contact = facing_sheets(PairKind.VERTEX_FACE)
    indices, count = contact.pairs.indices, contact.pairs.count
    for used in (count, count - 3, jnp.asarray(0)):
        counted(positions, with_pairs(contact, count=used))
    other = with_pairs(contact, indices=indices[:, ::-1])
    counted(positions, replace(other, barrier_stiffness=2.0 * contact.barrier_stiffness))
    assert traces == [PairKind.VERTEX_FACE]
    counted(positions, with_pairs(contact, kind=PairKind.EDGE_EDGE))
    assert len(traces) == 2
