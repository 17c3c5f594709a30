"""Scenes and references that the rendering tests share.

Small scenes are padded to one size, so that they all run the same compiled programs.
"""

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from dress_jax.core.pytree import replace
from dress_jax.render.cameras import Camera, project
from dress_jax.render.images import render
from dress_jax.render.mesh import RenderMesh, build_adjacency
from dress_jax.render.rings import ring_cameras
from dress_jax.render.silhouettes import STEP_LIMIT

SIZE = 96
VERTICES, FACES = 704, 1344


@jax.jit
def compiled_render(camera, garment, body, background, step_limit):
    """`render`, with every option an array, so that all tests share a program."""
    return render(camera, garment, body, background=background, step_limit=step_limit)


def render_jit(camera, garment, body, *, background=(0.0, 0.0, 0.0), step_limit=STEP_LIMIT):
    """An image of a padded scene."""
    return compiled_render(camera, garment, body, jnp.asarray(background), step_limit)


@jax.jit
def _pull(camera, garment, body, weights):
    def total(camera, positions, colors, body_positions):
        image = render(
            camera,
            replace(garment, positions=positions, colors=colors),
            replace(body, positions=body_positions),
        )
        return sum(jnp.sum(getattr(image, name) * weight) for name, weight in weights.items())

    arguments = (camera, garment.positions, garment.colors, body.positions)
    return jax.grad(total, argnums=(0, 1, 2, 3))(*arguments)


def slopes(camera: Camera, garment, body, **weights):
    """Gradients of a weighted sum of an image's channels.

    Returns:
        With respect to camera, garment positions, garment colours and body positions.
    """
    shape = (camera.height, camera.width)
    full = {
        "mask": jnp.zeros(shape),
        "color": jnp.zeros((*shape, 3)),
        "normal": jnp.zeros((*shape, 3)),
        "attributes": jnp.zeros((*shape, 1)),
    }
    full.update({name: jnp.broadcast_to(w, full[name].shape) for name, w in weights.items()})
    return _pull(camera, garment, body, full)


def front_camera(size=SIZE, azimuth=0.0):
    """Orthographic, +-1 m, from +z."""
    return ring_cameras([azimuth], size=size, center=[0.0, 0.0, 0.0], half_extent=1.0)[0]


def padded_mesh(positions, faces, colors=None, attributes=None, weld_map=None):
    """A RenderMesh of the common size; padding faces join vertex 0 with itself."""
    positions, faces = np.asarray(positions, dtype=float), np.asarray(faces)
    count, missing = len(positions), VERTICES - len(positions)
    colors = np.ones((count, 3)) if colors is None else np.asarray(colors, dtype=float)
    attributes = np.zeros((count, 1)) if attributes is None else np.asarray(attributes, dtype=float)
    adjacency = build_adjacency(faces, weld_map)

    def rows(array, total, value=0):
        return np.pad(array, [(0, total - len(array)), (0, 0)], constant_values=value)

    assert missing >= 0 and len(faces) <= FACES
    return RenderMesh(
        positions=jnp.asarray(rows(positions, VERTICES)),
        faces=jnp.asarray(rows(faces, FACES).astype(np.int32)),
        adjacency=jnp.asarray(rows(adjacency, FACES, -1)),
        colors=jnp.asarray(rows(colors, VERTICES)),
        attributes=jnp.asarray(rows(attributes, VERTICES)),
    )


def sphere(radius=0.6, center=(0.0, 0.0, 0.0)):
    """642 vertices, 1280 faces."""
    ball = trimesh.creation.icosphere(3, radius)
    return np.asarray(ball.vertices) + np.asarray(center), np.asarray(ball.faces)


def nothing():
    """A mesh of which nothing is seen."""
    return padded_mesh(np.zeros((1, 3)), np.zeros((0, 3), dtype=int))


def zbuffer(x, y, depth, faces, height, width):
    """Visible face per pixel centre, -1 for none: a plain z-buffer in float64."""
    ids, nearest = np.full((height, width), -1), np.full((height, width), np.inf)
    x, y, depth = (np.asarray(a, dtype=np.float64) for a in (x, y, depth))
    for face, (a, b, c) in enumerate(np.asarray(faces)):
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        if area == 0:
            continue
        corner_x, corner_y = x[[a, b, c]], y[[a, b, c]]
        left, right = max(0, int(np.ceil(corner_x.min()))), min(width - 1, int(corner_x.max()))
        top, bottom = max(0, int(np.ceil(corner_y.min()))), min(height - 1, int(corner_y.max()))
        if left > right or top > bottom:
            continue
        px, py = np.meshgrid(np.arange(left, right + 1), np.arange(top, bottom + 1))
        wa = ((x[c] - x[b]) * (py - y[b]) - (y[c] - y[b]) * (px - x[b])) / area
        wb = ((x[a] - x[c]) * (py - y[c]) - (y[a] - y[c]) * (px - x[c])) / area
        wc = ((x[b] - x[a]) * (py - y[a]) - (y[b] - y[a]) * (px - x[a])) / area
        z = wa * depth[a] + wb * depth[b] + wc * depth[c]
        box = np.s_[top : bottom + 1, left : right + 1]
        wins = (wa >= 0) & (wb >= 0) & (wc >= 0) & (z < nearest[box])
        ids[box] = np.where(wins, face, ids[box])
        nearest[box] = np.where(wins, z, nearest[box])
    return ids


def coverage(meshes, size, factor):
    """Part of each pixel in which the first of some meshes is seen, by supersampling."""
    fine = size * factor
    offsets = np.cumsum([0] + [len(positions) for positions, _ in meshes])
    points = np.concatenate([positions for positions, _ in meshes])
    faces = np.concatenate([f + o for (_, f), o in zip(meshes, offsets[:-1], strict=True)])
    x, y, depth = project(front_camera(fine), jnp.asarray(points))
    ids = zbuffer(x, y, depth, faces, fine, fine)
    seen = (ids >= 0) & (ids < len(meshes[0][1]))
    return seen.reshape(size, factor, size, factor).mean(axis=(1, 3))
