"""The scenes: square sheets and what they lie on, as arrays and numbers that no contestant owns."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

# Drapes of `settle` by dress_jax, kept because folds fall differently on every machine.
SETTLED = Path(__file__).parent / "settled"
RADIUS = 0.3  # of the sphere [m]
TABLE_RADIUS, TABLE_HEIGHT = 0.3, 0.05  # [m]
GAP = 1.0e-3  # between a sheet and what it lies on at the start [m]
_NOISE = 1e-5  # out of the plane [m]: exact tests of coplanar pairs are slow, and nothing is flat
# By which the second sheet is turned [rad] and moved [m]: aligned meshes are a special case, and
# two sheets that cover each other wholly have more contacts than a garment.
_TURN, _SHIFT = 0.4, 0.45


@dataclasses.dataclass(frozen=True)
class Scene:
    """A cloth, a body at rest, and the numbers of the model. SI units.

    Attributes:
        name: of the scene.
        start: positions from which the first solve begins, at rest, (n, 3).
        rest: rest shape in the plane, (n, 2).
        faces: of the cloth, (f, 3).
        pins: vertices held by springs, (k,).
        body_vertices, body_faces: what the cloth lies on, at rest, (b, 3) and (c, 3).
        pin_targets: where the pins are held [m], (k, 3).
        steps: number of implicit steps; 0 for one static solve (a step of 1 s from rest).
        time_step: h [s].
        density, stretching, bending: [kg/m^2], [N/m], [N m].
        barrier, dhat, thickness: [Pa], [m], [m].
        pin_stiffness: [N/m].
        gravity: along y [m/s^2].
        tolerance: a solve ends when no vertex would move further in a Newton step [m].
        longest_step: no vertex moves further than this in one Newton step [m].
        iteration_limit: of one solve.
    """

    name: str
    start: Float[np.ndarray, "n 3"]
    rest: Float[np.ndarray, "n 2"]
    faces: Int[np.ndarray, "f 3"]
    pins: Int[np.ndarray, " k"]
    body_vertices: Float[np.ndarray, "b 3"]
    body_faces: Int[np.ndarray, "c 3"]
    pin_targets: Float[np.ndarray, "k 3"]
    steps: int
    time_step: float
    density: float = 0.2
    stretching: float = 100.0
    bending: float = 1e-5
    barrier: float = 10.0
    dhat: float = 1e-3
    thickness: float = 1e-4
    pin_stiffness: float = 1e3
    gravity: float = -9.81
    tolerance: float = 1e-5
    longest_step: float = 0.05
    iteration_limit: int = 300


def sheet(
    side: int, size: float
) -> tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, "f 3"], Int[np.ndarray, "4"]]:
    """A square in the plane: vertices [m], triangles, and the corners of the middle cell."""
    s = np.linspace(-size / 2, size / 2, side)
    points = np.stack([part.ravel() for part in np.meshgrid(s, s, indexing="ij")], axis=1)
    i = np.arange(side * side, dtype=np.int32).reshape(side, side)
    lower = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    m = (side - 1) // 2
    middle = np.array([i[m, m], i[m + 1, m], i[m, m + 1], i[m + 1, m + 1]])
    return points, np.concatenate([lower, upper]), middle


def sphere() -> tuple[Float[np.ndarray, "b 3"], Int[np.ndarray, "c 3"]]:
    """A sphere of 2,562 vertices around the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)


def table(
    rings: int = 8, around: int = 48
) -> tuple[Float[np.ndarray, "b 3"], Int[np.ndarray, "c 3"]]:
    """A round table top, its upper side at y = 0."""
    radii = TABLE_RADIUS * np.arange(1, rings + 1) / rings
    angles = 2.0 * np.pi * (np.arange(around)[None] + 0.5 * np.arange(rings)[:, None]) / around
    top = np.stack([radii[:, None] * np.cos(angles), 0 * angles, radii[:, None] * np.sin(angles)])
    top = np.concatenate([np.zeros((1, 3)), top.reshape(3, -1).T])
    rim = top[-around:] - [0.0, TABLE_HEIGHT, 0.0]
    vertices = np.concatenate([top, rim, [[0.0, -TABLE_HEIGHT, 0.0]]])
    loops = [1 + around * k + np.arange(around) for k in range(rings + 1)]

    def following(loop):
        return np.roll(loop, -1)

    fan = [np.stack([0 * loops[0], following(loops[0]), loops[0]], axis=1)]
    for inner, outer in itertools.pairwise(loops):
        fan.append(np.stack([inner, following(inner), outer], axis=1))
        fan.append(np.stack([following(inner), following(outer), outer], axis=1))
    fan.append(np.stack([0 * loops[-1] + len(vertices) - 1, loops[-1], following(loops[-1])], 1))
    return vertices, np.concatenate(fan).astype(np.int32)


def _above(name: str, body, top, rest, faces, pins, heights, *, steps: int) -> Scene:
    flat = np.stack([rest[:, 0], top + heights, -rest[:, 1]], axis=1)
    start = flat.copy()
    start[:, 1] += np.random.default_rng(0).uniform(-_NOISE, _NOISE, len(rest))
    vertices, triangles = body
    return Scene(
        name=name,
        start=start,
        rest=rest,
        faces=faces,
        pins=pins,
        body_vertices=vertices,
        body_faces=triangles,
        pin_targets=flat[pins],
        steps=steps,
        time_step=0.02,
    )


def drop(vertices: int, *, steps: int) -> Scene:
    """A sheet of 1 m, held in its middle, falls onto the sphere: steps of 20 ms."""
    rest, faces, middle = sheet(round(vertices**0.5), 1.0)
    heights = np.full(len(rest), GAP)
    return _above("drop", sphere(), RADIUS, rest, faces, middle, heights, steps=steps)


def stack(vertices: int, *, steps: int) -> Scene:
    """Two sheets, one half on the other, fall over a round table: much of them stays in contact."""
    rest, faces, middle = sheet(round((vertices / 2) ** 0.5), 1.0)
    n = len(rest)
    cos, sin = np.cos(_TURN), np.sin(_TURN)
    turned = rest @ np.array([[cos, sin], [-sin, cos]]) + [_SHIFT, 0.0]
    return _above(
        "stack",
        table(),
        0.0,
        np.concatenate([rest, turned]),
        np.concatenate([faces, faces + n]).astype(np.int32),
        np.concatenate([middle, middle + n]),
        GAP * np.repeat([1.0, 2.0], n),
        steps=steps,
    )


def settle(vertices: int) -> Scene:
    """The flat sheet of `drop`, straight to its static drape."""
    return dataclasses.replace(drop(vertices, steps=0), name="settle", time_step=1.0)


def drape(vertices: int, *, growth: float = 1.01) -> Scene:
    """From a settled sheet, the static drape of one whose rest shape has grown.

    Raises:
        FileNotFoundError: no settled sheet of so many vertices is kept.
    """
    scene = settle(vertices)
    with np.load(SETTLED / f"{len(scene.start)}.npz") as kept:
        start = kept["positions"].astype(np.float64)
    return dataclasses.replace(scene, name="drape", start=start, rest=growth * scene.rest)
