"""Outfits of several garments, each with a mask of its own: S10.2, S10.5, S10.6."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import EDGE_LENGTH, FABRIC, cameras, tube_pattern

from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.fabric import make_parameters
from dress_jax.io.images import Targets, load_targets, save_targets
from dress_jax.optimisation import make_problem, observe
from dress_jax.optimisation.draping import initial_unknowns
from dress_jax.optimisation.gauss_newton.model import make_reference, measure
from dress_jax.optimisation.losses import Garment, assess_value
from dress_jax.optimisation.parts import assign_parts, merged
from dress_jax.pattern import Pattern, discretize, pattern_parameters, rest_positions
from dress_jax.render.cameras import cameras_to_dict, unstack_cameras
from dress_jax.sim import make_simulator

LIFT = 0.01
"""By which the upper garment's hem is raised [m]."""


def bars(*rows):
    """A first view of 12 x 4 pixels in which every part is one row."""
    view = np.zeros((12, 4, len(rows)))
    for part, row in enumerate(rows):
        view[row, :, part] = 1.0
    return view


def test_components_and_parts_are_matched_from_the_top_down():
    assert assign_parts(np.array([0.9, 1.4]), bars(2, 8)).tolist() == [1, 0]
    assert assign_parts(np.array([0.9, 1.4]), bars(8, 2)).tolist() == [0, 1]
    assert assign_parts(np.array([1.0, 1.4, 0.2]), bars(5, 10, 1)).tolist() == [0, 2, 1]


def test_one_of_either_takes_all():
    assert assign_parts(np.array([1.0]), bars(2, 8)).tolist() == [0]
    assert assign_parts(np.array([1.0, 0.5]), bars(2)).tolist() == [0, 0]
    view = bars(2, 8)
    np.testing.assert_array_equal(merged(view[None])[0, ..., 0], view.sum(axis=-1))


@pytest.mark.parametrize("heights, view", [([1.0, 0.8, 0.2], bars(1, 5)), ([1.0, 0.5], bars(1, 5))])
def test_what_cannot_be_matched_is_told(heights, view):
    if len(heights) == 2:
        view = view * np.array([1.0, 0.0])  # the second is not seen
    with pytest.raises(InputError, match=r"garments|show"):
        assign_parts(np.array(heights), view)


def outfit():
    """Two tubes that are not sewn to each other; in the file the lower one comes first."""
    upper, lower = tube_pattern(length=0.14, girth=0.9), tube_pattern(length=0.14)

    def renamed(pattern, name, height):
        panels = tuple(
            dataclasses.replace(
                panel,
                name=f"{name}_{panel.name}",
                translation=panel.translation + np.array([0.0, height, 0.0]),
            )
            for panel in pattern.panels
        )
        stitches = tuple(
            dataclasses.replace(
                stitch,
                first=dataclasses.replace(stitch.first, panel=f"{name}_{stitch.first.panel}"),
                second=dataclasses.replace(stitch.second, panel=f"{name}_{stitch.second.panel}"),
            )
            for stitch in pattern.stitches
        )
        return panels, stitches

    parts = [renamed(lower, "low", -0.15), renamed(upper, "high", -0.03)]
    return Pattern(
        sum((panels for panels, _ in parts), ()), sum((s for _, s in parts), ()), source="outfit"
    )


def worn(mesh, rest, *, lift=0.0):
    """Cylinders around the y axis, the upper one outside of the lower one's top [m]."""
    panel = np.asarray(mesh.panel_of_vertex)
    names = np.array(mesh.panel_names)[panel]
    high = np.char.startswith(names, "high")
    back = np.char.endswith(names, "back")
    half = np.array([np.abs(rest[panel == k, 0]).max() for k in range(mesh.panel_count)])[panel]
    # The sides of both panels meet at a quarter turn, whatever the flare.
    side = half / 1.05 * (1.0 - 0.05 * rest[:, 1] / 0.14)
    angle = np.where(back, np.pi, 0.0) + 0.5 * np.pi * np.clip(rest[:, 0] / side, -1.0, 1.0)
    radius = np.where(high, 0.16, 0.14)
    height = rest[:, 1] * np.where(high, 1.0 - lift / 0.14, 1.0) + np.where(high, -0.03, -0.15)
    world = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=1)
    welded = np.zeros((mesh.vertex_count, 3))
    welded[np.asarray(mesh.weld_map)] = world
    return welded


@pytest.fixture(scope="module")
def scene():
    """Pattern, mesh, positions, part of every vertex, and what three cameras see."""
    pattern = outfit()
    mesh = discretize(pattern, EDGE_LENGTH)
    rest = np.asarray(rest_positions(pattern_parameters(pattern), mesh))
    x = worn(mesh, rest)
    high = np.zeros(mesh.vertex_count, dtype=int)
    names = np.array(mesh.panel_names)[np.asarray(mesh.panel_of_vertex)]
    high[np.asarray(mesh.weld_map)] = np.char.startswith(names, "high")
    seen = observe(cameras(), x, mesh.faces, vertex_parts=1 - high)
    return pattern, mesh, rest, x, high, seen


def make(scene, observation):
    pattern, mesh, rest, x, *_ = scene
    pins = np.flatnonzero(x[:, 1] > -0.03 - 1e-9)
    cloth = make_cloth(
        np.asarray(mesh.faces), np.asarray(mesh.rest_faces), vertex_count=len(x), pins=pins
    )
    parameters = make_parameters(cloth, FABRIC, rest, pin_targets=x[pins])
    return make_problem(pattern, mesh, make_simulator(cloth, x), parameters, observation)


def test_parts_share_the_mask(scene):
    seen = scene[-1]
    assert seen.parts.shape == (*seen.mask.shape, 2)
    np.testing.assert_allclose(seen.parts.sum(axis=-1), seen.mask, atol=1e-5)
    assert (np.asarray(seen.parts).max(axis=(1, 2)) > 0.99).all()


def test_the_garments_find_their_parts(scene):
    """The first part is the upper garment, which comes second in the pattern."""
    high, seen = scene[4], scene[5]
    problem = make(scene, seen)
    channels = np.asarray(problem.tables.garment.attributes)
    np.testing.assert_array_equal(channels, np.stack([high, 1 - high], axis=1))
    # A file that names them the other way round gives the same garments.
    swapped = dataclasses.replace(seen, parts=seen.parts[..., ::-1])
    channels = np.asarray(make(scene, swapped).tables.garment.attributes)
    np.testing.assert_array_equal(channels, np.stack([1 - high, high], axis=1))


def assessed(problem, positions):
    unknowns, reference = initial_unknowns(problem), make_reference(problem)
    x = jnp.asarray(positions)
    outlines = measure(problem, reference, reference.prior, unknowns, x)
    garment = Garment(x, problem.parameters.rest_positions, unknowns.pattern, unknowns.colors)
    weights = {"mask": jnp.asarray(1.0)}
    return outlines, assess_value(garment, weights, problem.tables, problem.observation)


@pytest.mark.slow
def test_a_hem_before_another_garment_shows_in_its_own_mask_only(scene):
    _, mesh, rest, x, _, seen = scene
    lifted = worn(mesh, rest, lift=LIFT)
    apart = make(scene, seen)
    together = make(scene, dataclasses.replace(seen, parts=seen.mask[..., None]))
    assert together.tables.parts == () and len(apart.tables.parts) == 2
    for problem in (apart, together):
        outlines, assessment = assessed(problem, x)
        assert outlines.outline < 5e-4 and float(assessment.terms["mask"]) < 1e-4
    outlines, assessment = assessed(apart, lifted)
    assert outlines.outline > 1e-3 and float(assessment.terms["mask"]) > 2e-3
    hidden, unseen = assessed(together, lifted)
    assert hidden.outline < 0.3 * outlines.outline
    assert float(unseen.terms["mask"]) < 0.3 * float(assessment.terms["mask"])


def test_outlines_of_parts_move_as_their_derivative_says(scene):
    """Lowering the hem back by its derivative closes the gap in the upper garment's mask."""
    _, mesh, rest, x, _, seen = scene
    problem = make(scene, seen)
    lifted = worn(mesh, rest, lift=LIFT)
    rows = assessed(problem, lifted)[0].felt[0]
    change = rows.jacobian().dot((x - lifted).ravel())
    distance = rows.value[:, 0]
    moved = distance + change
    # The lower garment's boundary there is the hem of the upper one, which it does not follow.
    follows = np.abs(change) > 1e-4
    assert 0.1 < follows.mean() < 0.9
    before, after = (np.sqrt(np.sum((rows.weight * r**2)[follows])) for r in (distance, moved))
    assert before > 1e-3
    assert after < 0.1 * before


def test_masks_of_parts_are_kept_in_files(scene, tmp_path):
    seen = scene[-1]
    views = cameras_to_dict(unstack_cameras(seen.cameras))["cameras"]
    parts = {name: np.asarray(seen.parts[..., k]) for k, name in enumerate(("bottom", "top"))}
    parts = {name: np.clip(stack, 0.0, 1.0) for name, stack in parts.items()}
    targets = Targets(
        azimuths=(0, 120, 240),
        cameras=tuple(views),
        mask=np.clip(np.asarray(seen.mask), 0.0, 1.0),
        parts=parts,
    )
    save_targets(tmp_path, targets)
    read = load_targets(tmp_path)
    assert list(read.parts) == ["bottom", "top"]
    for name, stack in parts.items():
        np.testing.assert_allclose(read.parts[name], stack, atol=0.5 / 255 + 1e-6)
