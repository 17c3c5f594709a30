"""`dress-jax texture`: a checked tube from its pictures, tiled and baked (S14)."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "texture"))
import texture_scenes as scenes

from dress_jax.application.tile_sources import read_tile
from dress_jax.io.images import Targets, save_targets, write_rgb
from dress_jax.io.meshes import GarmentMesh
from dress_jax.io.obj import read_obj
from dress_jax.io.results import DrapedState, write_state
from dress_jax.render.cameras import cameras_to_dict
from dress_jax.texture.atlas import pack_panels
from dress_jax.texture.textured import atlas_texture, draw_textured

VIEWS = 2
PERIOD_TOLERANCE = 0.03


@pytest.fixture(scope="module")
def pictured(tmp_path_factory):
    """A result folder of a tube, and a target folder with two pictures of it in checks."""
    folder = tmp_path_factory.mktemp("texture")
    vertices, faces, rest, rest_faces, panels, face_panels = scenes.tube_arrays()
    body = scenes.body()
    none = np.zeros((0, 2), np.int64)
    write_state(
        folder / "result" / "drape.h5",
        DrapedState(
            garment=GarmentMesh(vertices, faces, rest, rest_faces, panels, face_panels),
            weld_map=np.zeros(len(rest), np.int64),
            seam_vertices=none,
            seam_offset=np.zeros(1, np.int64),
            pins=np.zeros(0, np.int64),
            pin_targets=np.zeros((0, 3)),
            body_vertices=body[0],
            body_faces=body[1],
        ),
    )
    tube = scenes.tube()
    atlas = pack_panels(tube, scenes.TEXEL)
    cloth = scenes.checks((atlas.height, atlas.width), scenes.TEXEL, scenes.PERIOD)
    texture = atlas_texture(cloth, atlas, tube)
    cameras = scenes.cameras(VIEWS)
    drawn = [draw_textured(c, tube, texture, body, supersampling=2, lit=False) for c in cameras]
    targets = Targets(
        azimuths=tuple(360 * k // VIEWS for k in range(VIEWS)),
        cameras=tuple(cameras_to_dict(cameras)["cameras"]),
        rgb=np.stack([picture for picture, _ in drawn]),
        mask=np.stack([mask for _, mask in drawn]),
    )
    save_targets(folder / "targets", targets)
    return folder


def textured(run, pictured, out, *options):
    """Run the command; its result."""
    return run(
        *("texture", pictured / "result", "--targets", pictured / "targets", "--out", out),
        *options,
    )


def report_of(folder):
    return json.loads((folder / "report.json").read_text())


def error_line(result):
    assert result.exit_code == 2, result.output
    lines = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, result.output
    return lines[0]


def test_a_tile_keeps_the_cloths_period(run, pictured, tmp_path):
    """S14.1, S14.2, S14.4: the period in metres, repeated over texture coordinates in the pattern's
    space, to be read back from the files."""
    result = textured(run, pictured, tmp_path)
    assert result.exit_code == 0, result.output
    report = report_of(tmp_path)
    tile = report["garments"]["garment"]["tile"]
    for found, true in zip(tile["periods"], scenes.PERIOD, strict=True):
        assert abs(found / true - 1.0) < PERIOD_TOLERANCE
    assert max(tile["wrap_jump"]) <= 1.0
    contents = read_obj(tmp_path / "textured.obj")
    rest = scenes.tube_arrays()[2]
    spread = np.ptp(contents.texture, axis=0) * [tile["width"], tile["height"]]
    np.testing.assert_allclose(spread, np.ptp(rest, axis=0), rtol=1e-9)
    scene = trimesh.load_scene(tmp_path / "textured.glb")
    assert set(scene.geometry) == {"front", "back", "body"}
    for name in ("cut-garment.png", "textured-tile-garment.png", "comparison.png"):
        assert (tmp_path / name).is_file()
    with Image.open(tmp_path / "preview.png") as picture:
        assert picture.size == (1024, 512)


def test_a_baked_texture_shows_what_the_views_show(run, pictured, tmp_path):
    result = textured(run, pictured, tmp_path, "--mode", "bake", "--texel-mm", 4)
    assert result.exit_code == 0, result.output
    report = report_of(tmp_path)
    assert report["atlas"]["texel_size"] == pytest.approx(0.004)
    for name in ("front", "back"):
        share = report["panels"][name]
        assert share["seen"] > 0.7
        assert sum(share.values()) == pytest.approx(1.0)
    assert max(report["error"].values()) < 0.06
    place = read_obj(tmp_path / "textured.obj").texture
    assert place.min() > 0.0 and place.max() < 1.0


def test_a_tile_from_a_file_has_the_given_width(tmp_path):
    write_rgb(tmp_path / "tile.png", np.full((10, 20, 3), 0.5))
    assert read_tile(tmp_path / "tile.png", 0.08).size == pytest.approx((0.08, 0.04))


def tool(folder, text):
    """A program of the user's."""
    path = folder / "tool.py"
    path.write_text(text)
    return f"'{sys.executable}' '{path}' {{crop}} {{tile}}"


def test_a_tile_from_a_command(run, pictured, tmp_path):
    command = tool(tmp_path, "import shutil, sys; shutil.copy(sys.argv[1], sys.argv[2])")
    result = textured(run, pictured, tmp_path / "out", "--tile-command", command)
    assert result.exit_code == 0, result.output
    own = report_of(tmp_path / "out")["garments"]["garment"]
    # Unless told otherwise, the tile shows as much cloth as the piece it was made of.
    assert own["tile"]["width"] == pytest.approx(own["square"]["cut_side"])


@pytest.mark.parametrize(
    ("program", "parts"),
    [
        ("import sys; sys.exit('no weights')", ("exit code 1", "no weights", "by hand")),
        ("pass", ("wrote no file", "{tile}")),
        ("import sys; open(sys.argv[2], 'w').write('text')", ("cannot be read as a picture",)),
    ],
)
def test_a_command_that_fails_is_one_line(run, pictured, tmp_path, program, parts):
    result = textured(run, pictured, tmp_path / "out", "--tile-command", tool(tmp_path, program))
    line = error_line(result)
    for part in parts:
        assert part in line
    assert not (tmp_path / "out" / "report.json").exists()


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--tile-command", "no-such-tool {crop} {tile}"), ("no-such-tool", "cannot be run")),
        (("--tile-command", "tool {crop}"), ("lacks {tile}", "{crop}")),
        (("--tile-command", "tool '{crop} {tile}"), ("quotation marks",)),
        (("--tile", "cloth.png"), ("cloth.png", "--tile-size-cm")),
        (("--tile", "cloth.png", "--tile-size-cm", 5), ("cloth.png", "no such picture")),
        (("--tile", "a.png", "--tile-command", "b"), ("give one",)),
        (("--tile-size-cm", 5), ("tile size", "measured")),
        (("--mode", "bake", "--texel-mm", -1), ("texel size", "positive")),
        (("--mode", "bake", "--texel-mm", 0.01), ("too large", "texels larger")),
        (("--view", 45), ("no view 45", "views are 0, 180")),
    ],
)
def test_bad_options_are_named_with_their_mend(run, pictured, tmp_path, options, parts):
    line = error_line(textured(run, pictured, tmp_path, *options))
    for part in parts:
        assert part in line


def test_targets_without_pictures_are_refused(run, pictured, tmp_path):
    (tmp_path / "targets").mkdir()
    cameras = (pictured / "targets" / "cameras.json").read_text()
    (tmp_path / "targets" / "cameras.json").write_text(cameras)
    result = run(
        *("texture", pictured / "result", "--targets", tmp_path / "targets"),
        *("--out", tmp_path / "out"),
    )
    assert "rgb/ and mask/" in error_line(result)
