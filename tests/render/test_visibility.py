"""Visible faces against a z-buffer and a ray caster in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from render_scenes import SIZE, front_camera, sphere, zbuffer

from dress_jax.render.cameras import look_at_camera
from dress_jax.render.compaction import append, compact, padded_size
from dress_jax.render.visibility import TILE_CHUNK, WINDOW, rasterize, to_screen


@jax.jit
def visible(camera, positions, faces):
    screen = to_screen(camera, positions)
    return rasterize(camera, screen, faces), screen


def soup(seed, count, reach):
    """Triangles of sizes from below a pixel to the whole image."""
    random = np.random.default_rng(seed)
    center = random.uniform(-1.2, 1.2, (count, 1, 3))
    size = reach * random.uniform(0.01, 1.0, (count, 1, 1)) ** 3
    corners = center + size * random.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_soup_matches_z_buffer(seed):
    positions, faces = soup(seed, 400, 1.0)
    camera = front_camera()
    (ids, keys), screen = visible(camera, jnp.asarray(positions), jnp.asarray(faces))
    expected = zbuffer(screen.x, screen.y, screen.depth, faces, SIZE, SIZE)
    np.testing.assert_array_equal(np.asarray(ids).reshape(SIZE, SIZE), expected)
    assert np.isinf(np.asarray(keys)[np.asarray(ids) < 0]).all()


def test_closed_surface_has_no_cracks():
    positions, faces = sphere()
    (ids, _), screen = visible(front_camera(), jnp.asarray(positions), jnp.asarray(faces))
    expected = zbuffer(screen.x, screen.y, screen.depth, faces, SIZE, SIZE)
    np.testing.assert_array_equal(np.asarray(ids).reshape(SIZE, SIZE), expected)


def test_more_tiles_than_one_chunk():
    """Layers over the whole image need several chunks of tiles; the nearest one wins everywhere."""
    layers = 20
    assert layers * (SIZE / WINDOW) ** 2 > TILE_CHUNK
    corner = np.array([[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 30.0, 0.0]])
    positions = np.concatenate([corner + np.array([0, 0, 0.01 * k]) for k in range(layers)])
    faces = np.arange(3 * layers).reshape(-1, 3)
    (ids, _), _ = visible(front_camera(), jnp.asarray(positions), jnp.asarray(faces))
    assert (np.asarray(ids) == layers - 1).all()


def _cast(camera, positions, faces, near):
    """Nearest face along each pixel's ray beyond the near plane, and the margin of the choice."""
    rotation, eye = np.asarray(camera.rotation), np.asarray(camera.position)
    local = (positions - eye) @ rotation.T
    height, width = camera.height, camera.width
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack(
        [
            (column - camera.principal[0]) / camera.scale[0],
            -(row - camera.principal[1]) / camera.scale[1],
            -np.ones_like(column),
        ],
        axis=-1,
    ).reshape(-1, 3)
    a, b, c = (local[faces[:, k]] for k in range(3))
    # Solve t ray = a + u (b - a) + v (c - a) for all pairs.
    matrix = np.stack([a - b, a - c], axis=-1)[None].repeat(len(rays), axis=0)
    full = np.concatenate([rays[:, None, :, None].repeat(len(faces), axis=1), matrix], axis=-1)
    t, u, v = np.moveaxis(np.linalg.solve(full, a[None, :, :, None])[..., 0], -1, 0)
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > near)
    depth = np.where(inside, t, np.inf)
    ids = np.where(inside.any(axis=1), depth.argmin(axis=1), -1)
    margin = np.abs(np.stack([u, v, 1 - u - v, t - near])).min(axis=(0, 2))
    sorted_depth = np.sort(depth, axis=1)
    with np.errstate(invalid="ignore"):
        gap = sorted_depth[:, 1] - sorted_depth[:, 0]
    return ids, np.minimum(margin, np.where(np.isnan(gap), np.inf, gap))


@pytest.mark.parametrize("seed", [3, 4])
def test_perspective_and_near_plane_match_a_ray_caster(seed):
    """The eye stands inside the soup: faces behind it, around it and across its near plane."""
    positions, faces = soup(seed, 80, 2.0)
    camera = look_at_camera(
        [0.1, 0.0, 0.2], [0.0, 0.1, -1.0], vertical_angle=1.2, height=40, width=48, near=0.05
    )
    (ids, _), _ = visible(camera, jnp.asarray(positions), jnp.asarray(faces))
    depth = -((positions - np.asarray(camera.position)) @ np.asarray(camera.rotation)[2])
    across = (depth[faces] > 0.05).any(axis=1) & (depth[faces] < 0.05).any(axis=1)
    expected, margin = _cast(camera, positions, faces, 0.05)
    assert set(np.flatnonzero(across)) & set(expected), "no face is cut by the near plane"
    clear = margin > 1e-4
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(np.asarray(ids)[clear], expected[clear])


def test_no_faces():
    (ids, keys), _ = visible(front_camera(), jnp.zeros((3, 3)), jnp.zeros((0, 3), jnp.int32))
    assert (ids == -1).all() and jnp.isinf(keys).all()


@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
def test_compaction_keeps_every_entry(density):
    flags = np.random.default_rng(0).random(20_000) < density
    index, count = compact(jnp.asarray(flags))
    assert index.shape == (padded_size(20_000),) and count == flags.sum()
    np.testing.assert_array_equal(index[: int(count)], np.flatnonzero(flags))


def test_append():
    (grown,), count = append(
        (jnp.array([7, 8, 0, 0, 0]),),
        jnp.asarray(2),
        (jnp.array([1, 2, 3]),),
        jnp.array([True, False, True]),
    )
    np.testing.assert_array_equal(grown, [7, 8, 1, 3, 0])
    assert count == 4
