"""Bad input is one error before any solve, with panel, triangle and edge where they are known."""

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.panels import FacePanels
from dress_jax.sim import make_cloth, make_simulator, static_solve
from tests.sim.scenes import SOFT, level, sheet

COUNT = 4
REST, FACES = sheet(COUNT, 0.3)
OWNER = (REST[FACES].mean(axis=1)[:, 0] > 0.0).astype(np.int32)
PANELS = FacePanels(("left", "right"), OWNER)
LAST = len(FACES) - 1  # in the panel on the right


def scene(membrane=MembraneModel.ARAP, panels=PANELS, vertex_count=None):
    start = level(REST, 1.0)
    cloth = make_cloth(FACES, membrane=membrane, vertex_count=vertex_count)
    if vertex_count is not None:
        start = np.concatenate([start, np.ones((vertex_count - len(start), 3))])
    simulator = make_simulator(cloth, start, panels=panels)
    return simulator, make_parameters(cloth, SOFT, REST), start


def refuse(match, *, membrane=MembraneModel.ARAP, panels=PANELS, **changes):
    """The solve with changed parameters raises, and no Newton step was taken."""
    simulator, parameters, start = scene(membrane, panels)
    steps = []
    simulator.progress = steps.append
    with pytest.raises(InputError, match=match):
        static_solve(simulator, replace(parameters, **changes), start)
    assert not steps


def per_triangle(value, good):
    values = np.full(len(FACES), good)
    values[LAST] = value
    return jnp.asarray(values)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("density", 0.0),
        ("density", -0.1),
        ("density", np.nan),
        ("stretching_stiffness", -1.0),
        ("warp_stiffness", -1.0),
        ("shear_stiffness", np.inf),
        ("poisson_ratio", 1.0),
        ("bending_stiffness", -1e-6),
        ("bending_anisotropy", 0.7),
        ("pin_stiffness", -1.0),
        ("stitch_stiffness", np.nan),
        ("barrier_stiffness", -1.0),
        ("friction_coefficient", -0.1),
        ("grain_angle", np.nan),
    ],
)
def test_a_bad_number_is_named(name, bad):
    refuse(f"parameters {name}", **{name: jnp.asarray(bad)})


@pytest.mark.parametrize("bad", [np.nan, -2.0])
def test_a_bad_number_of_a_triangle_names_its_panel(bad):
    values = per_triangle(bad, 100.0)
    refuse(f"stretching_stiffness, panel 'right', triangle {LAST}", stretching_stiffness=values)
    refuse(f"stretching_stiffness, triangle {LAST}", stretching_stiffness=values, panels=None)


def test_a_bad_number_of_a_hinge_names_its_edge():
    simulator, _, _ = scene()
    hinges = np.asarray(simulator.cloth.hinges)
    values = np.full(hinges.shape[1], 1e-5)
    values[-1] = -1e-5
    a, b = hinges[:2, -1]
    refuse(
        rf"panel 'right', triangle \d+, edge \({a}, {b}\)", bending_stiffness=jnp.asarray(values)
    )


@pytest.mark.parametrize("name", ["warp_stiffness", "weft_stiffness", "shear_stiffness"])
def test_the_orthotropic_membrane_needs_every_modulus(name):
    refuse(name, membrane=MembraneModel.ORTHOTROPIC, **{name: jnp.asarray(0.0)})


def test_an_array_of_the_wrong_length_is_named():
    refuse(r"density: it has shape \(3,\).*one per triangle", density=jnp.ones(3))
    refuse(r"bending_stiffness: .*one per hinge", bending_stiffness=jnp.ones(len(FACES)))
    refuse(r"pin_stiffness: .*give one number", pin_stiffness=jnp.ones(2))


def test_a_flat_rest_triangle_is_named():
    """Its third corner lies on the line through the other two."""
    rest = REST.copy()
    a, b, c = FACES[LAST]
    rest[c] = 0.5 * (rest[a] + rest[b])
    refuse("panel 'right'.*no area.*mesh the panel anew", rest_positions=jnp.asarray(rest))


def test_a_rest_triangle_that_is_turned_inside_out_is_named():
    rest = REST.copy()
    corner = COUNT * COUNT - 1
    rest[corner] = rest[corner] - 0.25
    refuse("panel 'right'.*inside out", rest_positions=jnp.asarray(rest))


def mirrored_right(rest):
    """The sheet as two panels, the right one mirrored: cloth, rest positions."""
    other = rest * [-1.0, 1.0] + [5.0, 0.0]
    rest_faces = np.where(OWNER[:, None] == 1, FACES + len(rest), FACES)
    return make_cloth(FACES, rest_faces), np.concatenate([rest, other])


def test_a_mirrored_panel_is_no_fault():
    """It turns clockwise as a whole; a single triangle that does not is one."""
    cloth, rest = mirrored_right(REST)
    start = level(REST, 1.0)
    simulator = make_simulator(cloth, start, panels=PANELS)
    parameters = make_parameters(cloth, SOFT, rest)
    assert static_solve(simulator, parameters, start).report.converged
    folded = rest.copy()
    folded[-1] += [0.25, -0.25]
    with pytest.raises(InputError, match=r"panel 'right'.*inside out"):
        static_solve(simulator, make_parameters(cloth, SOFT, folded), start)


def test_a_rest_position_that_is_not_finite_is_named():
    rest = REST.copy()
    rest[-1, 1] = np.nan
    refuse(f"panel vertex {COUNT * COUNT - 1}, panel 'right'", rest_positions=jnp.asarray(rest))


def test_a_start_that_is_not_finite_is_named():
    simulator, parameters, start = scene()
    start[5, 2] = np.nan
    with pytest.raises(InputError, match="start positions, row 5"):
        static_solve(simulator, parameters, start)


def test_a_vertex_without_mass_is_named():
    simulator, parameters, start = scene(vertex_count=COUNT * COUNT + 1)
    with pytest.raises(InputError, match=f"vertex {COUNT * COUNT} has no mass"):
        static_solve(simulator, parameters, start)


# Index arrays

FINS = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])


def test_an_edge_with_three_triangles_is_named():
    panels = FacePanels(("front", "back", "fin"), np.arange(3))
    with pytest.raises(InputError) as caught:
        make_cloth(FINS, panels=panels)
    message = str(caught.value)
    assert "edge (0, 1)" in message
    for part in ("'front', triangle 0", "'back', triangle 1", "'fin', triangle 2"):
        assert part in message
    with pytest.raises(InputError, match=r"triangle 0; triangle 1; triangle 2.*edge \(0, 1\)"):
        make_cloth(FINS)


@pytest.mark.parametrize(
    ("faces", "options", "match"),
    [
        ([[0, 1, 2], [1, 1, 2]], {}, "triangle 1.*twice"),
        ([[0, 1, 2], [1, 2, 7]], {"vertex_count": 4}, "triangle 1.*7.*there are 4"),
        ([[0, 1, -2]], {}, "triangle 0.*-2"),
        ([[0, 1, 2]], {"pins": np.array([3])}, "pins.*no vertex 3"),
        ([[0, 1, 2]], {"stitches": np.array([[0, 9]])}, "stitches.*no vertex 9"),
    ],
)
def test_index_arrays_that_point_nowhere_are_named(faces, options, match):
    with pytest.raises(InputError, match=match):
        make_cloth(np.array(faces), **options)
