"""A tube of two panels that hangs from a ring and is stretched over a ball: small and stable."""

import dataclasses

import jax
import numpy as np
import trimesh

from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.fabric import Fabric, make_parameters
from dress_jax.energy.membrane import MembraneModel
from dress_jax.optimisation import FitOptions, make_problem, observe
from dress_jax.pattern import (
    Panel,
    Pattern,
    Side,
    Stitch,
    discretize,
    pattern_parameters,
    rest_positions,
)
from dress_jax.pattern.model import line, quadratic
from dress_jax.render.cameras import stack_cameras
from dress_jax.render.rings import ring_cameras
from dress_jax.sim import make_simulator, static_solve
from dress_jax.solver import NewtonOptions

RADIUS, HEIGHT = 0.15, 0.26
"""Of the tube as it is put on [m]."""

BALL = 0.13
"""Radius of the ball inside it [m]."""

EDGE_LENGTH = 0.05
FABRIC = Fabric(density=0.3, stretching_stiffness=60.0, bending_stiffness=1e-4)
SIZE = 96
VIEWS = 3
HALF_EXTENT = 0.25
"""Half of what an image shows [m]."""


def tube_pattern(*, girth=0.80, length=HEIGHT, flare=1.05):
    """Two equal panels; the hem is a curve and `flare` times as wide as the top."""
    top, hem = 0.25 * girth, 0.25 * girth * flare
    corners = np.array([(-hem, -length), (hem, -length), (top, 0.0), (-top, 0.0)])
    edges = (quadratic(0, 1, (0.5, -0.05)), line(1, 2), line(2, 3), line(3, 0))
    panels = tuple(
        Panel(
            name=name,
            vertices=corners.copy(),
            edges=edges,
            rotation=np.diag([sign, 1.0, sign]),
            translation=np.array([0.0, 0.0, sign * RADIUS]),
        )
        for name, sign in (("front", 1.0), ("back", -1.0))
    )
    stitches = (
        Stitch(Side("front", 1), Side("back", 3)),
        Stitch(Side("front", 3), Side("back", 1)),
    )
    return Pattern(panels=panels, stitches=stitches, source="tube")


def rolled(discretization, rest):
    """The panels bent to a cylinder around the y axis, welded."""
    names = discretization.panel_names
    panel = np.asarray(discretization.panel_of_vertex)
    half = np.array([np.abs(rest[panel == k, 0]).max() for k in range(2)])
    # Rows of a flared panel are narrower above: side seams meet at a quarter turn at every height.
    high = rest[:, 1].max()
    top = np.array([rest[(panel == k) & (rest[:, 1] > high - 1e-9), 0].max() for k in range(2)])
    part = np.clip((rest[:, 1] + HEIGHT) / HEIGHT, 0.0, 1.0)
    width = half[panel] + (top - half)[panel] * part
    turn = np.where(panel == names.index("front"), 0.0, np.pi)
    angle = turn + 0.5 * np.pi * np.clip(rest[:, 0] / width, -1.0, 1.0)
    world = np.stack([RADIUS * np.sin(angle), rest[:, 1], RADIUS * np.cos(angle)], axis=1)
    welded = np.zeros((discretization.vertex_count, 3))
    welded[np.asarray(discretization.weld_map)] = world
    return welded


def ball():
    """Vertices and faces of the ball, below the ring."""
    mesh = trimesh.creation.icosphere(2, BALL)
    return np.asarray(mesh.vertices) + np.array([0.0, -0.15, 0.0]), np.asarray(mesh.faces)


def hang(
    pattern, discretization=None, *, tolerance=1e-7, membrane=MembraneModel.ARAP, fabric=FABRIC
):
    """Discretize and put on: discretization, simulator, parameters, start positions."""
    if discretization is None:
        discretization = discretize(pattern, EDGE_LENGTH)
    rest = rest_positions(pattern_parameters(pattern), discretization)
    start = rolled(discretization, np.asarray(rest))
    body, faces = ball()
    pins = np.nonzero(start[:, 1] > -1e-9)[0]
    cloth = make_cloth(
        np.asarray(discretization.faces),
        np.asarray(discretization.rest_faces),
        vertex_count=discretization.vertex_count,
        pins=pins,
        membrane=membrane,
    )
    simulator = make_simulator(
        cloth,
        start,
        body_vertices=body,
        body_faces=faces,
        newton=NewtonOptions(tolerance=tolerance, iteration_limit=100),
    )
    parameters = make_parameters(
        cloth,
        fabric,
        rest,
        face_panel=np.asarray(discretization.face_panel),
        body_vertices=body,
        pin_targets=start[pins],
    )
    return discretization, simulator, parameters, start


def cameras(*, size=SIZE, views=VIEWS):
    """Views from all sides that are not opposite to each other."""
    azimuths = [360.0 * k / views + 10.0 for k in range(views)]
    return stack_cameras(
        ring_cameras(azimuths, size=size, center=[0.0, -0.15, 0.0], half_extent=HALF_EXTENT)
    )


def draped_observation(pattern, *, size=SIZE, views=VIEWS, color=(0.8, 0.3, 0.2)):
    """Images of the pattern as it hangs."""
    discretization, simulator, parameters, start = hang(pattern)
    drape = static_solve(simulator, parameters, start)
    body, faces = ball()
    return observe(
        cameras(size=size, views=views),
        drape.positions,
        discretization.faces,
        colors=np.tile(color, (discretization.vertex_count, 1)),
        body_vertices=body,
        body_faces=faces,
    ), drape


def tube_problem(pattern, observation, **options):
    """Problem and start positions."""
    discretization, simulator, parameters, start = hang(pattern)
    problem = make_problem(
        pattern,
        discretization,
        simulator,
        parameters,
        observation,
        options=FitOptions(**options),
    )
    return problem, start


def with_options(problem, **changes):
    """The same problem under other options."""
    return dataclasses.replace(problem, options=dataclasses.replace(problem.options, **changes))


def leaves_equal(a, b):
    """Whether two pytrees agree bit by bit; NaN equals itself."""
    one, two = jax.tree.leaves(a), jax.tree.leaves(b)
    return len(one) == len(two) and all(
        np.array_equal(np.asarray(x), np.asarray(y), equal_nan=True)
        for x, y in zip(one, two, strict=True)
    )
