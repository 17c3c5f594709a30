"""Images: coverage, occlusion, sides, perspective, degenerate input, views, traces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from render_scenes import (
    SIZE,
    compiled_render,
    coverage,
    front_camera,
    nothing,
    padded_mesh,
    render_jit,
    slopes,
    sphere,
)

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.render.cameras import look_at_camera, stack_cameras
from dress_jax.render.images import check_image, render, render_views
from dress_jax.render.mesh import make_render_mesh
from dress_jax.render.rings import magicman_cameras
from dress_jax.render.views import mean_over_views

# Mean absolute error of the mask against the exact box-filtered coverage, whose 8 x 8 samples have
# an error of about 1/16 on the 2 % of pixels at a contour.
COVERAGE_TOLERANCE = 1.5e-3

SQUARE = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]) + 0.003
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_mask_is_coverage_with_an_occluder():
    ball, small = sphere(), sphere(0.3, (0.5, 0.1, 0.8))
    image = render_jit(front_camera(), padded_mesh(*ball), padded_mesh(*small))
    expected = coverage([ball, small], SIZE, 8)
    assert np.abs(np.asarray(image.mask) - expected).mean() < COVERAGE_TOLERANCE
    assert image.mask.min() >= 0 and image.mask.max() <= 1
    # Hidden parts are black, and so is the body.
    small_alone = coverage([small], SIZE, 8)
    assert np.asarray(image.color)[small_alone == 1].mean() < 1e-3
    assert image.color.dtype == jnp.float32


def test_body_hides_and_is_hidden():
    ball = padded_mesh(*sphere())
    behind = padded_mesh(*sphere(0.3, (0.0, 0.0, -0.9)))
    front = padded_mesh(*sphere(0.3, (0.0, 0.0, 0.9)))
    alone = render_jit(front_camera(), ball, nothing()).mask
    np.testing.assert_array_equal(render_jit(front_camera(), ball, behind).mask, alone)
    assert render_jit(front_camera(), ball, front).mask[SIZE // 2, SIZE // 2] == 0


def test_background_and_colors():
    mesh = padded_mesh(SQUARE, SQUARE_FACES, colors=np.tile([0.2, 0.4, 0.6], (4, 1)))
    image = render_jit(front_camera(), mesh, nothing(), background=(1.0, 1.0, 1.0))
    mask = np.asarray(image.mask)[..., None]
    np.testing.assert_allclose(
        image.color, mask * np.array([0.2, 0.4, 0.6]) + (1 - mask), atol=1e-6
    )
    # One square metre of four.
    assert float(image.mask.mean()) == pytest.approx(0.25, abs=1e-3)
    assert np.isinf(np.asarray(image.depth)[0, 0])
    assert image.depth[SIZE // 2, SIZE // 2] == pytest.approx(4.0 - 0.003, abs=1e-5)


@pytest.mark.parametrize("turned", [False, True])
def test_both_sides_are_seen_and_normals_face_the_camera(turned):
    faces = SQUARE_FACES[:, ::-1] if turned else SQUARE_FACES
    image = render_jit(front_camera(), padded_mesh(SQUARE, faces), nothing())
    inside = np.asarray(image.mask) == 1
    np.testing.assert_allclose(
        np.asarray(image.normal)[inside], np.tile([0, 0, 1.0], (inside.sum(), 1)), atol=1e-6
    )
    back = render_jit(front_camera(azimuth=180.0), padded_mesh(SQUARE, faces), nothing())
    assert back.normal[SIZE // 2, SIZE // 2, 2] == pytest.approx(-1.0)


def test_normals_are_world_frame_unit_vectors():
    image = render_jit(front_camera(azimuth=-60.0), padded_mesh(*sphere()), nothing())
    inside = np.asarray(image.mask) == 1
    normals = np.asarray(image.normal)[inside]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    toward = np.array([np.sin(np.deg2rad(-60)), 0, np.cos(np.deg2rad(-60))])
    np.testing.assert_allclose(image.normal[SIZE // 2, SIZE // 2], toward, atol=0.05)


def test_perspective_interpolation():
    """Attributes that are linear in the world come out at the ray's point on a slanted plane."""
    square = np.array([[-2.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 0.3, -6.0], [-2.0, 0.3, -6.0]])
    camera = look_at_camera(
        [0.2, 1.0, 2.0], [0.0, 0.0, -1.0], vertical_angle=0.8, height=SIZE, width=SIZE
    )
    mesh = padded_mesh(square, SQUARE_FACES, colors=square)
    image = render_jit(camera, mesh, nothing())
    row, column = np.nonzero(np.asarray(image.mask) == 1)
    rays = np.stack(
        [
            (column - camera.principal[0]) / camera.scale[0],
            -(row - camera.principal[1]) / camera.scale[1],
            -np.ones(len(row)),
        ],
        axis=1,
    ) @ np.asarray(camera.rotation)
    normal = np.cross(square[1] - square[0], square[2] - square[0])
    reach = (square[0] - np.asarray(camera.position)) @ normal / (rays @ normal)
    points = np.asarray(camera.position) + reach[:, None] * rays
    assert len(points) > 500
    np.testing.assert_allclose(np.asarray(image.color)[row, column], points, atol=2e-5)
    np.testing.assert_allclose(np.asarray(image.depth)[row, column], reach, rtol=1e-5)


DEGENERATE = {
    "point": [[0.1, 0.1, 0.0]] * 3,
    "needle": [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.1, 0.0, 0.0]],
    "edge-on": [[-0.5, 0.1, 0.0], [0.5, 0.1, 0.0], [0.0, 0.1, 1.0]],
    "nearly edge-on": [[-0.5, 0.1, 0.0], [0.5, 0.1, 0.0], [0.0, 0.1 + 1e-7, 1.0]],
    "off-screen": [[3.0, 3.0, 0.0], [4.0, 3.0, 0.0], [3.0, 4.0, 0.0]],
    "partly off-screen": [[0.0, 0.0, 0.0], [40.0, 3.0, 0.0], [3.0, 40.0, 0.0]],
    "behind": [[-1.0, -1.0, 9.0], [1.0, -1.0, 9.0], [0.0, 1.0, 9.0]],
    "across the eye": [[-0.5, -0.2, 9.0], [0.5, -0.2, -9.0], [0.0, 0.5, -9.0]],
    "through the eye plane": [[0.0, 0.0, 4.0], [1.0, 0.0, 4.0], [0.0, 1.0, -1.0]],
    "below a pixel": [[0.0, 0.0, 0.0], [0.012, 0.0, 0.0], [0.0, 0.012, 0.0]],
    "on pixel centres": [[-47 / 96, -47 / 96, 0], [49 / 96, -47 / 96, 0], [49 / 96, 49 / 96, 0]],
}


@pytest.mark.parametrize("name", DEGENERATE)
@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_degenerate_triangles_give_finite_images_and_gradients(name, kind):
    if kind == "orthographic":
        camera = front_camera()
    else:
        camera = look_at_camera([0, 0, 4.0], [0, 0, 0], vertical_angle=0.5, height=SIZE, width=SIZE)
    mesh = padded_mesh(np.array(DEGENERATE[name]), np.array([[0, 1, 2]]))
    body = padded_mesh(*sphere(0.2, (0.3, 0.3, -1.0)))
    image = render_jit(camera, mesh, body)
    for part in (image.mask, image.color, image.normal, image.attributes):
        assert np.isfinite(part).all()
    assert image.mask.min() >= 0 and image.mask.max() <= 1
    weights = {n: 2 * getattr(image, n) for n in ("mask", "color", "normal", "attributes")}
    for slope in jax.tree.leaves(slopes(camera, mesh, body, **weights)):
        assert np.isfinite(slope).all()
    if name in ("point", "needle", "off-screen", "behind"):
        assert not image.mask.any()


def test_step_limit_is_reported():
    """Fine triangles need many steps; a limit that is too low is counted and raises."""
    mesh = padded_mesh(*sphere(0.05, (0.3, 0.2, 0.0)))
    whole = render_jit(front_camera(), mesh, nothing())
    assert whole.unfinished == 0
    assert check_image(whole) is whole
    cut = render_jit(front_camera(), mesh, nothing(), step_limit=1)
    assert cut.unfinished > 0
    with pytest.raises(InputError, match="step_limit"):
        check_image(cut)


def test_contours_are_found_on_triangles_below_a_pixel():
    """A ball of 80 triangles per pixel still has the coverage of a disc."""
    ball = sphere(0.06, (0.3, 0.2, 0.0))
    image = render_jit(front_camera(), padded_mesh(*ball), nothing())
    expected = coverage([ball], SIZE, 16)
    assert np.abs(np.asarray(image.mask) - expected).sum() < 0.1 * expected.sum()
    assert float(image.mask.sum()) == pytest.approx(expected.sum(), rel=0.02)


def test_seams_are_not_contours():
    """A cut along the middle, welded by a map, draws as if it were whole."""
    left, right = [[-0.6, -0.5], [0.01, -0.52], [0.0, 0.5]], [[0.01, -0.52], [0.6, 0.1], [0.0, 0.5]]
    points = np.array([[*p, 0.0] for p in left + right])
    colors = np.repeat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 3, axis=0)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    weld = np.array([0, 1, 2, 1, 3, 2])
    sewn = render_jit(front_camera(), padded_mesh(points, faces, colors, weld_map=weld), nothing())
    cut = render_jit(front_camera(), padded_mesh(points, faces, colors), nothing())
    # They differ where the seam reaches the outline: a corner inside one pixel.
    assert np.abs(np.asarray(sewn.mask) - np.asarray(cut.mask)).sum() < 1.0
    mixed = np.logical_and(*np.moveaxis(np.asarray(sewn.color)[..., :2], -1, 0))
    assert not mixed[20:-20, 20:-20].any()
    assert np.logical_and(*np.moveaxis(np.asarray(cut.color)[..., :2], -1, 0)).any()


def test_views():
    cameras = magicman_cameras(3, center=np.zeros(3), half_extent=1.0, size=SIZE)
    garment, body = padded_mesh(*sphere()), padded_mesh(*sphere(0.3, (0.5, 0.1, 0.8)))
    stack = stack_cameras(cameras)
    target = jnp.linspace(0.0, 1.0, 3 * SIZE**2).reshape(3, SIZE, SIZE)

    def loss(operands, view):
        camera, target, garment, body = *view, *operands
        return jnp.sum(render(camera, garment, body).mask * target)

    @jax.jit
    def both(positions):
        """The mean loss with its gradient, and all images."""

        def mean(positions):
            operands = (replace(garment, positions=positions), body)
            return mean_over_views(loss, operands, (stack, target))

        return jax.value_and_grad(mean)(positions), render_views(stack, garment, body)

    (value, slope), images = both(garment.positions)
    values, expected = [], []
    for index, camera in enumerate(cameras):
        one = render_jit(camera, garment, body)
        np.testing.assert_allclose(images.mask[index], one.mask, atol=1e-6)
        np.testing.assert_array_equal(images.face[index], one.face)
        values.append(float(jnp.sum(one.mask * target[index])))
        expected.append(slopes(camera, garment, body, mask=target[index])[1])
    assert float(value) == pytest.approx(np.mean(values), rel=1e-5)
    expected = np.mean(expected, axis=0)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(slope, expected, atol=1e-5 * np.abs(expected).max())


def test_mean_over_views_in_closed_form():
    """Values, slopes of nested operands, and index arrays among them."""
    operands = {"a": jnp.asarray([1.0, 2.0]), "index": jnp.asarray([1, 0])}
    views = jnp.asarray([[1.0, 3.0], [5.0, 7.0]])

    def loss(operands, view):
        return jnp.sum(operands["a"][operands["index"]] ** 2 * view)

    def scaled(a):
        return 3.0 * mean_over_views(loss, operands | {"a": a}, views)

    value, slope = jax.value_and_grad(scaled)(operands["a"])
    assert float(value) == pytest.approx(3 * (4 * 3 + 1 * 5)) == float(scaled(operands["a"]))
    np.testing.assert_allclose(slope, 3 * 2 * np.array([1.0 * 5, 2.0 * 3]))


def test_empty_garment():
    empty = make_render_mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=int))
    image = jax.jit(render)(front_camera(16), empty)
    assert not image.mask.any() and (image.face == -1).all()


def test_one_trace_for_all_poses_and_meshes():
    before = compiled_render._cache_size()
    render_jit(front_camera(), padded_mesh(*sphere()), nothing())
    filled = compiled_render._cache_size()
    assert filled <= before + 1
    for azimuth in (0.0, 30.0):
        for mesh in (padded_mesh(*sphere(0.2)), padded_mesh(SQUARE, SQUARE_FACES)):
            render_jit(front_camera(azimuth=azimuth), mesh, padded_mesh(*sphere()))
    assert compiled_render._cache_size() == filled
