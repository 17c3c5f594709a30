import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energy_scenes import columns, garment
from jax.test_util import check_grads

from dress_jax.core import components as c
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Gravity, make_cloth, vertex_masses
from dress_jax.energy.elastic import TERMS, elastic_energy
from dress_jax.energy.fabric import FABRICS, Fabric, make_parameters, named_fabric
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.rest import rest_triangles
from tests.central_differences import UNOPTIMIZED, check_energy_derivatives

# Central differences with step 1e-5 on quantities of order one: error 1e-10 and rounding 1e-11,
# times third derivatives of up to a hundred.
FINITE_DIFFERENCE = 1e-6
OTHER_MEMBRANES = (MembraneModel.NEO_HOOKEAN, MembraneModel.ORTHOTROPIC)
ARRAYS = ("rest_positions", "gravity", "pin_targets")
SCALARS = (
    "density",
    "stretching_stiffness",
    "poisson_ratio",
    "warp_stiffness",
    "weft_stiffness",
    "shear_stiffness",
    "grain_angle",
    "bending_stiffness",
    "bending_anisotropy",
    "pin_stiffness",
    "stitch_stiffness",
)


def test_first_derivatives_of_every_term():
    """Each term on its own, in the positions and in every continuous parameter at once."""
    cloth, parameters, step, positions = garment()
    others = [garment(model)[0] for model in OTHER_MEMBRANES]

    @functools.partial(jax.jit, compiler_options=UNOPTIMIZED)
    def terms(x, parameters):
        values = [term(c.split(x), step, parameters, cloth) for term in TERMS.values()]
        values += [TERMS["membrane"](c.split(x), step, parameters, other) for other in others]
        return jnp.stack(values)

    check_grads(
        terms,
        (jnp.asarray(positions), parameters),
        order=1,
        modes=["fwd"],
        eps=1e-5,
        atol=FINITE_DIFFERENCE,
        rtol=FINITE_DIFFERENCE,
    )


def test_second_derivatives_of_every_term():
    """The derivative of the force in positions, rest shape and each parameter.

    Of the sum of all terms: they are of the same size, so a fault in any of them shows.
    """
    cloth, parameters, step, positions = garment()
    others = [garment(model)[0] for model in OTHER_MEMBRANES]

    def energy(x, *values):
        changed = replace(parameters, **dict(zip(ARRAYS + SCALARS, values, strict=True)))
        total = elastic_energy(x, step, changed, cloth)
        return total + sum(TERMS["membrane"](c.split(x), step, changed, o) for o in others)

    values = [getattr(parameters, name) for name in ARRAYS + SCALARS]
    arguments = (jnp.asarray(positions), *values)
    check_energy_derivatives(energy, arguments, step=1e-5, tolerance=FINITE_DIFFERENCE)


def nonzero(gradient) -> set[str]:
    """Names of the leaves that are not zero; there is no strain limit here."""
    leaves = {key: leaf for key, leaf in vars(gradient).items() if key != "strain_limit"}
    return {key for key, leaf in leaves.items() if np.any(np.asarray(leaf) != 0.0)}


# The parameters that each term must carry a derivative to.
LEAVES = {
    "inertia": {"rest_positions", "density"},
    "weight": {"rest_positions", "density", "gravity"},
    "membrane": {"rest_positions", "stretching_stiffness"},
    "bending": {"rest_positions", "bending_stiffness", "bending_anisotropy", "grain_angle"},
    "pins": {"pin_targets", "pin_stiffness"},
    "stitches": {"stitch_stiffness"},
}


def test_which_parameters_a_term_depends_on():
    """S9.7: mass, stencil stiffness and rest shape all carry a derivative to the rest shape."""
    cloth, parameters, step, positions = garment()

    @jax.jit
    @jax.jacrev
    def derivatives(parameters):
        x = columns(positions)
        return {name: term(x, step, parameters, cloth) for name, term in TERMS.items()}

    for name, gradient in derivatives(parameters).items():
        found = {
            key for key, leaf in vars(gradient).items() if leaf is not None and np.any(leaf != 0.0)
        }
        assert found == LEAVES[name], name


@pytest.mark.parametrize(
    ("model", "leaves"),
    [
        (MembraneModel.NEO_HOOKEAN, {"rest_positions", "stretching_stiffness", "poisson_ratio"}),
        (
            MembraneModel.ORTHOTROPIC,
            {
                "rest_positions",
                "poisson_ratio",
                "warp_stiffness",
                "weft_stiffness",
                "shear_stiffness",
                "grain_angle",
            },
        ),
    ],
)
def test_which_parameters_the_other_membranes_depend_on(model, leaves):
    cloth, parameters, step, positions = garment(model)
    gradient = jax.grad(lambda p: TERMS["membrane"](columns(positions), step, p, cloth))(parameters)
    found = {
        key for key, leaf in vars(gradient).items() if leaf is not None and np.any(leaf != 0.0)
    }
    assert found == leaves


def test_inertia_and_weight_are_backward_euler():
    """Free fall: the minimum of inertia and weight is x^n + h v^n + h^2 g (S1.3)."""
    cloth, parameters, step, _ = garment()
    h = 1.0 / float(step.inverse_step)
    end = step.start + h * step.velocity + h**2 * parameters.gravity[None]

    def energy(x):
        columns = c.split(x)
        return sum(TERMS[name](columns, step, parameters, cloth) for name in ("inertia", "weight"))

    np.testing.assert_allclose(jax.jit(jax.grad(energy))(end), 0.0, atol=1e-14)


def test_no_inertia_in_a_static_solve():
    cloth, parameters, step, positions = garment()
    static = replace(step, inverse_step=jnp.asarray(0.0), velocity=jnp.zeros_like(step.velocity))
    assert float(TERMS["inertia"](columns(positions), static, parameters, cloth)) == 0.0


def test_pins_and_stitches():
    cloth, parameters, step, positions = garment()
    offset = positions[[0, 6]] - np.asarray(parameters.pin_targets)
    gap = positions[[0, 6]] - positions[[2, 8]]
    for name, vector, stiffness in (("pins", offset, 1.7), ("stitches", gap, 0.9)):
        value = TERMS[name](columns(positions), step, parameters, cloth)
        np.testing.assert_allclose(value, 0.5 * stiffness * np.sum(vector**2), rtol=1e-14)


def test_total_is_the_sum_of_the_terms():
    cloth, parameters, step, positions = garment()
    terms = sum(float(term(columns(positions), step, parameters, cloth)) for term in TERMS.values())
    total = elastic_energy(jnp.asarray(positions), step, parameters, cloth)
    np.testing.assert_allclose(total, terms, rtol=1e-14)


def test_lumped_mass_is_density_times_area():
    """S1.4, with one density and with one per triangle."""
    cloth, parameters, _, _ = garment()
    areas = np.asarray(rest_triangles(parameters.rest_positions, cloth.rest_faces).areas)
    masses = vertex_masses(parameters, cloth)
    assert masses.shape == (9,) and np.all(masses > 0.0)
    np.testing.assert_allclose(masses.sum(), 0.7 * areas.sum(), rtol=1e-14)
    density = np.linspace(0.1, 0.9, len(areas))
    varied = vertex_masses(replace(parameters, density=jnp.asarray(density)), cloth)
    np.testing.assert_allclose(varied.sum(), density @ areas, rtol=1e-14)


def test_order_of_the_triangles_does_not_matter():
    cloth, parameters, step, positions = garment()
    rng = np.random.default_rng(2)
    faces = np.asarray(cloth.faces).T[rng.permutation(cloth.faces.shape[1])]
    faces = np.roll(faces, 1, axis=1)
    other = make_cloth(faces, pins=np.asarray(cloth.pins), stitches=np.asarray(cloth.stitches).T)
    energies = [
        float(elastic_energy(jnp.asarray(positions), step, parameters, mesh))
        for mesh in (cloth, other)
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e-13)


def test_empty_pins_and_stitches():
    cloth, parameters, step, positions = garment()
    bare = make_cloth(np.asarray(cloth.faces).T)
    fabric = make_parameters(bare, named_fabric("cotton"), parameters.rest_positions)
    for name in ("pins", "stitches"):
        assert float(TERMS[name](columns(positions), step, fabric, bare)) == 0.0


def test_fabrics_and_their_faults():
    for fabric in FABRICS.values():
        assert fabric.density > 0.0
    np.testing.assert_array_equal(Gravity.DOWN.value, (0.0, -9.81, 0.0))
    with pytest.raises(InputError, match="choose one of"):
        named_fabric("chainmail")
    good = {"density": 0.1, "stretching_stiffness": 1.0, "bending_stiffness": 1.0}
    for bad in (
        {"density": 0.0},
        {"stretching_stiffness": -1.0},
        {"bending_stiffness": float("nan")},
        {"poisson_ratio": 1.0},
        {"friction": -0.1},
    ):
        with pytest.raises(InputError):
            Fabric(**{**good, **bad})


def test_mismatched_rest_triangles_are_refused():
    with pytest.raises(InputError, match="rest triangles"):
        make_cloth(np.array([[0, 1, 2]]), np.array([[0, 1, 2], [1, 2, 3]]))
