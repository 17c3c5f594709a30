"""The command `bundle`, and bundles given to `fit`."""

import json

import numpy as np
import pytest
from PIL import Image

from dress_jax.capture import ClothesLabel
from dress_jax.cli.bundling import SourceName
from dress_jax.io.capture.bundles import load_bundle

SIZE = 64


@pytest.fixture
def photograph(tmp_path):
    """A picture with alpha, asymmetric."""
    rgba = np.zeros((SIZE, SIZE, 4), np.uint8)
    rgba[10:50, 5:30] = (200, 30, 60, 255)
    Image.fromarray(rgba).save(tmp_path / "photo.png")
    return tmp_path / "photo.png"


@pytest.fixture
def views(tmp_path):
    """A MagicMan folder of four views, in colours only."""
    for azimuth in (0, 90, 180, 270):
        rgb = np.full((SIZE, SIZE, 3), 255, np.uint8)
        rgb[6:58, 20:36] = 80
        (tmp_path / "ring" / "rgb").mkdir(parents=True, exist_ok=True)
        Image.fromarray(rgb).save(tmp_path / "ring" / "rgb" / f"{azimuth:03d}.png")
    return tmp_path / "ring"


def line(result):
    lines = [text for text in result.stderr.splitlines() if text.startswith("error: ")]
    assert len(lines) == 1 and "Traceback" not in result.output, result.output
    return lines[0]


def test_help_lists_every_format(run):
    result = run("bundle", "--help")
    assert result.exit_code == 0
    text = "".join(result.output.split())
    for source in SourceName:
        assert source.value in text
    from dress_jax.application.bundle import Source

    assert [s.value for s in Source] == [s.value for s in SourceName]


def test_parts_are_gathered_one_after_the_other(run, photograph, views, tmp_path):
    first = tmp_path / "one"
    result = run("bundle", photograph, "--source", "photograph", "--out", first)
    assert result.exit_code == 0, result.output
    assert "image" in result.output and "64x64" in result.output
    assert (first / "preview.png").is_file() and (first / "bundle.json").is_file()

    second = tmp_path / "two.h5"
    result = run(
        *("bundle", views, "--source", "magicman", "--height", 1.7),
        *("--onto", first, "--out", second),
    )
    assert result.exit_code == 0, result.output
    assert (tmp_path / "two-preview.png").is_file()

    maps = tmp_path / "maps"
    maps.mkdir()
    ids = np.zeros((SIZE, SIZE), np.uint8)
    ids[20:40, 20:36] = 7
    for azimuth in (0, 90, 180, 270):
        Image.fromarray(ids).save(maps / f"{azimuth:03d}.png")
    third = tmp_path / "three"
    result = run(
        *("bundle", maps, "--source", "labels", "--table", "atr"),
        *("--onto", second, "--out", third),
    )
    assert result.exit_code == 0, result.output
    bundle = load_bundle(third)
    assert bundle.present == ("image", "matte", "views")
    assert bundle.matte is not None and bundle.matte[20, 10] == 255 and bundle.matte[20, 50] == 0
    for view in bundle.views:
        assert list(view.parts) == [ClothesLabel.DRESS.name.lower()]
    assert bundle.sources["views"] == "MagicMan, label maps (atr)"


def test_a_bundle_changes_its_form(run, photograph, tmp_path):
    run("bundle", photograph, "--source", "photograph", "--out", tmp_path / "a")
    result = run("bundle", tmp_path / "a", "--source", "bundle", "--out", tmp_path / "b.h5")
    assert result.exit_code == 0, result.output
    np.testing.assert_array_equal(
        load_bundle(tmp_path / "b.h5").image, load_bundle(tmp_path / "a").image
    )


@pytest.mark.parametrize(
    ("source", "options", "parts"),
    [
        ("photograph", ("--height", 1.7), ("--height", "does not apply", "--matte")),
        ("labels", (), ("--table", "labels needs it")),
        ("labels", ("--table", "coco"), ("coco", "fashn")),
        ("openpose", (), ("photo.png", "not a UTF-8")),
        ("dwpose", (), ("photo.png", "not a valid npz")),
        ("magicman", (), ("photo.png", "holds no views")),
        ("pattern", (), ("photo.png", "not a UTF-8")),
        ("photograph", ("--draw-masks",), ("bundle", "has both")),
    ],
)
def test_bad_input_is_named(run, photograph, tmp_path, source, options, parts):
    result = run("bundle", photograph, "--source", source, *options, "--out", tmp_path / "out")
    assert result.exit_code == 2
    for part in parts:
        assert part in line(result)
    assert not (tmp_path / "out").exists()


def test_parts_are_replaced_on_purpose_only(run, photograph, tmp_path):
    out = tmp_path / "out.h5"
    run("bundle", photograph, "--source", "photograph", "--out", out)
    again = ("bundle", photograph, "--source", "photograph", "--onto", out, "--out", out)
    result = run(*again)
    assert result.exit_code == 2 and "image, matte already" in line(result)
    assert run(*again, "--replace").exit_code == 0


def test_label_maps_of_views_need_a_bundle(run, tmp_path):
    result = run(
        "bundle", tmp_path, "--source", "labels", "--table", "atr", "--out", tmp_path / "o"
    )
    assert result.exit_code == 2 and "--onto" in line(result)


def test_a_fit_says_what_its_bundle_lacks(run, inputs, views, tmp_path):
    out = tmp_path / "b.h5"
    run("bundle", views, "--source", "magicman", "--height", 1.7, "--out", out)
    result = run("fit", inputs / "skirt.json", "--targets", out, "--out", tmp_path / "fit")
    assert result.exit_code == 2
    assert "has no mask of the clothes" in line(result) and "b.h5" in line(result)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "bundle.json").write_text(json.dumps({"format": 1}))
    result = run("fit", inputs / "skirt.json", "--targets", tmp_path / "broken", "--out", out)
    assert result.exit_code == 2 and "make the bundle again" in line(result)
