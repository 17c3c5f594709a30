"""Values of panels and vertices as values of triangles and hinges; garments of two fabrics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from energy_scenes import grid

from dress_jax.application.drape import DrapeOptions
from dress_jax.cli.draping import Membrane
from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import make_cloth, vertex_masses
from dress_jax.energy.fabric import FABRICS, make_parameters
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.spread import (
    panels_to_triangles,
    triangles_to_hinges,
    vertices_to_triangles,
)


def two_panels():
    """A 3x3 sheet whose left half is panel 0: cloth, rest positions and panels of triangles."""
    rest, faces = grid(3, 3)
    return make_cloth(faces), rest, (rest[faces].mean(axis=1)[:, 0] > 1.0).astype(int)


def test_panels_to_triangles_and_hinges():
    cloth, _, owner = two_panels()
    values = jnp.array([2.0, 5.0])
    triangles = panels_to_triangles(values, owner)
    np.testing.assert_array_equal(triangles, np.where(owner == 1, 5.0, 2.0))
    hinges = np.asarray(triangles_to_hinges(triangles, cloth.hinge_faces))
    across = owner[np.asarray(cloth.hinge_faces[0])] != owner[np.asarray(cloth.hinge_faces[1])]
    assert across.any() and not across.all()
    np.testing.assert_array_equal(hinges[across], 3.5)
    assert set(hinges[~across]) == {2.0, 5.0}


def test_a_linear_field_at_the_vertices_is_met_at_the_centres():
    cloth, rest, _ = two_panels()
    field = 3.0 + 2.0 * rest[:, 0] - rest[:, 1]
    centres = rest[np.asarray(cloth.faces).T].mean(axis=1)
    found = vertices_to_triangles(jnp.asarray(field), cloth.faces)
    np.testing.assert_allclose(found, 3.0 + 2.0 * centres[:, 0] - centres[:, 1], rtol=1e-14)


def test_transposes_share_out_what_triangles_and_hinges_say():
    """Each is an average: the derivative of the sum is what the parts count for."""
    cloth, _, owner = two_panels()
    faces, hinges = cloth.faces.shape[1], cloth.hinges.shape[1]
    per_panel = jax.grad(lambda v: jnp.sum(panels_to_triangles(v, owner)))(jnp.ones(2))
    np.testing.assert_allclose(per_panel, np.bincount(owner))
    per_vertex = jax.grad(lambda v: jnp.sum(vertices_to_triangles(v, cloth.faces)))(jnp.ones(9))
    np.testing.assert_allclose(per_vertex, np.bincount(np.asarray(cloth.faces).ravel()) / 3.0)
    per_face = jax.grad(lambda v: jnp.sum(triangles_to_hinges(v, cloth.hinge_faces)))(
        jnp.ones(faces)
    )
    assert float(per_face.sum()) == pytest.approx(hinges)


def test_parameters_of_two_fabrics():
    cloth, rest, owner = two_panels()
    cotton, silk = FABRICS["cotton"], FABRICS["silk"]
    mixed = make_parameters(cloth, (cotton, silk), rest, face_panel=owner)
    masses = vertex_masses(mixed, cloth)
    assert float(masses.sum()) == pytest.approx(2.0 * cotton.density + 2.0 * silk.density)
    assert mixed.bending_stiffness.shape == (cloth.hinges.shape[1],)
    same = make_parameters(cloth, (cotton, cotton), rest, face_panel=owner)
    one = make_parameters(cloth, cotton, rest)
    for name in ("density", "warp_stiffness", "bending_stiffness", "friction_coefficient"):
        np.testing.assert_allclose(getattr(same, name), getattr(one, name), rtol=1e-14)


def test_faults_of_several_fabrics():
    cloth, rest, owner = two_panels()
    cotton = FABRICS["cotton"]
    with pytest.raises(InputError, match="panel of each triangle"):
        make_parameters(cloth, (cotton, cotton), rest)
    with pytest.raises(InputError, match="1 fabrics"):
        make_parameters(cloth, (cotton,), rest, face_panel=owner)
    with pytest.raises(InputError, match="triangles"):
        make_parameters(cloth, (cotton, cotton), rest, face_panel=owner[:3])


def test_fabrics_by_the_names_of_panels():
    names = ("front", "sleeve_left", "sleeve_right")
    assert DrapeOptions().fabrics(names) == FABRICS["cotton"]
    options = DrapeOptions(panel_fabrics=(("sleeve*", "silk"), ("sleeve_left", "denim")))
    assert options.fabrics(names) == tuple(FABRICS[f] for f in ("cotton", "denim", "silk"))
    with pytest.raises(InputError, match="panels are front"):
        DrapeOptions(panel_fabrics=(("collar", "silk"),)).fabrics(names)
    with pytest.raises(InputError, match="unknown fabric"):
        DrapeOptions(panel_fabrics=(("front", "lead"),))


def test_the_command_line_knows_every_membrane():
    assert {m.value for m in Membrane} == {m.value for m in MembraneModel}
