"""Gathered seams: the short side is not stretched, and both sides have derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.gathers import find_gathers, gathered_corners, gathered_triangles
from dress_jax.energy.membrane import principal_stretches
from dress_jax.energy.rest import rest_triangles
from dress_jax.sim import make_cloth, make_simulator, static_solve
from dress_jax.solver import NewtonOptions
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT

ROWS, COLUMNS, STEP = 4, 7, 0.02


def cuff_and_sleeve(fullness: float):
    """Two rectangles, one sewn to the other, `fullness` times as wide.

    Returns:
        Rest positions (p, 2), rest triangles and welded ones (f, 3), welded vertex of each panel
        vertex (p,), and panel of each triangle: 0 the narrow one.
    """
    rests, triangles, count = [], [], ROWS * COLUMNS
    for panel, width in enumerate((1.0, fullness)):
        j, i = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
        rests.append(STEP * np.stack([width * i.ravel(), j.ravel() + 0.3 * (i.ravel() % 2)], 1))
        k = np.arange(count).reshape(ROWS, COLUMNS) + panel * count
        p, q, r, s = (a.ravel() for a in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
        triangles.append(np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)]))
    weld = np.arange(2 * count)
    weld[count : count + COLUMNS] = np.arange(COLUMNS) + (ROWS - 1) * COLUMNS
    weld[count + COLUMNS :] -= COLUMNS
    rest_faces = np.concatenate(triangles)
    return np.concatenate(rests), rest_faces, weld[rest_faces], weld, rest_faces[:, 0] // count


def test_seams_that_are_eased_or_impossible_are_no_gathers():
    for fullness in (1.15, 8.0):
        rest, rest_faces, faces, _, _ = cuff_and_sleeve(fullness)
        assert len(find_gathers(faces, rest_faces, rest).faces) == 0
    rest, rest_faces, faces, _, panel = cuff_and_sleeve(1.6)
    found = find_gathers(faces, rest_faces, rest)
    assert len(found.faces) == COLUMNS - 1
    assert np.all(panel[np.asarray(found.faces)] == 1)


def test_the_shape_is_drawn_up_along_the_seam_only():
    """A triangle with its edge as long as the short side's, and its height as cut, is at rest."""
    rest, rest_faces, faces, _, _ = cuff_and_sleeve(1.6)
    gathers = find_gathers(faces, rest_faces, rest)
    triangles = gathered_triangles(jnp.asarray(rest), jnp.asarray(rest_faces.T), gathers)
    flat = rest_triangles(jnp.asarray(rest), jnp.asarray(rest_faces.T))
    assert np.array_equal(triangles.areas, flat.areas)
    corners = rest[rest_faces]
    on_the_host = gathered_corners(rest, rest_faces, gathers)
    for number, face in enumerate(np.asarray(gathers.faces)):
        own = rest[np.asarray(gathers.own)[:, number]]
        other = rest[np.asarray(gathers.other)[:, number]]
        edge = own[1] - own[0]
        ratio = np.linalg.norm(other[1] - other[0]) / np.linalg.norm(edge)
        assert ratio < 0.8
        u = edge / np.linalg.norm(edge)
        drawn_up = corners[face] + (ratio - 1.0) * (corners[face] @ u)[:, None] * u
        np.testing.assert_allclose(on_the_host[face], drawn_up, rtol=0, atol=1e-15)
        position = np.c_[drawn_up, np.zeros(3)]
        one = jax.tree.map(lambda leaf, face=face: leaf[face : face + 1], triangles)
        stretches = principal_stretches(jnp.asarray(position), jnp.asarray([[0], [1], [2]]), one)
        np.testing.assert_allclose(np.concatenate(stretches), 1.0, rtol=0, atol=1e-12)
    rest_of_them = np.setdiff1d(np.arange(len(faces)), np.asarray(gathers.faces))
    assert np.array_equal(on_the_host[rest_of_them], corners[rest_of_them])
    for drawn, plain in zip(triangles.inverse, flat.inverse, strict=True):
        assert np.array_equal(drawn[rest_of_them], plain[rest_of_them])


def test_a_corner_is_drawn_up_along_its_longer_gather():
    """A square sewn to shorter strips along two sides, of a half and of a third of its lengths."""
    count, rest, rest_faces, faces = 4, [], [], []

    def strip(start, step, along, across, welded):
        """One row of triangles whose first vertices are those of the square's side."""
        first = len(rest)
        for k in range(count + 1):
            rest.extend([start + k * step * along, start + k * step * along + 0.5 * across])
        for k in range(count):
            p, q, r = first + 2 * k, first + 2 * k + 2, first + 2 * k + 1
            rest_faces.append([p, q, r])
            faces.append([welded[k], welded[k + 1], first + 2 * k + 1])

    j, i = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    rest.extend(np.stack([i.ravel(), j.ravel()], 1).astype(float))
    k = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    p, q, r, s = (part.ravel() for part in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    # The first square is cut so that one triangle has both of its sewn sides.
    square = np.concatenate([np.stack([p, q, s], 1), np.stack([q, r, s], 1)])
    rest_faces.extend(square.tolist())
    faces.extend(square.tolist())
    right, up = np.eye(2)
    strip(np.array([9.0, 0.0]), 1 / 2, right, -up, k[0])
    strip(np.array([0.0, 9.0]), 1 / 3, up, -right, k[:, 0])
    rest, rest_faces, faces = np.array(rest), np.array(rest_faces), np.array(faces)
    found = find_gathers(faces, rest_faces, rest)
    owners = np.asarray(found.faces).tolist()
    assert len(owners) == len(set(owners)) == 2 * count - 1
    own = np.asarray(found.own)[:, owners.index(0)]
    assert sorted(own.tolist()) == [0, count + 1]


def test_fine_segments_are_no_gathers():
    """A cuff, with a mesh beside it that is twenty times as coarse."""
    rest, rest_faces, faces, _, _ = cuff_and_sleeve(1.6)
    coarse = 20 * STEP * np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) + 9.0
    assert len(find_gathers(faces, rest_faces, rest).faces) == COLUMNS - 1
    first = np.arange(2 * len(faces))[:, None] * 4 + len(rest)
    more = np.concatenate([first + k for k in ([0, 1, 2], [1, 3, 2])])
    fine = np.concatenate([rest, np.tile(coarse, (len(first), 1))])
    both = [np.concatenate([part, more]) for part in (faces, rest_faces)]
    assert len(find_gathers(*both, fine).faces) == 0


@pytest.fixture(scope="module")
def hanging():
    """A cuff held at its far edge, a fuller sleeve hanging from it."""
    rest, rest_faces, faces, weld, panel = cuff_and_sleeve(1.6)
    pins = np.arange(COLUMNS)
    unique, first = np.unique(weld, return_index=True)
    cloth = make_cloth(faces, rest_faces, rest_positions=rest, pins=pins)
    x = rest[first]
    middle = 0.5 * STEP * (COLUMNS - 1)
    below = unique >= ROWS * COLUMNS
    high = x[:, 1] + np.where(below, (ROWS - 1) * STEP, 0.0)
    width = np.where(below, 1.0 / 1.6, 1.0)
    wave = 0.004 * np.where(below, np.cos(np.pi * x[:, 0] / (1.6 * STEP)), 0.0)
    start = np.stack([width * x[:, 0] - middle, -high, wave], 1)
    simulator = make_simulator(
        cloth, start, newton=NewtonOptions(tolerance=1e-12, iteration_limit=300)
    )
    parameters = make_parameters(cloth, SOFT, rest, pin_targets=jnp.asarray(start[pins]))
    parameters = replace(parameters, pin_stiffness=jnp.asarray(1e3))
    return simulator, parameters, start, panel


def _stretches(simulator, parameters, positions) -> np.ndarray:
    cloth = simulator.cloth
    rest = gathered_triangles(parameters.rest_positions, cloth.rest_faces, cloth.gathers)
    return np.stack(principal_stretches(positions, cloth.faces, rest))


def test_a_full_sleeve_does_not_stretch_its_cuff(hanging):
    simulator, parameters, start, panel = hanging
    drape = static_solve(simulator, parameters, start, time_step=None)
    assert drape.report.converged and drape.report.intersection_free
    stretches = _stretches(simulator, parameters, drape.positions)
    assert np.max(np.abs(stretches[:, panel == 0] - 1.0)) < 0.1

    plain = make_cloth(
        np.asarray(simulator.cloth.faces).T,
        np.asarray(simulator.cloth.rest_faces).T,
        pins=np.asarray(simulator.cloth.pins),
    )
    other = make_simulator(plain, start, newton=simulator.newton)
    pressed = static_solve(other, parameters, start, time_step=None)
    assert pressed.report.converged
    assert _stretches(other, parameters, pressed.positions)[0, panel == 0].max() > 1.15


def test_derivatives_in_both_sides_of_the_seam(hanging):
    """Adjoint against differences along random motions of each panel's rest shape."""
    simulator, parameters, start, _ = hanging
    rng = np.random.default_rng(3)
    weights = jnp.asarray(rng.normal(size=start.shape))

    def measure(rest):
        own = replace(parameters, rest_positions=rest)
        return jnp.sum(weights * static_solve(simulator, own, start, time_step=None).positions)

    rest = parameters.rest_positions
    gradient = jax.grad(measure)(rest)
    for own in (np.arange(len(rest)) < ROWS * COLUMNS, np.arange(len(rest)) >= ROWS * COLUMNS):
        direction = jnp.asarray(rng.normal(size=rest.shape) * own[:, None])
        slope = float(jnp.vdot(gradient, direction))
        expected = central_difference(lambda s, d=direction: float(measure(rest + s * d)), 1e-6)
        assert abs(slope) > 1e-3
        assert slope == pytest.approx(expected, rel=1e-5)
