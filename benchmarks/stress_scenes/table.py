"""The scenes, by name: each a function of how fine it is, 1 for seconds, 4 for minutes."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from dress_jax.body.model import forward, named_shape
from dress_jax.body.poses import a_pose, interpolate_poses
from dress_jax.energy.cloth import Gravity
from dress_jax.io.bodies import load_default_body
from dress_jax.sim.dressing.motion import follow_body

from .scene import Scene, fall, make_scene
from .shapes import (
    ball,
    copies,
    graded,
    level,
    needles,
    plate,
    ring,
    sheet,
    together,
    tube,
)


def through_a_ring(fine: int) -> Scene:
    """The middle of a sheet is pulled through a ring a fifth as wide as the sheet."""
    rest, faces = sheet(8 * fine + 1, 0.3)
    start = level(rest, 0.012)
    middle = np.flatnonzero(np.linalg.norm(rest, axis=1) < 0.02)

    def act(simulator, parameters, positions):
        def targets(part):
            return positions[middle] - [0.0, 0.3 * part, 0.0]

        return fall(simulator, parameters, positions, steps=10, time_step=0.03, targets=targets)

    return make_scene(rest, faces, start, act, body=ring(0.035, 0.006), pins=middle)


def twisted_cylinder(fine: int) -> Scene:
    """Both ends of a cylinder turn against each other, by three quarters of a turn each."""
    rest, rest_faces, start, faces = tube(10 * fine, 7 * fine, 0.05, 0.2)
    ends = np.flatnonzero(np.abs(np.abs(start[:, 1]) - 0.1) < 1e-9)
    side = np.sign(start[ends, 1])

    def act(simulator, parameters, positions):
        def targets(part):
            turn = Rotation.from_rotvec(np.outer(1.5 * np.pi * part * side, [0.0, 1.0, 0.0]))
            closer = [1.0, 1.0 - 0.3 * part, 1.0]
            return turn.apply(positions[ends]) * closer

        return fall(simulator, parameters, positions, steps=10, time_step=0.03, targets=targets)

    return make_scene(
        rest, faces, start, act, pins=ends, rest_faces=rest_faces, gravity=Gravity.NONE
    )


def ten_layers(fine: int) -> Scene:
    """Ten sheets fall onto each other and onto a sphere."""
    rest, faces = sheet(4 * fine, 0.16)
    layers = [level(rest, 0.06 + 0.005 * number) for number in range(10)]

    def act(simulator, parameters, positions):
        return fall(simulator, parameters, positions, steps=8, time_step=0.03)

    return make_scene(*copies(rest, faces, 10), np.concatenate(layers), act, body=ball(0.055))


def needle_bed(fine: int) -> Scene:
    """A sheet is thrown onto needles."""
    rest, faces = sheet(8 * fine, 0.2)

    def act(simulator, parameters, positions):
        velocity = np.array([0.1, -1.0, 0.0])
        return fall(simulator, parameters, positions, steps=8, time_step=0.02, velocity=velocity)

    body = together(needles(4, 0.04, 0.06), plate(0.4, -0.06))
    return make_scene(rest, faces, level(rest, 0.01), act, body=body)


def corner_first(fine: int) -> Scene:
    """A sheet falls onto the ground with a corner first and folds over itself."""
    rest, faces = sheet(7 * fine, 0.2)
    upright = np.c_[rest, np.zeros(len(rest))]
    start = Rotation.from_euler("zx", [45.0, 5.0], degrees=True).apply(upright)
    start[:, 1] += 0.01 - start[:, 1].min()

    def act(simulator, parameters, positions):
        velocity = np.array([0.0, -2.0, 0.0])
        return fall(simulator, parameters, positions, steps=10, time_step=0.02, velocity=velocity)

    return make_scene(rest, faces, start, act, body=plate(0.5, 0.0))


def between_plates(fine: int) -> Scene:
    """Two wavy sheets between plates that close to 8 mm."""
    rest, faces = sheet(7 * fine, 0.15)
    lower = level(rest, -0.005)
    wave = 0.012 * np.sin(60.0 * rest[:, 0]) * np.cos(50.0 * rest[:, 1])
    lower[:, 1] += wave
    start = np.concatenate([lower, lower + np.array([0.003, 0.01, 0.002])])
    top, bottom = plate(0.2, 0.04), plate(0.2, -0.03)
    body, body_faces = together(top, bottom)
    count = len(top[0])

    def act(simulator, parameters, positions):
        closed = body.copy()
        closed[:count, 1] -= 0.03 - 0.004  # its lower side at 4 mm
        closed[count:, 1] += 0.03 - 0.004
        return follow_body(simulator, parameters, positions, closed[None])

    return make_scene(
        *copies(rest, faces, 2), start, act, body=(body, body_faces), gravity=Gravity.NONE
    )


def arm_to_torso(fine: int) -> Scene:
    """A cloth floats between arm and trunk of the default body; the arm comes down to a few mm."""
    model = load_default_body()
    shape = jnp.asarray(named_shape(model, "average"))

    def posed(pose):
        return np.array(forward(model, jnp.asarray(pose), shape, jnp.zeros(3)).vertices)

    way = interpolate_poses(a_pose(angle=60.0), a_pose(angle=84.0), steps=1 + 2 * fine)
    body = posed(way[0])
    rest, faces = sheet(6 * fine, 0.2)
    # Upright between the waist and the armpit, beside the trunk.
    height = body[:, 1].min() + 0.63 * np.ptp(body[:, 1])
    start = np.stack([np.full(len(rest), 0.19), height + rest[:, 1], rest[:, 0]], 1)

    def act(simulator, parameters, positions):
        frames = np.array([posed(pose) for pose in way[1:]])
        return follow_body(simulator, parameters, positions, frames)

    return make_scene(
        rest,
        faces,
        start,
        act,
        body=(body, np.asarray(model.faces)),
        gravity=Gravity.NONE,
    )


def slivers(fine: int) -> Scene:
    """Tiny and sliver triangles fall onto a sphere."""
    rest, faces = graded(5 + 3 * fine, 30.0, 0.15, slivers=True)

    def act(simulator, parameters, positions):
        return fall(simulator, parameters, positions, steps=6, time_step=0.03)

    return make_scene(rest, faces, level(rest, 0.045), act, body=ball(0.04))


def coincident(fine: int) -> Scene:
    """Equal meshes between equal plates that close: edges parallel, vertices in line."""
    rest, faces = sheet(6 * fine, 0.12)
    layers = [level(rest, 0.004 + 0.004 * number) for number in range(3)]
    body, body_faces = together((level(rest, 0.0), faces), (level(rest, 0.016), faces[:, ::-1]))

    def act(simulator, parameters, positions):
        closed = body.copy()
        closed[len(rest) :, 1] = 0.006
        return follow_body(simulator, parameters, positions, closed[None])

    return make_scene(
        *copies(rest, faces, 3),
        np.concatenate(layers),
        act,
        body=(body, body_faces),
        gravity=Gravity.NONE,
    )


def many_sizes(fine: int) -> Scene:
    """Triangles of sizes from 1 to 50 fall onto a sphere, the smallest first."""
    rest, faces = graded(6 + 4 * fine, 50.0, 0.3)

    def act(simulator, parameters, positions):
        return fall(simulator, parameters, positions, steps=8, time_step=0.03)

    return make_scene(rest, faces, level(rest, 0.045), act, body=ball(0.04))


SCENES: dict[str, Callable[[int], Scene]] = {
    scene.__name__: scene
    for scene in (
        through_a_ring,
        twisted_cylinder,
        ten_layers,
        needle_bed,
        corner_first,
        between_plates,
        arm_to_torso,
        slivers,
        coincident,
        many_sizes,
    )
}
