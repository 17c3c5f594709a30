"""A plain photograph to a bundle, in Python and on the command line."""

import numpy as np
import pytest
from mannequin import mannequin
from PIL import Image
from typer.testing import CliRunner

from dress_jax.application.photo import LANDMARK_SOURCE, MATTE_SOURCE, observe_photo
from dress_jax.capture import ClothesLabel
from dress_jax.cli.main import app
from dress_jax.core.errors import InputError
from dress_jax.io.capture.bundles import load_bundle
from dress_jax.io.capture.photographs import read_photograph


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def cut_out(tmp_path_factory):
    """The mannequin with alpha."""
    image, mask, _, _ = mannequin()
    path = tmp_path_factory.mktemp("photo") / "person.png"
    alpha = 255 * mask.astype(np.uint8)
    Image.fromarray(np.dstack([image, alpha])).save(path)
    return path


def test_alpha_is_the_matte(cut_out, tmp_path):
    out = tmp_path / "person.h5"
    result = run("bundle", cut_out, "--source", "photo", "--out", out)
    assert result.exit_code == 0, result.output
    bundle = load_bundle(out)
    assert bundle.present == ("image", "matte", "labels", "landmarks")
    assert bundle.sources["matte"] == "photograph"
    assert bundle.sources["landmarks"] == LANDMARK_SOURCE
    assert bundle.labels is not None and (bundle.labels == ClothesLabel.TOP).mean() > 0.03
    assert "top and bottom" in bundle.sources["labels"] and "top" in result.output
    assert (tmp_path / "person-preview.png").is_file()


@pytest.mark.slow
def test_a_picture_without_alpha_gets_a_matte(tmp_path):
    image, _, truth, _ = mannequin()
    Image.fromarray(image).save(tmp_path / "person.jpg", quality=95)
    bundle, report = observe_photo(tmp_path / "person.jpg")
    assert bundle.sources["matte"] == MATTE_SOURCE and report.presence > 0.9
    assert bundle.labels is not None
    for kind in (ClothesLabel.TOP, ClothesLabel.BOTTOM):
        found, wanted = bundle.labels == kind, truth == kind
        assert (found & wanted).sum() / (found | wanted).sum() > 0.85


@pytest.mark.slow
def test_nobody_is_said_so(tmp_path):
    wall = np.full((200, 200, 3), 180, np.uint8)
    Image.fromarray(wall).save(tmp_path / "wall.png")
    with pytest.raises(InputError, match=r"wall\.png, image: shows no"):
        observe_photo(tmp_path / "wall.png")


def test_bad_files_are_named(tmp_path):
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 not a picture")
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(tmp_path / "tiny.png")
    for name, message in (
        ("broken.jpg", "cannot be read as a picture"),
        ("tiny.png", "30x20"),
        ("absent.png", "there is no such picture"),
    ):
        result = run("bundle", tmp_path / name, "--source", "photo", "--out", tmp_path / "out")
        assert result.exit_code == 2
        assert name in result.stderr and message in " ".join(result.stderr.split())
        assert not (tmp_path / "out").exists()


def test_photographs_stand_as_the_camera_was_held(tmp_path):
    pixels = np.zeros((8, 16, 3), np.uint8)
    pixels[:, 12:] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees clockwise
    Image.fromarray(pixels).save(tmp_path / "held.png", exif=exif)
    image = read_photograph(tmp_path / "held.png").image
    assert image is not None and image.shape == (16, 8, 3)
    assert image[14, 4, 0] == 255 and image[2, 4, 0] == 0
