"""The compiled kernels against a dense Hessian, and how often they are traced."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.contact.barrier import contact_settings
from dress_jax.contact.potential import CONTACT_PAIRS, PairKind, Pairs
from dress_jax.core import components as c
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.fabric import Fabric, make_parameters
from dress_jax.sim import kernels
from dress_jax.sim.matrices import PROJECTED
from dress_jax.sim.sparsity import elastic_slots, extended
from dress_jax.solver.block_matrix import (
    element_pairs,
    element_slots,
    empty_values,
    upper_triangle,
)

SOFT = Fabric(density=1.0, stretching_stiffness=2.0, bending_stiffness=0.3)
CAPACITY = 11


@pytest.fixture(scope="module")
def scene():
    """A strip of four triangles above a triangle of body: cloth, parameters, frame, positions."""
    rng = np.random.default_rng(0)
    rest = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1.1], [0, 2], [1, 2.1]])
    faces = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]])
    cloth = make_cloth(faces, pins=np.array([0]), stitches=np.array([[4, 1]]))
    body = np.array([[-2.0, -2, -0.2], [4, -2, -0.2], [0.5, 5, -0.2]])
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body)
    parameters = replace(parameters, barrier_stiffness=jnp.asarray(3.0))
    # Stretched throughout, so that no triangle needs a projection.
    positions = np.c_[1.2 * rest, 0.02 * rng.normal(size=6)]
    step = TimeStep(
        jnp.asarray(positions + 0.01 * rng.normal(size=(6, 3))),
        jnp.zeros((6, 3)),
        jnp.asarray(2.0),
    )
    settings = contact_settings(dhat=0.4, thickness=0.0, slip_speed=0.5)
    frame = kernels.make_frame(parameters, cloth, step, jnp.asarray(body), jnp.ones(3), settings)
    return cloth, parameters, frame, jnp.asarray(positions)


def _dense(pattern, values):
    triangle = upper_triangle(pattern, values).toarray()
    return triangle + np.triu(triangle, 1).T


def test_elastic_matrix_is_the_exact_hessian_of_a_flat_stretched_sheet(scene):
    """Flat, so bending has no second part; stretched, so nothing is projected."""
    cloth, parameters, frame, positions = scene
    flat = positions.at[:, 2].set(0.1)
    pattern, slots = elastic_slots(cloth.vertex_count, cloth)
    values = PROJECTED.elastic(flat, parameters, cloth, frame, slots, capacity=pattern.capacity)
    eye = jnp.eye(18).reshape(18, 6, 3)
    exact = np.stack(
        [kernels.ELASTIC.product(flat, d, parameters, cloth, frame).ravel() for d in eye]
    )
    scale = np.abs(exact).max()
    # theta is of order 1e-9 where the arctangent of a flat hinge is rounded.
    np.testing.assert_allclose(_dense(pattern, values), exact, rtol=0, atol=1e-8 * scale)


def _pairs(rows, *, kind=PairKind.VERTEX_FACE, capacity=CAPACITY) -> Pairs:
    """Pairs padded to a capacity that no other test uses."""
    padded = np.zeros((4, capacity), np.int32)
    padded[:, : len(rows)] = np.array(rows, np.int32).T
    return Pairs(jnp.asarray(padded), jnp.asarray(len(rows), jnp.int32), jnp.ones(capacity), kind)


BODY_PAIRS = [[vertex, 6, 7, 8] for vertex in range(6)]
SELF_PAIRS = [[5, 0, 1, 2], [0, 3, 5, 4]]


def test_contact_matrix_against_the_exact_hessian(scene):
    """Vertices over the inside of a flat body triangle: only the part along the normal exists.

    The body's vertices are fixed; cloth blocks alone remain.
    """
    cloth, parameters, frame, positions = scene
    pairs = _pairs(BODY_PAIRS)
    pattern, _ = elastic_slots(cloth.vertex_count, cloth)
    slots = element_slots(pattern, np.asarray(pairs.indices), CONTACT_PAIRS)
    values = PROJECTED.barrier(
        empty_values(pattern.capacity), positions, parameters, frame, pairs, slots
    )
    eye = jnp.eye(18).reshape(18, 6, 3)
    arguments = (parameters, cloth, frame, pairs)
    exact = np.stack([kernels.BARRIER.product(positions, d, *arguments).ravel() for d in eye])
    assert np.abs(exact).max() > 0.1
    np.testing.assert_allclose(
        _dense(pattern, values), exact, rtol=0, atol=1e-11 * np.abs(exact).max()
    )


def test_friction_matrix_at_rest(scene):
    """At the start of a step the friction blocks are the exact Hessian."""
    cloth, parameters, frame, _ = scene
    pairs = _pairs(BODY_PAIRS)
    start = frame.step.start
    pattern, _ = elastic_slots(cloth.vertex_count, cloth)
    slots = element_slots(pattern, np.asarray(pairs.indices), CONTACT_PAIRS)
    arguments = (parameters, cloth, frame, pairs)
    values = PROJECTED.sliding(
        empty_values(pattern.capacity), start, parameters, frame, pairs, slots
    )
    exact = np.stack(
        [
            kernels.SLIDING.product(start, d, *arguments).ravel()
            for d in jnp.eye(18).reshape(18, 6, 3)
        ]
    )
    assert np.abs(exact).max() > 0.01
    np.testing.assert_allclose(
        _dense(pattern, values), exact, rtol=0, atol=1e-11 * np.abs(exact).max()
    )


def test_self_contact_extends_the_pattern(scene):
    cloth, _, _, _ = scene
    pattern, _ = elastic_slots(cloth.vertex_count, cloth)
    wanted = element_pairs(np.array(SELF_PAIRS).T, CONTACT_PAIRS)
    assert not pattern.find(*wanted)[2]
    larger, slots = extended(cloth, pattern, [wanted])
    assert larger.find(*wanted)[2]
    np.testing.assert_array_equal(larger.rows[np.asarray(slots.diagonal)], np.arange(6))
    np.testing.assert_array_equal(larger.cols[np.asarray(slots.diagonal)], np.arange(6))


def test_kernels_are_traced_once_per_bucket(scene, monkeypatch):
    """New pairs, counts, positions and parameters of the same shape run the same program."""
    traces = []
    original = kernels.contact_energy

    def counted(positions, contact):
        traces.append(contact.pairs.kind)
        return original(positions, contact)

    monkeypatch.setattr(kernels, "contact_energy", counted)
    cloth, parameters, frame, positions = scene

    def run(rows, factor=1.0, *, kind=PairKind.VERTEX_FACE, capacity=CAPACITY + 2):
        pairs = _pairs(rows, kind=kind, capacity=capacity)
        stiffer = replace(parameters, barrier_stiffness=factor * parameters.barrier_stiffness)
        kernels.BARRIER.value(factor * positions, stiffer, cloth, frame, pairs)

    run(BODY_PAIRS)
    assert len(traces) == 1
    run(BODY_PAIRS[:2], 1.1)
    run(SELF_PAIRS, 0.9)
    assert len(traces) == 1
    run(BODY_PAIRS, kind=PairKind.EDGE_EDGE)
    assert len(traces) == 2
    run(BODY_PAIRS, capacity=CAPACITY + 3)
    assert len(traces) == 3


def test_elastic_kernel_is_traced_once(scene, monkeypatch):
    traces = []
    original = kernels.elastic_energy

    def counted(*arguments):
        traces.append(1)
        return original(*arguments)

    monkeypatch.setattr(kernels, "elastic_energy", counted)
    _, _, frame, _ = scene
    # A mesh of a size of its own: other tests have compiled theirs.
    faces = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4]])
    rest = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1.1], [0, 2]])
    cloth = make_cloth(faces)
    positions = jnp.asarray(np.c_[rest, np.zeros(5)])
    step = TimeStep(positions, jnp.zeros((5, 3)), jnp.asarray(2.0))
    frame = replace(frame, step=step)
    for factor in (1.0, 1.2):
        parameters = make_parameters(cloth, SOFT, factor * rest)
        value, gradient = kernels.ELASTIC.gradient(factor * positions, parameters, cloth, frame)
        assert np.isfinite(value) and len(c.split(gradient)) == 3
    assert len(traces) == 1
    jax.block_until_ready(gradient)
