"""The outline of a mask as crossings of pixel lines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from render_scenes import SIZE, front_camera, nothing, padded_mesh, slopes, sphere

from dress_jax.core.pytree import replace
from dress_jax.geometry.rotations import rotation_matrix
from dress_jax.render.cameras import perspective_camera, stack_cameras
from dress_jax.render.contours import find_contours


def _find(camera, garment, occluder):
    """The contour of one view."""
    contours = find_contours(stack_cameras([camera]), garment, occluder)
    return jax.tree.map(lambda leaf: leaf[0], contours)


def perspective():
    return perspective_camera(
        rotation=np.eye(3), position=np.array([0.0, 0.0, 3.0]), focal=140.0, height=SIZE
    )


CENTER = np.array([0.0313, 0.0171])
"""[m]; off the middle, so that no line of pixels meets a vertex."""

CAMERAS = {"orthographic": front_camera, "perspective": perspective}


@pytest.fixture(scope="module")
def ball():
    """Turned, so that no face is seen edge-on."""
    vertices, faces = sphere()
    turned = vertices @ rotation_matrix(np.array([0.3, 0.5, 0.2])).T
    return padded_mesh(turned + np.array([*CENTER, 0.0]), faces)


@pytest.mark.parametrize("kind", CAMERAS)
def test_crossings_lie_on_the_outline(ball, kind):
    """A sphere's outline is a circle; edges of the mesh cut a little off it."""
    contour = _find(CAMERAS[kind](), ball, nothing())
    used = np.asarray(contour.used)
    column, row = (
        np.where(np.asarray(contour.vertical), a, b)[used] - (SIZE - 1) / 2
        for a, b in (
            (contour.line, contour.along),
            (contour.along, contour.line),
        )
    )
    radius = 0.6 * SIZE / 2 if kind == "orthographic" else 140.0 * 0.6 / np.sqrt(3.0**2 - 0.6**2)
    scale = SIZE / 2 if kind == "orthographic" else 140.0 * 3.0 / (3.0**2 - 0.6**2)
    distance = np.hypot(column - scale * CENTER[0], row + scale * CENTER[1])
    assert distance.max() <= 1.001 * radius
    assert distance.min() >= 0.98 * radius
    # Once per row on either side where it is steep, once per column where it is not.
    assert used.sum() == pytest.approx(4 * np.sqrt(2.0) * radius, rel=0.05)
    assert int(contour.unfinished) == 0


def test_crossings_lie_between_the_centres_that_they_part(ball):
    contour = _find(front_camera(), ball, nothing())
    used = np.asarray(contour.used)
    line, before, vertical, along = (
        np.asarray(a)[used] for a in (contour.line, contour.before, contour.vertical, contour.along)
    )
    assert np.all((along >= before - 1e-3) & (along <= before + 1 + 1e-3))
    inside = np.asarray(contour.face) >= 0
    rows, columns = np.where(vertical, before, line), np.where(vertical, line, before)
    here = inside[rows, columns]
    there = inside[rows + vertical, columns + ~vertical]
    assert np.all(here != there)


@pytest.mark.parametrize("kind", CAMERAS)
def test_slopes_against_differences(ball, kind):
    camera = CAMERAS[kind]()
    contour = _find(camera, ball, nothing())
    direction = np.sin(np.arange(ball.positions.size)).reshape(ball.positions.shape)
    size = 1e-7

    def found(t):
        """Crossings by place and edge: the order in which they are found is not theirs."""
        at = _find(camera, replace(ball, positions=ball.positions + t * direction), nothing())
        used = np.asarray(at.used)
        fields = (at.vertical, at.line, at.before, at.vertices, at.along, at.slope)
        rows = zip(*(np.asarray(field)[used] for field in fields), strict=True)
        return {(*map(int, row[:3]), *map(int, row[3])): row[4:] for row in rows}

    here, ahead, behind = found(0.0), found(size), found(-size)
    same = here.keys() & ahead.keys() & behind.keys()
    assert len(same) >= 0.9 * np.asarray(contour.used).sum()
    keys = sorted(same)
    measured = np.array([(ahead[k][0] - behind[k][0]) / (2 * size) for k in keys])
    exact = np.array([np.sum(here[k][1] * direction[list(k[3:])]) for k in keys])
    assert np.abs(exact).max() > 10.0
    np.testing.assert_allclose(measured, exact, rtol=1e-5, atol=1e-5 * np.abs(exact).max())


def test_slopes_add_up_to_the_derivative_of_the_area(ball):
    """Against the derivative of the antialiased mask, made by other code."""
    camera = front_camera()
    contour = _find(camera, ball, nothing())
    used = np.asarray(contour.used)
    before, line, vertical = (
        np.asarray(a)[used] for a in (contour.before, contour.line, contour.vertical)
    )
    inside = np.asarray(contour.face) >= 0
    grows = inside[np.where(vertical, before, line), np.where(vertical, line, before)]
    sign = np.where(grows, 1.0, -1.0)
    area = np.zeros(ball.positions.shape)
    np.add.at(
        area,
        np.asarray(contour.vertices)[used],
        sign[:, None, None] * np.asarray(contour.slope)[used],
    )
    _, by_position, _, _ = slopes(camera, ball, nothing(), mask=1.0)
    by_position = np.asarray(by_position)
    error = np.abs(area - by_position).max()
    assert np.abs(by_position).max() > 1.0
    assert error <= 1e-3 * np.abs(by_position).max()


def test_an_occluders_outline_does_not_move_with_the_garment(ball):
    vertices, faces = sphere(0.3, (0.35, 0.0, 0.8))
    contour = _find(front_camera(), ball, padded_mesh(vertices, faces))
    used = np.asarray(contour.used)
    moves = np.abs(np.asarray(contour.slope)[used]).max(axis=(1, 2)) > 0.0
    column = np.where(contour.vertical, contour.line, contour.along)[used] - (SIZE - 1) / 2
    row = np.where(contour.vertical, contour.along, contour.line)[used] - (SIZE - 1) / 2
    hidden = np.hypot(column - 0.35 * SIZE / 2, row) < 0.3 * SIZE / 2 + 0.01
    assert np.array_equal(moves, ~hidden)
    assert 0 < moves.sum() < len(moves)


def test_garment_out_of_sight_has_no_outline(ball):
    aside = replace(ball, positions=ball.positions + jnp.array([[5.0, 0.0, 0.0]]))
    contour = _find(front_camera(), aside, nothing())
    assert not np.any(contour.used) and not np.any(np.asarray(contour.face) >= 0)
