"""Shape buckets: what is padded changes nothing, and garments of similar size share programs."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import kernels, make_cloth, make_simulator, matrices, static_solve
from dress_jax.sim.objective import resting_objective
from dress_jax.sim.padding import _COUNTED, make_padding
from tests.sim.scenes import SOFT, ball, draped_sheet, level, sheet


def _parameters(cloth, rest, body, pins):
    return make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)


def test_padded_elements_have_neither_energy_nor_force():
    """Against the energies of the same arrays without padding."""
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = _parameters(cloth, rest, body, start[np.asarray(cloth.pins)])
    parameters = replace(parameters, gravity=jnp.zeros(3))  # what is padded has a weight
    x = start + 0.002 * np.cos(np.arange(start.size)).reshape(start.shape)
    objective = resting_objective(simulator, parameters, start)
    padding = simulator.padding
    assert padding.padded.faces > padding.true.faces + 2
    frame = kernels.make_frame(
        parameters,
        cloth,
        TimeStep(jnp.asarray(start), jnp.zeros_like(jnp.asarray(start)), jnp.asarray(1.0)),
        parameters.body_vertices,
        simulator.body_areas,
        simulator.settings,
    )
    expected, force = kernels.ELASTIC.gradient(x, parameters, cloth, frame)
    value, gradient = kernels.ELASTIC.gradient(
        padding.positions(x), padding.parameters(parameters), padding.cloth, objective.frame
    )
    assert float(value) == pytest.approx(float(expected), rel=1e-12)
    n = len(x)
    assert np.allclose(np.asarray(gradient)[:n], np.asarray(force), rtol=0, atol=1e-12)
    assert not np.any(np.asarray(gradient)[n:])


def test_per_triangle_values_are_padded():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = _parameters(cloth, rest, body, start[np.asarray(cloth.pins)])
    densities = jnp.linspace(0.1, 0.3, cloth.faces.shape[1])
    varied = replace(parameters, density=densities)
    padding = simulator.padding
    padded = padding.parameters(varied)
    assert padded.density.shape == (padding.padded.faces,)
    assert padded.stretching_stiffness.shape == ()
    assert np.array_equal(np.asarray(padded.density)[: len(densities)], np.asarray(densities))
    with pytest.raises(InputError, match="density has 3 rows"):
        padding.parameters(replace(parameters, density=jnp.ones(3)))


def test_every_parameter_is_known_to_padding():
    """A leaf that counts something must be padded; the others are the same for every garment."""
    names = {field.name for field in dataclasses.fields(Parameters)}
    same = {"gravity", "pin_stiffness", "stitch_stiffness", "barrier_stiffness"}
    assert names == {name.split(".")[0] for name in _COUNTED} | same | {"friction_coefficient"}


def test_similar_garments_share_a_bucket():
    sizes = {
        make_padding(make_cloth(sheet(count, 0.3)[1]), bodies).padded
        for count, bodies in ((30, 1000), (31, 1010), (32, 1020))
    }
    assert len(sizes) == 1
    for count in (5, 12, 40, 90):
        padding = make_padding(make_cloth(sheet(count, 0.3)[1]), 2000)
        assert padding.padded.faces <= max(1.25 * padding.true.faces, 128)


def test_another_garment_of_similar_size_compiles_nothing():
    """Neither the solve nor its pieces are traced again."""
    body, body_faces = ball(0.08)

    def drape(count: int):
        rest, faces = sheet(count, 0.3)
        cloth = make_cloth(faces, pins=np.array([0, count - 1]))
        start = level(rest, 0.085)
        simulator = make_simulator(cloth, start, body_vertices=body, body_faces=body_faces)
        parameters = _parameters(cloth, rest, body, start[np.asarray(cloth.pins)])
        assert static_solve(simulator, parameters, start).report.intersection_free

    programs = [
        kernels.ELASTIC.value,
        kernels.ELASTIC.gradient,
        matrices._exact_stencils,
        kernels.BARRIER.value,
        kernels.barrier_slopes,
        kernels.find_active,
        matrices._elastic_stencils,
        matrices._projected_entries,
    ]
    drape(16)
    before = [program._cache_size() for program in programs]
    assert all(before)
    drape(15)
    assert [program._cache_size() for program in programs] == before


def test_rest_positions_of_other_garments_are_left_out():
    """The garments of an outfit share one array of panel vertices when they are put on."""
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = _parameters(cloth, rest, body, start[np.asarray(cloth.pins)])
    more = replace(parameters, rest_positions=jnp.concatenate([rest, 7.0 + np.ones((500, 2))]))

    def height(p):
        return jnp.sum(static_solve(simulator, p, start).positions[:, 1])

    value, slope = jax.value_and_grad(height)(parameters)
    other, slopes = jax.value_and_grad(height)(more)
    assert float(other) == float(value)
    assert np.array_equal(slopes.rest_positions[: len(rest)], slope.rest_positions)
    assert np.any(slope.rest_positions) and not np.any(slopes.rest_positions[len(rest) :])
