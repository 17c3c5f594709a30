"""The barrier on stretches: closed form, derivatives, and how far a step may go."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energy_scenes import columns, stretched_triangles

from dress_jax.core import components as c
from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.deformation import principal_frame
from dress_jax.energy.fabric import FABRICS, make_parameters
from dress_jax.energy.membrane import (
    TRIANGLE_PAIRS,
    MembraneFrame,
    membrane_blocks,
    principal_stretches,
)
from dress_jax.energy.rest import RestTriangles, rest_triangles
from dress_jax.energy.strain_limit import (
    StrainLimit,
    strain_limit_energy,
    strain_limit_hessian,
    strain_step_bound,
)
from tests.central_differences import UNOPTIMIZED, check_energy_derivatives

LIMIT = 1.2
STIFFNESS = 0.7
# One, both, equal, all but equal, at the onset (1.1), near the limit, and none beyond the onset.
STRETCHES = np.array(
    [
        [1.15, 0.8],
        [1.18, 1.12],
        [1.15, 1.15],
        [1.15 + 1e-7, 1.15],
        [1.15 + 1e-5, 1.15],
        [1.1005, 1.0995],
        [1.199, 0.3],
        [1.199, 1.198],
        [1.09, 0.5],
        [1.0, 1.0],
    ]
)


def limit(stretch=LIMIT) -> StrainLimit:
    return StrainLimit(jnp.asarray(stretch), jnp.asarray(STIFFNESS))


def barrier(sigma: np.ndarray) -> np.ndarray:
    """b, as the paper writes it: -((s0 - sigma) / (s - s0))^2 ln((s - sigma) / (s - s0))."""
    onset = 0.5 * (1.0 + LIMIT)
    width = LIMIT - onset
    value = -(((onset - sigma) / width) ** 2) * np.log((LIMIT - sigma) / width)
    return np.where(sigma > onset, value, 0.0)


def test_energy_in_closed_form():
    positions, faces, rest, _ = stretched_triangles(STRETCHES)
    for k, sigma in enumerate(STRETCHES):
        one = jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], rest)
        value = strain_limit_energy(columns(positions), jnp.asarray(faces[:, [k]]), one, limit())
        expected = STIFFNESS * float(one.areas[0]) * barrier(sigma).sum()
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-14)
        assert (expected == 0.0) == (sigma[0] <= 1.1)


@pytest.mark.parametrize("stretches", [[1.2000001, 0.9], [1.3, 1.3], [1.5, 1.1]])
def test_energy_is_infinite_from_the_limit_on(stretches):
    positions, faces, rest, _ = stretched_triangles(np.array([stretches]))
    value = strain_limit_energy(columns(positions), jnp.asarray(faces), rest, limit())
    assert value == np.inf


@pytest.mark.parametrize("stretches", [[1.15, 0.8], [1.18, 1.12], [1.15, 1.15]])
def test_derivatives(stretches):
    positions, faces, _, flat = stretched_triangles(np.array([stretches]))

    def energy(x, flat, limit):
        rest = rest_triangles(flat, jnp.asarray(faces))
        return strain_limit_energy(c.split(x), jnp.asarray(faces), rest, limit)

    # Third derivatives are those of a barrier with a range of 0.1: a thousand times larger.
    arguments = (jnp.asarray(positions), jnp.asarray(flat), limit())
    check_energy_derivatives(energy, arguments, step=1e-6, tolerance=1e-6)


def test_hessian_is_exact_and_positive_semidefinite():
    positions, faces, rest, _ = stretched_triangles(STRETCHES)

    def energy(points, inverse, area):
        own = RestTriangles(inverse=jax.tree.map(lambda i: i[None], inverse), areas=area[None])
        stencil = tuple(points[:, k] for k in range(3))
        return strain_limit_energy(stencil, jnp.array([[0], [1], [2]]), own, limit())

    hessian = jax.jit(jax.vmap(jax.hessian(energy)), compiler_options=UNOPTIMIZED)
    points = jnp.asarray(positions).reshape(-1, 3, 3)
    expected = np.asarray(hessian(points, rest.inverse, rest.areas)).reshape(-1, 9, 9)
    frame = principal_frame(columns(positions), jnp.asarray(faces), rest)
    own = MembraneFrame(
        frame.axes, frame.alpha, frame.beta, strain_limit_hessian(frame, rest.areas, limit())
    )
    first, second = np.array(TRIANGLE_PAIRS).T
    rows = jax.tree.map(lambda leaf: leaf[None] if leaf.ndim == 1 else leaf, own)
    alpha, beta = ((part[first], part[second]) for part in (own.alpha, own.beta))
    blocks = np.array(membrane_blocks(rows, alpha, beta))
    found = np.zeros((len(STRETCHES), 3, 3, 3, 3))
    for k, (p, q) in enumerate(TRIANGLE_PAIRS):
        found[:, p, :, q, :] = blocks[:, :, k].transpose(2, 0, 1)
        found[:, q, :, p, :] = blocks[:, :, k].transpose(2, 1, 0)
    found = found.reshape(-1, 9, 9)
    scale = np.maximum(np.linalg.norm(expected, axis=(1, 2)), 1e-3)
    active = STRETCHES[:, 0] > 1.1
    assert np.all(np.linalg.norm(expected, axis=(1, 2))[active] > 0.0)
    error = np.linalg.norm(found - expected, axis=(1, 2)) / scale
    assert error.max() < 1e-6  # cancellation over the squared difference of the stretches
    assert np.all(np.linalg.eigvalsh(found)[:, 0] >= -1e-12 * scale)
    assert not np.any(found[~active])


def test_step_bound_stops_before_the_limit_and_no_earlier_than_it_must():
    """Against the first time, by dense sampling, at which nine tenths of the way are used up."""
    rng = np.random.default_rng(4)
    stretches = np.sort(rng.uniform(0.3, 1.19, (40, 2)), axis=1)[:, ::-1]
    positions, faces, rest, _ = stretched_triangles(stretches)
    faces = jnp.asarray(faces)
    displacement = rng.normal(size=positions.shape)
    times = np.linspace(0.0, 1.0, 4001)
    paths = np.array(
        [principal_stretches(positions + t * displacement, faces, rest)[0] for t in times]
    )
    goal = paths[0] + 0.9 * (LIMIT - paths[0])
    for k in range(len(stretches)):
        one = jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], rest)
        bound = float(strain_step_bound(positions, displacement, faces[:, k : k + 1], one, limit()))
        beyond = np.flatnonzero(paths[:, k] > goal[k])
        first = times[beyond[0]] if len(beyond) else 1.0
        assert 0.0 < bound <= first
        assert bound >= first - 1.01 * (times[1] - times[0])
        end = principal_stretches(positions + bound * displacement, faces[:, k : k + 1], one)[0]
        assert float(end[0]) < LIMIT
    every = float(strain_step_bound(positions, displacement, faces, rest, limit()))
    assert every < 1.0
    still = strain_step_bound(positions, 0.0 * displacement, faces, rest, limit())
    assert float(still) == 1.0


def test_a_limit_that_allows_nothing_is_refused():
    faces = np.array([[0, 1, 2]])
    rest = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    for value in (1.0, 0.5, np.nan, np.inf):
        with pytest.raises(InputError, match="strain limit"):
            make_parameters(make_cloth(faces), FABRICS["cotton"], rest, strain_limit=value)
    assert make_parameters(make_cloth(faces), FABRICS["cotton"], rest).strain_limit is None


def test_gradient_is_finite_where_nothing_is_stretched():
    """At rest and on a collapsed triangle, where square roots have no derivative."""
    rest = rest_triangles(jnp.array([[0.0, 0], [1, 0], [0, 1]]), jnp.array([[0], [1], [2]]))
    faces = jnp.array([[0], [1], [2]])
    for x in ([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0.0, 0, 0], [0.5, 0, 0], [0.9, 0, 0]]):
        gradient = jax.grad(lambda x: strain_limit_energy(c.split(x), faces, rest, limit()))(
            jnp.array(x)
        )
        np.testing.assert_array_equal(gradient, 0.0)
