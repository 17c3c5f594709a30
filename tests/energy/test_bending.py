import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energy_scenes import columns, garment, rotation

from dress_jax.core import components as c
from dress_jax.energy.bending import bending_energy, bending_vectors, hinge_angle
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.elastic import rest_hinges
from dress_jax.energy.rest import hinge_anisotropy, hinge_weights, rest_triangles
from tests.central_differences import UNOPTIMIZED

K = 0.7
HINGE = jnp.array([[0], [1], [2], [3]])


def _folded(angle, *, edge=1.3, heights=(0.8, 0.5)):
    """Two triangles at an edge along z; the second is turned out of the plane by `angle`."""
    left = [heights[0], 0.0, 0.4 * edge]
    right = [-heights[1] * np.cos(angle), heights[1] * np.sin(angle), 0.7 * edge]
    return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, edge], left, right])


@pytest.mark.parametrize("angle", [-3.0, -1.2, -1e-6, 0.0, 1e-6, 0.3, 1.5, 3.1])
def test_energy_of_one_hinge(angle):
    """k/2 theta^2 e/h with a hand-made weight.

    The angle is negative where the second face rises to the side of the normals.
    """
    x = _folded(angle)
    both = jnp.asarray(np.stack([x, x * [1, -1, 1]], axis=2))
    theta, mirrored = np.asarray(hinge_angle(*(tuple(point) for point in both)))
    assert theta == pytest.approx(-angle, abs=1e-14)  # rounding near a full fold
    assert mirrored == pytest.approx(angle, abs=1e-14)
    weight = 2.3
    energy = bending_energy(columns(x), HINGE, jnp.array([weight]), jnp.asarray(K))
    np.testing.assert_allclose(energy, 0.5 * K * weight * angle**2, rtol=1e-12, atol=1e-20)


def test_weights_take_the_mean_of_two_rest_lengths():
    """A gather: the shared edge measures 1 in one panel and 1.5 in the other."""
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    rest_faces = np.array([[0, 1, 2], [4, 3, 5]])
    rest = np.array([[0.0, 0], [1, 0], [0, 1], [5, 0], [6.5, 0], [5, -1]])
    cloth = make_cloth(faces, rest_faces)
    triangles = rest_triangles(jnp.asarray(rest), cloth.rest_faces)
    np.testing.assert_allclose(triangles.areas, [0.5, 0.75])
    arguments = (cloth.rest_faces, triangles.areas, cloth.hinge_faces, cloth.hinge_corners)
    weights = hinge_weights(jnp.asarray(rest), *arguments)
    welded = hinge_weights(jnp.asarray(rest).at[4, 0].set(6.0), *arguments)
    # e^2 over the areas: the lengths enter, not the area alone.
    np.testing.assert_allclose(weights / welded, (1.25 / 1.0) ** 2)


def test_flat_and_rigidly_moved():
    """Zero when flat, whatever the stretch; unchanged by a rigid motion."""
    cloth, parameters, _, positions = garment()

    def energy(x):
        return plate_energy(jnp.asarray(x), parameters.rest_positions, cloth)

    rng = np.random.default_rng(1)
    turn, shift = rotation(rng), rng.normal(size=3)
    flat = 1.3 * np.pad(np.asarray(parameters.rest_positions), [(0, 0), (0, 1)])
    np.testing.assert_allclose(energy(flat @ turn.T + shift), 0.0, atol=1e-25)
    assert energy(positions) > 1e-3
    np.testing.assert_allclose(energy(positions @ turn.T + shift), energy(positions), rtol=1e-12)


def _equilateral(count: int) -> tuple[np.ndarray, np.ndarray]:
    """A parallelogram of side one made of equilateral triangles."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    rest = np.stack([(i + 0.5 * j).ravel(), np.sqrt(0.75) * j.ravel()], 1) / count
    k = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    p, q, r, s = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return rest, np.concatenate([np.stack([p, q, s], 1), np.stack([q, r, s], 1)])


@jax.jit
def plate_energy(positions, rest, cloth):
    """Bending energy of a cloth with the stiffness K."""
    areas = rest_triangles(rest, cloth.rest_faces).areas
    weights = hinge_weights(rest, cloth.rest_faces, areas, cloth.hinge_faces, cloth.hinge_corners)
    return bending_energy(c.split(positions), cloth.hinges, weights, jnp.asarray(K))


@pytest.mark.parametrize("direction", [0.0, 0.4])
def test_rolled_sheet_has_the_energy_of_a_plate(direction):
    """Rolling onto a cylinder costs k/2 curvature^2 area: k is the flexural rigidity.

    On equilateral triangles the limit does not depend on the direction (Seung and Nelson 1988:
    an edge spring K theta^2/2 on that lattice has the rigidity sqrt(3)/2 K). Edges of the sheet
    have no hinge, so half a row of triangles is missing at each border and the error is O(1/n):
    one extrapolation removes that.
    """
    radius = 2.0
    ratios = []
    for count in (8, 16):
        rest, faces = _equilateral(count)
        cloth = make_cloth(faces)
        axis = np.array([np.cos(direction), np.sin(direction)])
        u, v = rest @ axis, rest @ [-axis[1], axis[0]]
        rolled = np.stack([radius * np.sin(u / radius), v, radius * np.cos(u / radius)], 1)
        energy = plate_energy(jnp.asarray(rolled), jnp.asarray(rest), cloth)
        ratios.append(float(energy) / (0.5 * K / radius**2 * np.sqrt(0.75)))
    extrapolated = 2.0 * ratios[1] - ratios[0]
    assert abs(ratios[1] - 1.0) < abs(ratios[0] - 1.0) < 0.08  # O(1/n) with n = 8
    assert extrapolated == pytest.approx(1.0, abs=2e-3)  # O(1/n^2)


def test_blocks_are_the_outer_product():
    """s v v^T with v the angle's gradient: the Hessian of k/2 w theta^2 without theta's own."""
    cloth, parameters, _, positions = garment()
    weights = rest_hinges(parameters, cloth)
    vectors, stiffness = bending_vectors(columns(positions), cloth.hinges, weights, jnp.asarray(K))
    v = np.asarray(vectors).transpose(2, 0, 1).reshape(-1, 12)
    blocks = np.asarray(stiffness)[:, None, None] * v[:, :, None] * v[:, None, :]

    points = jnp.asarray(positions)[cloth.hinges.T]

    def angle(x):
        return hinge_angle(*(tuple(x[p, k] for k in range(3)) for p in range(4)))

    @functools.partial(jax.jit, compiler_options=UNOPTIMIZED)
    @jax.vmap
    def oracle(x, weight):
        full = jax.hessian(lambda x: 0.5 * K * weight * angle(x) ** 2)(x)
        return full - K * weight * angle(x) * jax.hessian(angle)(x)

    expected = np.asarray(oracle(points, weights)).reshape(-1, 12, 12)
    np.testing.assert_allclose(blocks, expected, rtol=0, atol=1e-11 * blocks.max())
    eigenvalues = np.linalg.eigvalsh(blocks)
    assert np.all(eigenvalues[:, 0] >= -1e-13 * eigenvalues[:, -1])
    assert np.all(eigenvalues[:, -1] > 0.0)


def test_force_opens_a_fold():
    """Near a full fold the angle keeps a derivative, and the force still opens it."""
    x = jnp.asarray(_folded(3.0))
    gradient = jax.grad(
        lambda x: bending_energy(c.split(x), HINGE, jnp.array([1.0]), jnp.asarray(1.0))
    )(x)
    opening = (_folded(2.9) - _folded(3.0)) / 0.1
    slope = float(np.vdot(gradient, opening))
    # dE = theta dtheta, and dtheta = -1 along the opening; the chord is 0.05 rad off the arc.
    assert slope == pytest.approx(-3.0, rel=0.01)


def test_warp_and_weft_of_a_rolled_sheet():
    """Rolled along the warp it has B_warp, along the weft B_weft, in the mean over the mesh.

    On equilateral triangles a harmonic cos 6 phi of the lattice is left, of opposite sign for a
    warp that is turned by 30 degrees: the mean of the two has none.
    """
    warp, weft = 1.0, 0.4
    mean, anisotropy = 0.5 * (warp + weft), (warp - weft) / (warp + weft)
    radius = 2.0

    @jax.jit
    def energy(positions, rest, cloth, grain):
        hinges = cloth.hinge_faces, cloth.hinge_corners
        areas = rest_triangles(rest, cloth.rest_faces).areas
        weights = hinge_weights(rest, cloth.rest_faces, areas, *hinges)
        factors = hinge_anisotropy(rest, cloth.rest_faces, *hinges, jnp.asarray(anisotropy), grain)
        stiffness = jnp.asarray(mean)
        return bending_energy(c.split(positions), cloth.hinges, weights * factors, stiffness)

    def rigidity(grain, turn):
        """Across the cylinder's axis, at an angle to the warp; extrapolated to a fine mesh."""
        values = []
        for count in (8, 16):
            rest, faces = _equilateral(count)
            direction = np.pi / 2 + grain + turn
            axis = np.array([np.cos(direction), np.sin(direction)])
            u, v = rest @ axis, rest @ [-axis[1], axis[0]]
            rolled = np.stack([radius * np.sin(u / radius), v, radius * np.cos(u / radius)], 1)
            value = energy(
                jnp.asarray(rolled), jnp.asarray(rest), make_cloth(faces), jnp.asarray(grain)
            )
            values.append(float(value) / (0.5 / radius**2 * np.sqrt(0.75)))
        return 2.0 * values[1] - values[0]

    for turn, expected in ((0.0, warp), (np.pi / 2, weft)):
        both = [rigidity(grain, turn) for grain in (0.1, 0.1 + np.pi / 6)]
        assert np.mean(both) == pytest.approx(expected, rel=1e-2)  # O(1/n^2) of either
