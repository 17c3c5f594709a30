"""Derivatives of a drape in values of panels and vertices, against central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.spread import (
    panels_to_triangles,
    triangles_to_hinges,
    vertices_to_triangles,
)
from dress_jax.sim import static_solve
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT, draped_sheet

# As in `test_derivatives`: the noise of the solve over the step of the difference.
ADJOINT_TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def drape():
    cloth, simulator, rest, start, body = draped_sheet()
    owner = (rest[np.asarray(cloth.faces).T].mean(axis=1)[:, 0] > 0.0).astype(np.int32)
    fabrics = (SOFT, SOFT)
    parameters = make_parameters(
        cloth,
        fabrics,
        rest,
        face_panel=owner,
        body_vertices=body,
        pin_targets=start[np.asarray(cloth.pins)],
    )
    result = static_solve(simulator, parameters, start)
    assert result.report.converged and result.report.intersection_free
    settings = simulator.settings
    assert float(result.report.smallest_distance) < float(settings.dhat + settings.thickness)
    return cloth, simulator, parameters, owner, result.positions


def spread(name, cloth, owner):
    """What values of panels or vertices do to the leaf, and how many of them there are."""
    if name == "density of panels":
        return "density", 2, lambda v: panels_to_triangles(v, owner), 1e-6
    if name == "stretching of vertices":
        return (
            "stretching_stiffness",
            cloth.vertex_count,
            lambda v: vertices_to_triangles(v, cloth.faces),
            3e-3,
        )
    bend = {
        "bending of panels": (2, lambda v: panels_to_triangles(v, owner)),
        "bending of vertices": (
            cloth.vertex_count,
            lambda v: vertices_to_triangles(v, cloth.faces),
        ),
    }[name]
    count, triangles = bend
    return (
        "bending_stiffness",
        count,
        lambda v: triangles_to_hinges(triangles(v), cloth.hinge_faces),
        3e-9,
    )


@pytest.mark.parametrize(
    "name",
    ["density of panels", "stretching of vertices", "bending of panels", "bending of vertices"],
)
def test_adjoint_equals_finite_differences(drape, name):
    cloth, simulator, parameters, owner, positions = drape
    leaf, count, function, size = spread(name, cloth, jnp.asarray(owner))
    values = jnp.full(count, float(getattr(parameters, leaf)[0]))
    weights = jnp.asarray(np.sin(np.arange(positions.size)).reshape(-1, 3))
    direction = jnp.asarray(np.cos(1.0 + np.arange(count)))

    def loss(v):
        changed = replace(parameters, **{leaf: function(v)})
        return jnp.sum(weights * static_solve(simulator, changed, positions).positions)

    exact = float(jnp.sum(jax.grad(loss)(values) * direction))
    measured = central_difference(lambda t: loss(values + t * direction), size)
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)


def test_bending_anisotropy_and_grain(drape):
    """Of hinges that tell warp from weft, in both directions at once."""
    _, simulator, parameters, _, positions = drape
    weights = jnp.asarray(np.sin(np.arange(positions.size)).reshape(-1, 3))
    base = replace(parameters, bending_anisotropy=jnp.asarray(0.3), grain_angle=jnp.asarray(0.2))
    settled = static_solve(simulator, base, positions).positions

    def loss(values):
        changed = replace(base, bending_anisotropy=values[0], grain_angle=values[1])
        return jnp.sum(weights * static_solve(simulator, changed, settled).positions)

    at = jnp.asarray([0.3, 0.2])
    exact = np.asarray(jax.grad(loss)(at))
    for index, size in enumerate((1e-4, 1e-4)):
        unit = jnp.zeros(2).at[index].set(1.0)
        measured = central_difference(lambda t, unit=unit: loss(at + t * unit), size)
        assert abs(exact[index]) > 0.0
        assert abs(exact[index] - measured) <= ADJOINT_TOLERANCE * abs(measured)
