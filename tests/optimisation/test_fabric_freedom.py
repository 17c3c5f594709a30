"""Fabrics per panel and along warp and weft as unknowns of a fit."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import FABRIC, hang, tube_pattern
from jax.test_util import check_grads

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import STRETCHING_LEAVES
from dress_jax.energy.membrane import MembraneModel
from dress_jax.optimisation import (
    FabricFreedom,
    FitOptions,
    GaussNewtonOptions,
    Landmark,
    fit,
    init,
    make_problem,
    named_values,
)
from dress_jax.optimisation.draping import fitted_parameters
from dress_jax.optimisation.fabric_freedom import likely_alike, make_fabric_table, with_fabric
from dress_jax.optimisation.gauss_newton.model import (
    make_model,
    make_reference,
    measure,
)
from dress_jax.optimisation.gauss_newton.vector import as_vector, from_vector
from dress_jax.optimisation.landmarks import landmark_weights
from dress_jax.optimisation.problem import rest_shape
from dress_jax.sim import static_solve

BOTH = FabricFreedom(per_panel=True, warp_weft=True)


@pytest.fixture(scope="module")
def woven():
    """The tube of an orthotropic fabric: pattern, discretization, simulator, parameters, start."""
    pattern = tube_pattern()
    return pattern, *hang(pattern, membrane=MembraneModel.ORTHOTROPIC, tolerance=1e-9)


def table_of(woven, freedom):
    pattern, mesh, simulator, *_ = woven
    return make_fabric_table(freedom, pattern, simulator.cloth, np.asarray(mesh.face_panel))


@pytest.mark.parametrize(
    "freedom", [FabricFreedom(), FabricFreedom(per_panel=True), FabricFreedom(warp_weft=True), BOTH]
)
def test_unknowns_scale_their_own_leaves(woven, freedom):
    table, parameters = table_of(woven, freedom), woven[3]
    count = len(table.names)
    assert count == (2 if not freedom.warp_weft else 5) * (2 if freedom.per_panel else 1)
    same = with_fabric(parameters, jnp.zeros(count), table)
    for name in (*STRETCHING_LEAVES, "bending_stiffness", "bending_anisotropy"):
        np.testing.assert_allclose(getattr(same, name), getattr(parameters, name), rtol=1e-15)
    front = np.asarray(woven[1].face_panel) == 0
    for number, kind in enumerate(table.kinds):
        values = np.zeros(count)
        values[number] = np.log(3.0)
        other = with_fabric(parameters, jnp.asarray(values), table)
        changed = {
            name
            for name in (*STRETCHING_LEAVES, "bending_stiffness", "bending_anisotropy")
            if not np.allclose(getattr(other, name), getattr(parameters, name))
        }
        expected = {
            "warp": "warp_stiffness",
            "weft": "weft_stiffness",
            "shear": "shear_stiffness",
            "bending": "bending_stiffness",
            "bending anisotropy": "bending_anisotropy",
        }
        if kind.value != "stretching":
            assert expected[kind.value] in changed
        else:
            assert changed >= set(STRETCHING_LEAVES)
        if freedom.per_panel and kind.value == "weft":
            own = front if table.groups[number] == 0 else ~front
            factor = np.asarray(other.weft_stiffness / parameters.weft_stiffness)
            np.testing.assert_allclose(factor, np.where(own, 3.0, 1.0))


def test_a_seam_takes_half_of_both_sides(woven):
    table, parameters = table_of(woven, FabricFreedom(per_panel=True)), woven[3]
    values = jnp.asarray([0.0, np.log(3.0), 0.0, 0.0])
    factor = np.asarray(
        with_fabric(parameters, values, table).bending_stiffness / parameters.bending_stiffness
    )
    assert set(np.round(factor, 12)) == {1.0, 2.0, 3.0}


def test_derivatives_of_the_leaves(woven):
    table, parameters = table_of(woven, BOTH), woven[3]
    parameters = replace(parameters, bending_anisotropy=jnp.asarray(0.3))
    weights = jnp.cos(jnp.arange(len(woven[1].face_panel)))

    def value(log):
        p = with_fabric(parameters, log, table)
        total = jnp.sum(weights * (p.warp_stiffness + p.weft_stiffness + 9 * p.shear_stiffness))
        total += 1e6 * jnp.sum(jnp.cos(jnp.arange(p.bending_stiffness.size)) * p.bending_stiffness)
        return total + jnp.sum(weights * p.bending_anisotropy)

    at = jnp.asarray(0.3 * np.sin(np.arange(10.0)))
    check_grads(value, (at,), order=1, modes=("fwd", "rev"), rtol=1e-5)
    assert np.abs(jax.grad(value)(at)).min() > 1e-3


def test_the_prior_holds_fabrics_together(woven):
    table = table_of(woven, FabricFreedom(per_panel=True))
    matrix = likely_alike(table, 7.0, 1.5)
    together, apart = np.array([1.0, 0, 1, 0]), np.array([1.0, 0, -1, 0])
    assert together @ matrix @ together == pytest.approx(1 / 49)
    assert apart @ matrix @ apart == pytest.approx(2 / 1.5**2)
    single = likely_alike(table_of(woven, FabricFreedom()), 7.0, 1.5)
    np.testing.assert_allclose(single, np.eye(2) / 49)


def test_an_isotropic_membrane_has_no_warp(problem):
    with pytest.raises(InputError, match="no warp and weft"):
        make_fabric_table(
            BOTH,
            problem.pattern,
            problem.simulator.cloth,
            np.asarray(problem.discretization.face_panel),
        )


def rigid_pattern(**changes):
    """Options under which the pattern stays what it is."""
    held = {name: 1e-4 for name in ("shape_scale", "size_scale", "control_scale", "pin_scale")}
    return GaussNewtonOptions(**{**held, "landmark_scale": 1e-3, "recenterings": 0, **changes})


def with_marks(woven, observation, fabrics, options):
    """The tube of one fabric, with landmarks where its drape with other fabrics has them."""
    pattern, mesh, simulator, parameters, start = woven
    true_parameters = hang(pattern, mesh, membrane=MembraneModel.ORTHOTROPIC, fabric=fabrics)[2]
    drape = static_solve(dataclasses.replace(simulator), true_parameters, jnp.asarray(start))
    assert drape.report.converged
    places = [
        Landmark(panel, edge, float(t), (0.0, 0.0, 0.0))
        for panel in ("front", "back")
        for edge in (0, 1)
        for t in np.linspace(0.0, 1.0, 6)
    ]
    seen = landmark_weights(places, mesh).dot(np.asarray(drape.positions))
    marks = [dataclasses.replace(m, position=tuple(p)) for m, p in zip(places, seen, strict=True)]
    return make_problem(
        pattern, mesh, simulator, parameters, observation, options=options, landmarks=marks
    )


@pytest.mark.slow
def test_the_model_knows_every_number_of_the_fabric(woven, truth):
    """Landmarks to warp, weft, shear, bending and its anisotropy of both panels, by differences."""
    options = FitOptions(weights={}, fabric=BOTH, gauss_newton=rigid_pattern())
    fabrics = [FABRIC, dataclasses.replace(FABRIC, weft_stiffness=90.0)]
    problem = with_marks(woven, truth[1], fabrics, options)
    reference = make_reference(problem)
    state = init(problem, woven[4])
    like, at = state.unknowns, as_vector(state.unknowns)

    def cost(vector, positions):
        unknowns = from_vector(vector, like)
        rest = rest_shape(problem, unknowns.pattern)
        parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
        newton = dataclasses.replace(problem.simulator.newton, tolerance=1e-11)
        simulator = dataclasses.replace(problem.simulator, newton=newton)
        drape = static_solve(simulator, parameters, positions)
        assert drape.report.converged
        measured = measure(problem, reference, reference.prior, unknowns, drape.positions)
        return measured, drape.positions, parameters

    positions = state.positions
    for _ in range(8):
        measured, positions, parameters = cost(at, positions)
    model = make_model(problem, reference, reference.prior, like, positions, measured, parameters)
    first = len(at) - 3 - 10
    slopes = model.gradient[first:-3]
    assert np.abs(slopes[:3]).min() > 1e-4 and np.abs(slopes[5:8]).min() > 1e-4
    direction = np.zeros(len(at))
    direction[first:-3] = np.cos(np.arange(10.0))
    ahead, behind = (cost(at + s * 1e-4 * direction, positions)[0].cost for s in (1.0, -1.0))
    assert (ahead - behind) / 2e-4 == pytest.approx(model.gradient @ direction, rel=1e-4)


@pytest.mark.slow
def test_two_fabrics_are_told_apart(woven, truth):
    """The front is half as stiff along the weft, the back as it was: seams sit further back."""
    soft = dataclasses.replace(FABRIC, weft_stiffness=0.5 * FABRIC.orthotropic_moduli[1])
    freedom = FabricFreedom(per_panel=True, warp_weft=True)
    options = FitOptions(weights={}, fabric=freedom, gauss_newton=rigid_pattern(), iterations=15)
    problem = with_marks(woven, truth[1], [soft, FABRIC], options)
    end = fit(problem, init(problem, woven[4]))
    found = named_values(problem.tables.fabric, np.asarray(end.unknowns.log_stiffness))
    assert found["weft of front"] / found["weft of back"] == pytest.approx(0.5, rel=0.1)
