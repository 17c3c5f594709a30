"""Gradients: areas against supersampled differences, interior terms against the image itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from render_scenes import (
    SIZE,
    coverage,
    front_camera,
    nothing,
    padded_mesh,
    render_jit,
    slopes,
    sphere,
)

from dress_jax.render.attributes import find_visibility, render_attributes
from dress_jax.render.mesh import build_adjacency

FINE = 256
"""Image size of the area tests [px]."""

AREA_TOLERANCE = 0.05
"""Of the exact derivative; the estimator samples a contour once per row or column."""

STEP = 1.5 * 2.0 / FINE
"""Difference step: one and a half pixels average the sampling of a contour."""

SAMPLES = 4
"""Supersampling of the reference areas; 1,024 x 1,024 centres."""


def area_slopes(garment, body):
    """Of the garment's visible area [m2] in its own and the body's vertices."""
    _, of_garment, _, of_body = slopes(front_camera(FINE), garment, body, mask=(2.0 / FINE) ** 2)
    return of_garment, of_body


def _reference(meshes, which, field):
    """Central difference of the supersampled visible area as one mesh moves along a field."""

    def area(sign):
        moved = [
            (p + sign * STEP * field if k == which else p, f) for k, (p, f) in enumerate(meshes)
        ]
        return coverage(moved, FINE, SAMPLES).sum() * (2.0 / FINE) ** 2

    return (area(1.0) - area(-1.0)) / (2.0 * STEP)


def _check(meshes, which, field):
    padded = [padded_mesh(*mesh) for mesh in meshes] + [nothing()] * (2 - len(meshes))
    slope = np.asarray(area_slopes(*padded)[which])[: len(field)]
    got, expected = float((slope * field).sum()), _reference(meshes, which, field)
    assert abs(expected) > 0.05
    assert got == pytest.approx(expected, rel=AREA_TOLERANCE)


BALL = sphere()
TRIANGLE = (
    np.array([[-0.5, -0.4, 0.0], [0.6, -0.2, 0.3], [0.1, 0.7, -0.2]]),
    np.array([[0, 1, 2]]),
)
SMALL = sphere(0.3, (0.5, 0.1, 0.8))


def test_growing_sphere():
    _check([BALL], 0, BALL[0])


def test_stretched_sphere():
    _check([BALL], 0, BALL[0] * np.array([1.0, 0.0, 0.0]))


def test_moving_sphere_keeps_its_area():
    slope = area_slopes(padded_mesh(*BALL), nothing())[0]
    assert abs(float(slope[:, 0].sum())) < 0.02
    assert np.abs(slope[:, 2]).max() < 1e-6


@pytest.mark.parametrize("vertex", [0, 1, 2])
def test_tilted_triangle(vertex):
    for axis in range(2):
        field = np.zeros((3, 3))
        field[vertex, axis] = 1.0
        if abs(_reference([TRIANGLE], 0, field)) > 0.05:
            _check([TRIANGLE], 0, field)


def test_partly_hidden_sphere_grows():
    _check([BALL, SMALL], 0, BALL[0])


def test_occluder_moves_over_the_garment():
    _check([BALL, SMALL], 1, np.tile([1.0, 0.0, 0.0], (len(SMALL[0]), 1)))
    _check([BALL, SMALL], 1, SMALL[0] - np.array([0.5, 0.1, 0.8]))


def test_garment_moves_over_the_body():
    """Only the garment is white: its contour in front of the black body counts."""
    _check([SMALL, BALL], 0, SMALL[0] - np.array([0.5, 0.1, 0.8]))


def test_fine_sphere():
    """Triangles below a pixel: contours must be found across several triangles."""
    ball = trimesh.creation.icosphere(5, 0.6)
    points, faces = jnp.asarray(ball.vertices), jnp.asarray(ball.faces)
    adjacency = jnp.asarray(build_adjacency(np.asarray(ball.faces)))

    @jax.jit
    def slope(points):
        def area(p):
            image = render_attributes(
                front_camera(64),
                p,
                faces,
                jnp.ones((points.shape[0], 1)),
                adjacency,
                background=jnp.zeros(1),
            )
            return jnp.sum(image) * (2.0 / 64) ** 2

        return jax.grad(area)(points)

    got = float(jnp.sum(slope(points) * points))
    assert got == pytest.approx(2 * np.pi * 0.36, rel=AREA_TOLERANCE)


def test_mask_gradient_is_zero_inside():
    """S10.9: the mask says nothing about vertices away from the contour."""
    slope = np.asarray(area_slopes(padded_mesh(*BALL), nothing())[0])
    slope = slope[: len(BALL[0])]
    radius = np.hypot(BALL[0][:, 0], BALL[0][:, 1])
    assert not slope[radius < 0.45].any()
    rim = slope[radius > 0.595]
    assert np.abs(rim).max() > 1e-3


LAYERS = (
    np.array(
        [
            [-0.53, -0.47, 0.0],
            [0.61, -0.22, 0.3],
            [0.13, 0.71, -0.2],
            [-0.2, -0.3, 0.5],
            [0.5, 0.11, 0.6],
            [-0.1, 0.4, 0.7],
            # Smaller than a pixel about the centre of one: its weights add up to more than one.
            [-0.7 - 0.008, 0.70 - 0.006, 0.0],
            [-0.7 + 0.009, 0.70 - 0.005, 0.0],
            [-0.7 + 0.001, 0.70 + 0.008, 0.0],
        ]
    ),
    np.arange(9).reshape(3, 3),
)


def _layers_on_a_centre():
    """The small triangle of `LAYERS` moved so that it holds a pixel centre."""
    points = LAYERS[0].copy()
    pixel = 2.0 / SIZE
    centre = np.round((points[6:].mean(axis=0)[:2] + 1) / pixel - 0.5) * pixel + 0.5 * pixel - 1
    points[6:, :2] += centre - points[6:, :2].mean(axis=0) + [0.001, 0.0005]
    return points


def test_reverse_rule_against_differences_of_the_image():
    """Every derivative of the drawn image with visibility fixed, against central differences."""
    random = np.random.default_rng(0)
    points = jnp.asarray(_layers_on_a_centre())
    faces = jnp.asarray(LAYERS[1])
    adjacency = jnp.asarray(build_adjacency(LAYERS[1]))
    attributes = jnp.asarray(random.random((9, 2)))
    background = jnp.asarray([0.3, 0.9])
    # Smooth, since the derivative jumps where an edge passes the middle of a pixel pair, by the
    # difference of the two pixels' weights.
    i = jnp.arange(SIZE)
    wave = jnp.cos(i[:, None, None] / 7 + jnp.arange(2.0)[None, None, :])
    probe = wave * jnp.sin(i / 9 + 1)[None, :, None]
    camera = front_camera()

    @jax.jit
    def value_and_slopes(points, attributes, background):
        visibility = find_visibility(camera, jnp.asarray(_layers_on_a_centre()), faces, adjacency)

        def value(points, attributes, background):
            image = render_attributes(
                camera,
                points,
                faces,
                attributes,
                adjacency,
                background=background,
                visibility=visibility,
            )
            return jnp.sum(image.astype(probe.dtype) * probe)

        arguments = (points, attributes, background)
        return jax.value_and_grad(value, argnums=(0, 1, 2))(*arguments), visibility.ids

    arguments = [points, attributes, background]
    (_, found), ids = value_and_slopes(*arguments)
    assert np.count_nonzero(np.asarray(ids) == 2) == 1
    directions = [(1, random.normal(size=(9, 2))), (2, np.array([1.0, -0.5]))]
    for triangle in range(3):
        direction = np.zeros((9, 3))
        direction[3 * triangle : 3 * triangle + 3] = random.normal(size=(3, 3))
        directions.append((0, direction))
    for k, direction in directions:
        # 0.0024 px: rounding of float32 pixel coordinates is a thousandth of it.
        step = 5e-5 if k == 0 else 1e-2

        def moved(sign, k=k, direction=direction, step=step):
            changed = list(arguments)
            changed[k] = changed[k] + sign * step * jnp.asarray(direction)
            return float(value_and_slopes(*changed)[0][0])

        difference = (moved(1.0) - moved(-1.0)) / (2 * step)
        got = float(np.sum(np.asarray(found[k]) * direction))
        assert abs(got) > 1.0
        assert got == pytest.approx(difference, rel=1e-2)


def test_camera_derivative_mirrors_the_points():
    """Moving the camera one way is moving everything the other way."""
    garment = padded_mesh(*sphere(0.5, (0.1, 0.0, 0.0)))
    weight = jnp.linspace(0.0, 1.0, SIZE)[None, :]
    of_camera, of_points, _, _ = slopes(front_camera(), garment, nothing(), mask=weight)
    assert abs(float(of_camera.position[0])) > 1.0
    np.testing.assert_allclose(of_camera.position, -of_points.sum(axis=0), rtol=1e-4, atol=1e-3)


def test_normal_gradient():
    """A square tilted about x by an angle a has the normal (0, -sin a, cos a)."""
    square = np.array([[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]])
    faces, angle = np.array([[0, 1, 2], [0, 2, 3]]), 0.3
    x, y = square.T
    mesh = padded_mesh(np.c_[x, y * np.cos(angle), y * np.sin(angle)], faces)
    turning = np.c_[np.zeros(4), -y * np.sin(angle), y * np.cos(angle)]
    inner = jnp.zeros((SIZE, SIZE, 1)).at[30:60, 30:60].set(1.0 / 900)
    normal = jnp.sum(render_jit(front_camera(), mesh, nothing()).normal * inner, axis=(0, 1))
    np.testing.assert_allclose(normal, [0, -np.sin(angle), np.cos(angle)], atol=1e-5)
    got = []
    for k in range(3):
        of_points = slopes(
            front_camera(), mesh, nothing(), normal=inner * jnp.eye(3)[None, None, k]
        )[1]
        got.append(float(np.sum(np.asarray(of_points)[:4] * turning)))
    np.testing.assert_allclose(got, [0, -np.cos(angle), -np.sin(angle)], atol=1e-4)


def test_color_gradient_is_the_share_of_the_image():
    """The image is linear in colours: its gradient adds up to the covered area."""
    mesh = padded_mesh(*BALL)
    slope = slopes(front_camera(), mesh, nothing(), color=1.0)[2]
    mask = render_jit(front_camera(), mesh, nothing()).mask
    assert float(slope.sum()) == pytest.approx(3 * float(mask.sum()), rel=1e-5)
    assert not slope[: len(BALL[0])][BALL[0][:, 2] < -0.1].any()
