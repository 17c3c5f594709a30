"""Views of MagicMan and PSHuman: known points fall on known pixels, mattes and normals follow."""

import jax.numpy as jnp
import numpy as np
import pytest
from capture_scenes import magicman_body, save, write

from dress_jax.capture.frames import generator_frame, view_azimuth
from dress_jax.core.errors import InputError
from dress_jax.io.capture.magicman import read_magicman
from dress_jax.io.capture.pshuman import read_pshuman
from dress_jax.render.cameras import project

SIZE = 64
COUNT = 20
TOP, BOTTOM = 4, 59  # first and last covered row
PIXELS = 1e-4  # projections run in single precision where that is the default
MARKER = np.array([0.4, 0.1, 0.15])  # at the left hand, in the generator's units


def magicman_pixel(point, azimuth):
    """Column and row by MagicMan's own formulas, for a picture of SIZE pixels."""
    a = np.radians(azimuth)
    right, up = np.array([np.cos(a), 0.0, -np.sin(a)]), np.array([0.0, 1.0, 0.0])
    return (1 + point @ right) * SIZE / 2 - 0.5, (1 - point @ up) * SIZE / 2 - 0.5


def person(column):
    """A column of a person in the middle, and a marker of 3x3 pixels."""
    covered = np.zeros((SIZE, SIZE), bool)
    covered[TOP : BOTTOM + 1, 28:36] = True
    row = round(magicman_pixel(MARKER, 0.0)[1])
    covered[row, min(28, column) : max(36, column)] = True  # the arm that joins them
    covered[row - 1 : row + 2, column - 1 : column + 2] = True
    return covered


def magicman_folder(folder, *, kinds=("rgb", "normal"), body=True):
    """A ring in which every view's marker is where the formulas put it."""
    for i in range(COUNT):
        azimuth = i * 18
        covered = person(round(magicman_pixel(MARKER, -azimuth)[0]))
        rgb = np.where(covered[..., None], np.uint8(90), np.uint8(255)).repeat(3, axis=2)
        normal = np.full((SIZE, SIZE, 3), 255, np.uint8)
        normal[covered] = (255, 127, 127)  # +x, in the world's frame
        normal[0, 0] = (127, 127, 255)  # a speck
        for kind, pixels in (("rgb", rgb), ("normal", normal)):
            if kind in kinds:
                save(folder / kind / f"{azimuth:03d}.png", pixels)
    save(folder / "ref_rgb.png", np.full((SIZE, SIZE, 3), 7, np.uint8))
    save(folder / "ref_mask.png", np.full((SIZE, SIZE), 255, np.uint8))
    if body:
        write(folder / "smplx_refined.json", magicman_body(np.zeros((53, 3))))
    return folder


def test_magicmans_views_see_known_points_at_known_pixels(tmp_path):
    bundle = read_magicman(magicman_folder(tmp_path))
    assert bundle.present == ("image", "matte", "body", "views")
    assert set(bundle.sources.values()) == {"MagicMan"}
    unit = 1.0 / 0.8  # the fitted body says how many units a metre has
    soles = -(1.0 - 2.0 * (BOTTOM + 1) / SIZE)
    world = unit * (MARKER + np.array([0.0, soles, 0.0]))
    for i, view in enumerate(bundle.views):
        assert view.name == f"{18 * i:03d}" and view_azimuth(view.camera) == 18 * i
        column, row, _ = (float(v[0]) for v in project(view.camera, jnp.asarray(world)[None]))
        assert (column, row) == pytest.approx(magicman_pixel(MARKER, -18.0 * i), abs=PIXELS)
        assert view.matte is not None and view.normal is not None
        np.testing.assert_array_equal(view.matte > 0, person(round(column)))  # without the speck
        inside = view.normal[view.matte > 0]
        np.testing.assert_allclose(inside, np.tile([1.0, 0, 0], (len(inside), 1)), atol=6e-3)
        assert not view.normal[view.matte == 0].any()


def test_the_second_view_stands_at_the_wearers_right(tmp_path):
    bundle = read_magicman(magicman_folder(tmp_path))
    views = {view.name: np.asarray(view.camera.rotation)[2] for view in bundle.views}
    np.testing.assert_allclose(views["090"], [-1.0, 0.0, 0.0], atol=1e-6)


def test_the_soles_are_at_zero_and_the_height_is_the_given_one(tmp_path):
    for height in (None, 1.7):
        folder = magicman_folder(tmp_path / str(height))
        bundle = read_magicman(folder, height=height)
        camera = bundle.views[0].camera
        extent = SIZE / float(camera.scale[0])  # [m]
        expected = 2.0 / 0.8 if height is None else 1.7 * SIZE / (BOTTOM + 1 - TOP)
        assert extent == pytest.approx(expected)
        _, row, _ = project(camera, jnp.zeros((1, 3)))
        assert float(row[0]) == pytest.approx(BOTTOM + 0.5, abs=PIXELS)
        assert bundle.body is not None
        # The fitted body is drawn to the same measure.
        assert bundle.body.scale == pytest.approx(0.8 * expected / 2.0)


def test_colours_alone_give_mattes_too(tmp_path):
    bundle = read_magicman(magicman_folder(tmp_path, kinds=("rgb",)))
    view = bundle.views[3]
    assert view.normal is None and view.matte is not None
    column = round(magicman_pixel(MARKER, -54.0)[0])
    np.testing.assert_array_equal(view.matte > 0, person(column))


def test_bad_folders_of_magicman_are_named(tmp_path):
    with pytest.raises(InputError, match="holds no views"):
        read_magicman(tmp_path)
    folder = magicman_folder(tmp_path / "a", body=False)
    with pytest.raises(InputError, match="nothing says how tall"):
        read_magicman(folder)
    with pytest.raises(InputError, match="is 170 m, which is no person's"):
        read_magicman(folder, height=170.0)
    (folder / "rgb" / "036.png").unlink()
    with pytest.raises(InputError, match="differ in view 036"):
        read_magicman(folder, height=1.7)
    (folder / "normal" / "036.png").unlink()
    with pytest.raises(InputError, match=r"19 views are named 000, 018 \.\.\., not 054"):
        read_magicman(folder, height=1.7)
    white = np.full((SIZE, SIZE, 3), 255, np.uint8)
    for name in ("rgb", "normal"):
        save(tmp_path / "b" / name / "000.png", white)
    with pytest.raises(InputError, match="view 000: shows nobody"):
        read_magicman(tmp_path / "b", height=1.7)
    save(tmp_path / "c" / "rgb" / "000.png", np.zeros((SIZE, 50, 3), np.uint8))
    with pytest.raises(InputError, match=r"is 50x64.*square"):
        read_magicman(tmp_path / "c", height=1.7)


def test_frames_need_a_person():
    with pytest.raises(InputError, match="covers no pixel"):
        generator_frame(np.zeros((8, 8), np.uint8), half_extent=1.0, height=1.7, unit=None)


PSHUMAN = {"front": 0, "front_right": 45, "right": 90, "back": 180, "left": 270, "front_left": 315}


def pshuman_folder(folder, *, mirrored=True):
    """Six views of half-extent 2 with the marker at twice the place; back and left mirrored."""
    for name, azimuth in PSHUMAN.items():
        covered = person(round(magicman_pixel(MARKER, float(azimuth))[0]))
        if mirrored and name in ("back", "left"):
            covered = covered[:, ::-1]
        alpha = 255 * covered[..., None].astype(np.uint8)
        color = np.full((SIZE, SIZE, 3), 40, np.uint8)
        normal = np.tile(np.array([127, 127, 255], np.uint8), (SIZE, SIZE, 1))
        for kind, pixels in (("color", color), ("normals", normal)):
            save(folder / f"{kind}_{name}_masked.png", np.concatenate([pixels, alpha], axis=2))
    return folder


@pytest.mark.parametrize("mirrored", [True, False])
def test_pshumans_views_see_known_points_at_known_pixels(tmp_path, mirrored):
    folder = pshuman_folder(tmp_path, mirrored=mirrored)
    bundle = read_pshuman(folder, height=1.6, mirrored=mirrored)
    unit = 1.6 / (4.0 * (BOTTOM + 1 - TOP) / SIZE)
    soles = 2.0 * (2.0 * (BOTTOM + 1) / SIZE - 1.0)
    world = unit * (2.0 * MARKER + [0.0, soles, 0.0])
    assert [view.name for view in bundle.views] == list(PSHUMAN)
    for view in bundle.views:
        column, row, _ = (float(v[0]) for v in project(view.camera, jnp.asarray(world)[None]))
        expected = magicman_pixel(MARKER, float(PSHUMAN[view.name]))
        assert (column, row) == pytest.approx(expected, abs=PIXELS), view.name
        assert view.matte is not None and view.normal is not None and view.rgb is not None
        np.testing.assert_array_equal(view.matte > 0, person(round(column)))
        assert view.normal[30, 30] == pytest.approx([0.0, 0.0, 1.0], abs=6e-3)
        assert (view.rgb[0, 0] == 255).all() and (view.rgb[30, 30] == 40).all()
    right = np.asarray(bundle.views[2].camera.rotation)[2]
    np.testing.assert_allclose(right, [1.0, 0.0, 0.0], atol=1e-6)


def test_the_mirror_of_pshuman_matters(tmp_path):
    """Read the wrong way round, back and left show the marker on the other side."""
    folder = pshuman_folder(tmp_path)
    good, bad = (read_pshuman(folder, height=1.6, mirrored=m).views for m in (True, False))
    for a, b in zip(good, bad, strict=True):
        assert a.matte is not None and b.matte is not None
        assert (a.matte == b.matte).all() == (a.name not in ("back", "left"))


def test_bad_folders_of_pshuman_are_named(tmp_path):
    folder = pshuman_folder(tmp_path)
    with pytest.raises(InputError, match="height: nothing says how tall"):
        read_pshuman(folder)
    (folder / "normals_back_masked.png").unlink()
    with pytest.raises(InputError, match=r"holds no normals_back_masked\.png"):
        read_pshuman(folder, height=1.7)
    save(folder / "normals_back_masked.png", np.zeros((SIZE, SIZE, 4), np.uint8))
    with pytest.raises(InputError, match="view back: shows nobody"):
        read_pshuman(folder, height=1.7)
    (folder / "color_front_masked.png").rename(folder / "color_front_face_masked.png")
    (folder / "normals_front_masked.png").rename(folder / "normals_front_face_masked.png")
    with pytest.raises(InputError, match="view back"):  # the other name of the front is known
        read_pshuman(folder, height=1.7)
