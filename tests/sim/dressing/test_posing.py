"""What keeps a skirt up while its wearer moves (S8.8-S8.10, S21.2)."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from dress_jax.energy.fabric import FABRICS
from dress_jax.energy.panels import FacePanels
from dress_jax.geometry.intersection import count_intersections
from dress_jax.geometry.topology import boundary_loops
from dress_jax.sim import make_cloth, make_simulation, static_solve
from dress_jax.sim.dressing import DressedGarment
from dress_jax.sim.dressing.posing import WaistHold, follow_pose
from dress_jax.sim.dressing.waist import SHRINK, SHRINK_WIDTH, shrunk_waist
from dress_jax.solver import NewtonOptions

COLUMNS, ROWS = 24, 7
RADIUS, HEIGHT = 0.125, 0.24  # of the skirt [m]
COTTON = FABRICS["cotton"]


def _skirt():
    """A tube of one panel whose sides are sewn: garment on the body, and rest positions [m]."""
    s, t = np.meshgrid(np.arange(COLUMNS + 1), np.arange(ROWS), indexing="ij")
    rest = np.stack(
        [s.ravel() * 2.0 * np.pi * RADIUS / COLUMNS, t.ravel() * HEIGHT / (ROWS - 1)], axis=1
    )
    index = np.arange(len(rest)).reshape(COLUMNS + 1, ROWS)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    corners = [np.stack([p.ravel() for p in part], 1) for part in ((a, b, c), (a, c, d))]
    rest_faces = np.concatenate(corners)
    weld = ((s % COLUMNS) * ROWS + t).ravel()
    faces = weld[rest_faces]
    angle = 2.0 * np.pi * np.arange(COLUMNS) / COLUMNS
    ring = RADIUS * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    height = 0.6 + np.arange(ROWS) * HEIGHT / (ROWS - 1)
    x = np.stack(
        [
            np.repeat(ring[:, 0], ROWS),
            np.tile(height, COLUMNS),
            np.repeat(ring[:, 1], ROWS),
        ],
        axis=1,
    )
    loop = max(boundary_loops(faces), key=lambda own: x[own, 1].mean()).astype(np.int32)
    cloth = make_cloth(
        faces, rest_faces, rest_positions=rest, vertex_count=len(x), pins=np.sort(loop)
    )
    pins = np.asarray(cloth.pins)
    return DressedGarment(cloth, x, x[pins], ()), rest


def _trunk():
    """An upright cylinder, a little thinner than the skirt."""
    mesh = trimesh.creation.cylinder(radius=0.12, height=1.4, sections=48)
    vertices = np.asarray(mesh.vertices)[:, [0, 2, 1]] + [0.0, 0.7, 0.0]
    return vertices, np.asarray(mesh.faces)[:, ::-1].astype(np.int32)


@pytest.fixture(scope="module")
def scene():
    garment, rest = _skirt()
    body, faces = _trunk()
    up = np.array([0.03, 0.06, 0.03, 0.0])[:, None, None] * [0.0, 1.0, 0.0]
    return garment, rest, body, faces, body + up


def _after(scene, hold):
    garment, rest, body, faces, way = scene
    panels = FacePanels(("skirt",), np.zeros(garment.cloth.faces.shape[1], int))
    posed = follow_pose(garment, rest, body, faces, way, fabric=COTTON, panels=panels, hold=hold)
    counts = count_intersections(posed.positions, np.asarray(garment.cloth.faces).T, way[-1], faces)
    assert (counts.self, counts.body) == (0, 0)
    return posed


def _slip(scene, posed) -> float:
    """How far the waist has come down on the body, which is back where it was [m]."""
    garment = scene[0]
    loop = np.asarray(garment.cloth.pins)
    return float(np.mean(garment.positions[loop, 1] - posed.positions[loop, 1]))


@pytest.mark.slow
def test_the_shrunk_waist_holds_and_slips_without(scene, monkeypatch):
    """S8.8, S8.9: friction holds the shrunk waist; the true rest shape lets it slide down."""
    held = _after(scene, WaistHold.SHRINK)
    with monkeypatch.context() as patch:
        patch.setattr("dress_jax.sim.dressing.posing.shrunk_waist", lambda rest, *_: rest)
        loose = _after(scene, WaistHold.SHRINK)
    assert abs(_slip(scene, held)) < 0.01
    assert _slip(scene, loose) > 0.05


def test_a_pinned_waist_rides_on_the_body(scene):
    assert abs(_slip(scene, _after(scene, WaistHold.PINS))) < 0.005


def test_the_true_rest_shape_is_back_afterwards(scene):
    """S8.10, S9.10, S21.2: the drape pins the loop where it has come to, with nothing shrunk."""
    garment, rest, _, faces, way = scene
    posed = _after(scene, WaistHold.SHRINK)
    assert np.array_equal(posed.cloth.pins, garment.cloth.pins)
    assert np.array_equal(posed.pin_targets, posed.positions[np.asarray(posed.cloth.pins)])
    simulator, parameters = make_simulation(
        posed.cloth,
        posed.positions,
        rest,
        fabric=COTTON,
        body_vertices=way[-1],
        body_faces=faces,
        pin_targets=posed.pin_targets,
        newton=NewtonOptions(iteration_limit=2),
    )
    assert np.array_equal(parameters.rest_positions, rest)
    assert not simulator.friction
    assert static_solve(
        simulator, parameters, jnp.asarray(posed.positions)
    ).report.intersection_free


def test_only_the_waist_is_shrunk():
    """Lengths along the loop by the factor, nothing below the band."""
    garment, rest = _skirt()
    cloth = garment.cloth
    rest_faces, faces = np.asarray(cloth.rest_faces).T, np.asarray(cloth.faces).T
    shrunk = shrunk_waist(rest, rest_faces, faces, np.asarray(cloth.pins))
    top = np.isclose(rest[:, 1], HEIGHT)
    lengths = [np.ptp(shape[top, 0]) for shape in (shrunk, rest)]
    assert lengths[0] == pytest.approx(SHRINK * lengths[1])
    below = rest[:, 1] < HEIGHT - SHRINK_WIDTH
    assert np.array_equal(shrunk[below], rest[below])
    assert np.allclose(shrunk[:, 1], rest[:, 1])
