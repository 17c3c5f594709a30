"""Label tables and label maps."""

import numpy as np
import pytest
from capture_scenes import SIZE, camera, save
from PIL import Image

from dress_jax.capture import Bundle, ClothesLabel, View
from dress_jax.capture.labels import CLOTHES, LABEL_COLORS, TABLES, convert_labels
from dress_jax.core.errors import InputError
from dress_jax.io.capture.label_maps import label_views, read_label_map, read_labels

SAME_GARMENT = 0.9  # IoU of the upper clothes in two maps of one photograph


@pytest.mark.parametrize(
    ("table", "ids"),
    [
        ("atr", {4: "TOP", 5: "BOTTOM", 6: "BOTTOM", 7: "DRESS", 2: "HAIR", 9: "SHOE", 11: "SKIN"}),
        ("lip", {5: "TOP", 7: "TOP", 12: "BOTTOM", 6: "DRESS", 10: "DRESS", 2: "HAIR", 19: "SHOE"}),
        ("fashn", {3: "TOP", 4: "DRESS", 5: "BOTTOM", 16: "SKIN", 1: "SKIN", 17: "OTHER"}),
        ("sapiens", {22: "TOP", 12: "BOTTOM", 8: "SHOE", 17: "SHOE", 21: "SKIN", 18: "OTHER"}),
        ("close", {0: "OTHER", 1: "SKIN", 6: "DRESS", 9: "BOTTOM", 12: "HAIR", 17: "TOP"}),
        ("4d-dress", {0: "SKIN", 1: "HAIR", 2: "SHOE", 3: "TOP", 4: "BOTTOM", 5: "TOP"}),
    ],
)
def test_ids_of_every_table(table, ids):
    found = convert_labels(np.array([list(ids)]), table)
    assert found.dtype == np.uint8 and found.shape == (1, len(ids))
    assert [ClothesLabel(int(i)).name for i in found[0]] == list(ids.values())


def test_tables_have_the_published_number_of_ids():
    sizes = {name: len(table) for name, table in TABLES.items()}
    assert sizes == {
        "own": 8,
        "atr": 18,
        "lip": 20,
        "fashn": 18,
        "sapiens": 28,
        "close": 18,
        "4d-dress": 6,
    }
    assert len(LABEL_COLORS) == len(ClothesLabel)


@pytest.mark.parametrize(
    ("ids", "table", "message"),
    [
        ([0, 18, 255], "atr", "'atr': does not know id 18, 255.*0 to 17"),
        ([-1], "4d-dress", "does not know id -1"),
        ([0.5], "atr", "not whole numbers"),
        ([0], "coco", "no label table 'coco'.*fashn"),
    ],
)
def test_unknown_ids_and_tables_are_named(ids, table, message):
    with pytest.raises(InputError, match=message):
        convert_labels(np.array(ids), table)


def _ids():
    ids = np.zeros((SIZE, SIZE), np.uint8)
    ids[5:9, 2:7] = 7
    ids[0, -1] = 2
    return ids


def test_maps_are_read_from_palettes_grey_pictures_and_arrays(tmp_path):
    palette = Image.fromarray(_ids(), "P")
    palette.putpalette(list(np.random.default_rng(0).integers(0, 256, 768)))
    palette.save(tmp_path / "p.png")
    save(tmp_path / "l.png", _ids())
    np.save(tmp_path / "a.npy", _ids().astype(np.int64))
    for name in ("p.png", "l.png", "a.npy"):
        found = read_labels(tmp_path / name, "atr")
        np.testing.assert_array_equal(found, convert_labels(_ids(), "atr"))
        assert found[6, 3] == ClothesLabel.DRESS and found[0, -1] == ClothesLabel.HAIR


def test_bad_maps_are_named(tmp_path):
    save(tmp_path / "rgb.png", np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(InputError, match=r"rgb\.png: holds RGB colours instead of ids"):
        read_labels(tmp_path / "rgb.png", "atr")
    save(tmp_path / "odd.png", np.full((4, 4), 23, np.uint8))
    with pytest.raises(InputError, match=r"odd\.png.*does not know id 23"):
        read_label_map(tmp_path / "odd.png", "atr")
    np.save(tmp_path / "s.npy", np.zeros((4, 4, 18)))
    with pytest.raises(InputError, match=r"s\.npy: is float64"):
        read_labels(tmp_path / "s.npy", "atr")


def test_every_view_gets_its_own_map(tmp_path):
    bundle = Bundle(views=(View("000", camera()), View("180", camera(180.0))))
    save(tmp_path / "000.png", _ids())
    with pytest.raises(InputError, match="no label map of view '180'"):
        label_views(bundle, tmp_path, "atr")
    np.save(tmp_path / "180.npy", _ids()[:, ::-1].astype(int))
    views = label_views(bundle, tmp_path, "atr").views
    for view, column in zip(views, (3, SIZE - 4), strict=True):
        assert view.mask is not None and view.mask[6, column] == 255
        assert view.mask.sum() == 255 * 20
    with pytest.raises(InputError, match="there are no views"):
        label_views(Bundle(matte=_ids()), tmp_path, "atr")


def test_two_maps_of_one_photograph_agree(shared_data):
    """ATR and LIP number the same things differently."""
    files = {table: shared_data / "labels" / f"demo_{table}.png" for table in ("atr", "lip")}
    if not all(file.is_file() for file in files.values()):
        pytest.skip("no label maps in the trial data")
    masks = [np.isin(read_labels(file, table), CLOTHES) for table, file in files.items()]
    assert (masks[0] & masks[1]).sum() > SAME_GARMENT * (masks[0] | masks[1]).sum() > 0
