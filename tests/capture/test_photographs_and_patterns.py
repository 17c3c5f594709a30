"""Photographs with mattes, and initial patterns in four dialects."""

import numpy as np
import pytest
from capture_scenes import SQUARE, save, write
from PIL import Image

from dress_jax.core.errors import InputError
from dress_jax.io.capture.photographs import read_photograph
from dress_jax.io.capture.pictures import read_coverage
from dress_jax.io.capture.specifications import read_specification
from dress_jax.pattern.model import EdgeKind

CURVED = 12.5  # [cm]


def test_alpha_is_the_matte_and_transparency_white(tmp_path):
    rgba = np.zeros((5, 7, 4), np.uint8)
    rgba[1, 2] = (10, 20, 30, 255)
    rgba[3, 6] = (100, 0, 0, 51)
    bundle = read_photograph(save(tmp_path / "a.png", rgba))
    assert bundle.image is not None and bundle.matte is not None
    assert bundle.sources == {"image": "photograph", "matte": "photograph"}
    np.testing.assert_array_equal(bundle.matte, rgba[..., 3])
    assert (bundle.image[0, 0] == 255).all() and (bundle.image[1, 2] == (10, 20, 30)).all()
    assert (bundle.image[3, 6] == (224, 204, 204)).all()  # a fifth of it over white


def test_a_second_picture_is_the_matte(tmp_path):
    photo = save(tmp_path / "a.png", np.full((5, 7, 3), 9, np.uint8))
    assert read_photograph(photo).present == ("image",)
    matte = save(tmp_path / "m.png", np.arange(35, dtype=np.uint8).reshape(5, 7))
    found = read_photograph(photo, matte=matte).matte
    np.testing.assert_array_equal(found, np.arange(35).reshape(5, 7))
    with pytest.raises(InputError, match="matte: is 5x7, the image is 7x5"):
        read_photograph(photo, matte=save(tmp_path / "n.png", np.zeros((7, 5), np.uint8)))


def test_a_photograph_taken_on_the_side_is_turned_upright(tmp_path):
    pixels = np.zeros((4, 6, 3), np.uint8)
    pixels[0, 0] = 200
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera's top is at the picture's right
    Image.fromarray(pixels).save(tmp_path / "side.png", exif=exif)
    image = read_photograph(tmp_path / "side.png").image
    assert image is not None and image.shape == (6, 4, 3) and (image[0, 3] == 200).all()


def test_deep_pictures_are_refused(tmp_path):
    Image.fromarray(np.full((4, 4), 40000, np.uint16)).save(tmp_path / "deep.png")
    for read in (read_photograph, read_coverage):
        with pytest.raises(InputError, match=r"deep\.png: has more than 8 bits"):
            read(tmp_path / "deep.png")
    with pytest.raises(InputError, match="no such picture"):
        read_photograph(tmp_path / "none.png")


def test_real_photographs_bring_their_mattes(shared_data):
    files = sorted((shared_data / "photos").glob("*.png"))
    if not files:
        pytest.skip("no photographs in the trial data")
    for file in files:
        bundle = read_photograph(file)
        assert bundle.matte is not None
        assert 0.05 < (bundle.matte > 127).mean() < 0.95


def curved(curvature):
    """The square with one curved edge, as a tool writes it."""
    panel = SQUARE["pattern"]["panels"]["front"]
    edges = [{**edge} for edge in panel["edges"]]
    edges[2]["curvature"] = curvature
    return {
        **SQUARE,
        "pattern": {"panels": {"front": {**panel, "edges": edges}}, "stitches": []},
    }


@pytest.mark.parametrize(
    ("tool", "curvature", "kind"),
    [
        ("SewFormer", [0.4, 0.1], EdgeKind.QUADRATIC),
        ("NeuralTailor", [0.5, -0.1], EdgeKind.QUADRATIC),
        ("AIpparel", {"type": "cubic", "params": [[0.3, 0.1], [0.7, 0.1]]}, EdgeKind.CUBIC),
        ("GarmentCode", {"type": "circle", "params": [CURVED, 0, 1]}, EdgeKind.ARC),
    ],
)
def test_four_dialects_become_the_initial_pattern(tmp_path, tool, curvature, kind):
    write(tmp_path / "x_predicted_specification.json", curved(curvature))
    bundle = read_specification(tmp_path, tool=tool)
    assert bundle.pattern is not None and bundle.sources == {"pattern": tool}
    [panel] = bundle.pattern.panels
    assert panel.edges[2].kind is kind
    np.testing.assert_allclose(panel.vertices[1], [0.203, 0.0])


def test_folders_without_one_pattern_are_named(tmp_path):
    with pytest.raises(InputError, match="holds 0 files"):
        read_specification(tmp_path)
    for name in "ab":
        write(tmp_path / f"{name}_specification.json", SQUARE)
    with pytest.raises(InputError, match=r"holds 2 files \*specification\.json"):
        read_specification(tmp_path)
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        read_specification(tmp_path / "none.json")


def test_real_patterns_are_read(shared_data):
    """Two of each tool, raw predictions of a network among them."""
    folder = shared_data / "patterns"
    for place in ("garmentcode", "neuraltailor/templates", "predicted"):
        files = sorted((folder / place).rglob("*.json"))[:2]
        if not files:
            pytest.skip(f"no patterns in {place}")
        for file in files:
            assert read_specification(file).present == ("pattern",)
