"""Bundles as files: exact round trips, complete or absent, and what damage says."""

import dataclasses
import json

import h5py
import jax
import numpy as np
import pytest
from capture_scenes import full_bundle, labels

from dress_jax.capture import Bundle
from dress_jax.core.errors import InputError
from dress_jax.io.capture import bundles
from dress_jax.io.capture.bundles import is_bundle, load_bundle, save_bundle
from dress_jax.io.capture.preview import contact_sheet

PATTERN_ROUNDING = 1e-14  # [m]: a pattern is written in centimetres and degrees


def flattened(value, name=""):
    """Every leaf of a bundle by its place, except the pattern."""
    if dataclasses.is_dataclass(value):
        names = [f.name for f in dataclasses.fields(value) if f.name != "pattern"]
        return {k: v for n in names for k, v in flattened(getattr(value, n), f"{name}.{n}").items()}
    if isinstance(value, dict):
        return {k: v for n, i in value.items() for k, v in flattened(i, f"{name}.{n}").items()}
    if isinstance(value, tuple):
        return {k: v for n, i in enumerate(value) for k, v in flattened(i, f"{name}{n}").items()}
    if isinstance(value, (np.ndarray, jax.Array)):
        return {name: np.asarray(value)}
    return {name: value}


@pytest.mark.parametrize("name", ["bundle.h5", "folder", "name.with.dots"])
def test_bundles_round_trip_exactly(tmp_path, name):
    bundle = full_bundle()
    save_bundle(tmp_path / name, bundle)
    again = load_bundle(tmp_path / name)
    before, after = flattened(bundle), flattened(again)
    assert list(after) == list(before) and len(before) > 50
    for place, value in before.items():
        if isinstance(value, np.ndarray):
            assert after[place].dtype == value.dtype, place
            np.testing.assert_array_equal(after[place], value, err_msg=place)
        else:
            assert after[place] == value, place
    assert bundle.pattern is not None and again.pattern is not None
    [old], [new] = bundle.pattern.panels, again.pattern.panels
    for field in ("vertices", "rotation", "translation"):
        np.testing.assert_allclose(
            getattr(new, field), getattr(old, field), rtol=0, atol=PATTERN_ROUNDING
        )


@pytest.mark.parametrize("name", ["bundle.hdf5", "folder"])
def test_a_bundle_of_one_part_round_trips(tmp_path, name):
    save_bundle(tmp_path / name, Bundle(labels=labels()))
    again = load_bundle(tmp_path / name)
    assert again.present == ("labels",) and is_bundle(tmp_path / name)
    np.testing.assert_array_equal(again.labels, labels())


@pytest.mark.parametrize("name", ["bundle.h5", "folder"])
def test_a_failed_write_leaves_no_half_bundle(tmp_path, monkeypatch, name):
    save_bundle(tmp_path / name, Bundle(labels=labels()))

    def fail(*_, **__):
        raise RuntimeError

    monkeypatch.setattr(bundles.np, "savez_compressed", fail)
    monkeypatch.setattr(h5py.Group, "create_dataset", fail)
    with pytest.raises(RuntimeError):
        save_bundle(tmp_path / name, full_bundle())
    if name == "bundle.h5":
        assert load_bundle(tmp_path / name).present == ("labels",)
        assert [path.name for path in tmp_path.iterdir()] == [name]
    else:
        with pytest.raises(InputError, match=r"holds no bundle\.json"):
            load_bundle(tmp_path / name)


def test_a_folder_written_again_holds_the_new_bundle_only(tmp_path):
    save_bundle(tmp_path / "b", full_bundle())
    save_bundle(tmp_path / "b", Bundle(labels=labels()))
    assert load_bundle(tmp_path / "b").present == ("labels",)


def test_damage_is_named(tmp_path):
    with pytest.raises(InputError, match="no such bundle"):
        load_bundle(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("text")
    with pytest.raises(InputError, match=r"text\.h5: is no observation bundle"):
        load_bundle(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = 1
    with pytest.raises(InputError, match=r"other\.h5: is no observation bundle"):
        load_bundle(tmp_path / "other.h5")

    folder = tmp_path / "folder"
    save_bundle(folder, full_bundle())
    document = json.loads((folder / "bundle.json").read_text())
    for changed, message in [
        ({**document, "format": 99}, "is not of format 1"),
        ({**document, "pictures": None}, "does not list"),
        ({**document, "arrays": ["views/018/depth"]}, r"arrays\.npz: .*lacks an array"),
        ({k: v for k, v in document.items() if k != "sources"}, "lacks something.*sources"),
        ({**document, "body": {**document["body"], "family": "doll"}}, "family: is 'doll'"),
    ]:
        (folder / "bundle.json").write_text(json.dumps(changed))
        with pytest.raises(InputError, match=message):
            load_bundle(folder)
    (folder / "bundle.json").write_text(json.dumps(document))
    (folder / "views" / "018" / "mask.png").unlink()
    with pytest.raises(InputError, match=r"mask\.png: there is no such picture"):
        load_bundle(folder)


def test_arrays_of_a_folder_are_not_pickled(tmp_path):
    save_bundle(tmp_path / "b", full_bundle())
    with np.load(tmp_path / "b" / "arrays.npz", allow_pickle=False) as stored:
        assert all(stored[name].dtype.kind in "fiu" for name in stored.files)


def test_the_contact_sheet_shows_every_picture():
    bundle = full_bundle()
    sheet = contact_sheet(bundle)
    assert sheet.dtype == np.uint8 and sheet.ndim == 3
    fewer = contact_sheet(dataclasses.replace(bundle, views=(), sources={}))
    assert fewer.shape[0] < sheet.shape[0] and fewer.shape[1] == sheet.shape[1]
    red = (sheet == (220, 20, 60)).all(axis=-1)  # landmarks
    assert red.any()
    assert (contact_sheet(Bundle(body=bundle.body)) < 255).any()  # named, though no picture
