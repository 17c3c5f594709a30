"""Meshes, checkpoints, trajectories, pictures: round trips and refusals."""

import dataclasses

import h5py
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree
from dress_jax.io.checkpoints import load_checkpoint, save_checkpoint
from dress_jax.io.images import (
    Targets,
    load_targets,
    read_mask,
    read_normals,
    read_rgb,
    save_targets,
    write_mask,
    write_normals,
    write_rgb,
)
from dress_jax.io.meshes import (
    GarmentMesh,
    read_garment_obj,
    vertex_normals,
    write_body_obj,
    write_garment_obj,
    write_glb,
)
from dress_jax.io.obj import read_obj
from dress_jax.io.trajectory import read_trajectory, write_trajectory

# Eight bits: half a step.
EIGHT_BIT = 0.5 / 255.0 + 1e-6


@pytree
class State:
    positions: jnp.ndarray
    inner: dict


def two_panels():
    """Two squares that share an edge after welding."""
    rng = np.random.default_rng(0)
    return GarmentMesh(
        vertices=rng.normal(size=(6, 3)),
        faces=np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]),
        rest_positions=rng.normal(size=(8, 2)),
        rest_faces=np.array([[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6]]),
        panels=("front left", "back"),
        face_panels=np.array([0, 0, 1, 1]),
    )


@pytest.mark.parametrize("normals", [True, False])
def test_garments_round_trip_exactly(tmp_path, normals):
    garment = two_panels()
    write_garment_obj(tmp_path / "g.obj", garment, normals=normals)
    again = read_garment_obj(tmp_path / "g.obj")
    for field in dataclasses.fields(GarmentMesh):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(garment, field.name))


def test_a_mesh_without_texture_is_no_garment(tmp_path):
    write_body_obj(tmp_path / "b.obj", np.eye(3), np.array([[0, 1, 2]]))
    contents = read_obj(tmp_path / "b.obj")
    np.testing.assert_array_equal(contents.vertices, np.eye(3))
    np.testing.assert_array_equal(contents.faces, [[0, 1, 2]])
    with pytest.raises(InputError, match=r"b\.obj: is no garment"):
        read_garment_obj(tmp_path / "b.obj")


def test_negative_obj_indices_count_backwards(tmp_path):
    (tmp_path / "n.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n")
    np.testing.assert_array_equal(read_obj(tmp_path / "n.obj").faces, [[0, 1, 2]])
    (tmp_path / "n.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -2 -1\n")
    with pytest.raises(InputError, match="line 4"):
        read_obj(tmp_path / "n.obj")


def test_broken_garments_are_refused_before_anything_is_written(tmp_path):
    garment = two_panels()
    for change in [
        {"face_panels": np.array([0, 0, 1])},
        {"face_panels": np.array([0, 0, 1, 2])},
        {"panels": ("a\nf 1 1 1", "b")},
    ]:
        with pytest.raises(ValueError, match=r"panel|group"):
            write_garment_obj(tmp_path / "g.obj", dataclasses.replace(garment, **change))
    assert not (tmp_path / "g.obj").exists()


def test_a_glb_holds_panels_colours_and_texture(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    garment = two_panels()
    body = trimesh.creation.icosphere(subdivisions=1)
    write_glb(tmp_path / "a.glb", garments=[garment], body=(body.vertices, body.faces))
    scene = trimesh.load(tmp_path / "a.glb", force="scene")
    assert set(scene.geometry) == {"garment/front left", "garment/back", "body"}
    panel = scene.geometry["garment/back"]
    np.testing.assert_allclose(
        panel.vertices[panel.faces], garment.vertices[garment.faces[2:]], atol=1e-6
    )
    np.testing.assert_allclose(
        panel.visual.uv[panel.faces], garment.rest_positions[garment.rest_faces[2:]], atol=1e-6
    )
    colours = {name: tuple(g.visual.material.baseColorFactor) for name, g in scene.geometry.items()}
    assert len(set(colours.values())) == 3
    with pytest.raises(ValueError, match="neither"):
        write_glb(tmp_path / "b.glb")


def test_vertex_normals_of_a_sphere_are_radial():
    trimesh = pytest.importorskip("trimesh")
    sphere = trimesh.creation.icosphere(subdivisions=3)
    normals = vertex_normals(np.asarray(sphere.vertices), np.asarray(sphere.faces))
    assert (np.sum(normals * sphere.vertices, axis=1) > 0.999).all()
    lonely = vertex_normals(np.zeros((4, 3)), np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(lonely, [[0.0, 1.0, 0.0]] * 4)


def state():
    rng = np.random.default_rng(1)
    special = np.array([np.nan, -0.0, np.inf, 5e-324, 1.0 / 3.0])
    return State(
        positions=jnp.array(rng.normal(size=(5, 3))),
        inner={
            "special": special,
            "half": jnp.arange(3, dtype=jnp.float32),
            "step": 7,
            "none": None,
        },
    )


def test_checkpoints_round_trip_bit_for_bit(tmp_path):
    tree = state()
    save_checkpoint(tmp_path / "c.h5", tree, metadata={"iteration": np.int64(3), "name": "é"})
    again, metadata = load_checkpoint(tmp_path / "c.h5", state())
    assert metadata == {"iteration": 3, "name": "é"}
    assert np.asarray(again.positions).tobytes() == np.asarray(tree.positions).tobytes()
    assert again.inner["special"].tobytes() == tree.inner["special"].tobytes()
    assert again.inner["half"].dtype == jnp.float32
    assert again.inner["step"] == 7
    assert type(again.inner["step"]) is int


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": jnp.zeros((6, 3))}, r"\.positions.*shape \(5, 3\), expected.*\(6, 3\)"),
        ({"positions": jnp.zeros((5, 3), jnp.float32)}, "float64.*expected float32"),
        ({"inner": {"special": np.zeros(5)}}, "not expected.*half"),
        ({"inner": {**state().inner, "extra": 1.0}}, "missing.*extra"),
    ],
)
def test_checkpoints_of_another_structure_are_refused(tmp_path, change, message):
    save_checkpoint(tmp_path / "c.h5", state())
    with pytest.raises(InputError, match=message):
        load_checkpoint(tmp_path / "c.h5", dataclasses.replace(state(), **change))


def test_checkpoints_that_are_missing_damaged_or_newer_are_refused(tmp_path):
    path = tmp_path / "c.h5"
    with pytest.raises(InputError, match="no such checkpoint"):
        load_checkpoint(path, state())
    path.write_text("text")
    with pytest.raises(InputError, match="not a checkpoint"):
        load_checkpoint(path, state())
    save_checkpoint(path, state())
    with h5py.File(path, "a") as file:
        file.attrs["format"] = 99
    with pytest.raises(InputError, match="format 99"):
        load_checkpoint(path, state())


def test_a_failed_checkpoint_leaves_the_old_one(tmp_path, monkeypatch):
    save_checkpoint(tmp_path / "c.h5", state(), metadata={"iteration": 1})
    with pytest.raises(ValueError, match="not numbers"):
        save_checkpoint(tmp_path / "c.h5", {"a": np.array(["text"])})

    def broken(*args, **kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(h5py.Group, "create_dataset", broken)
    with pytest.raises(OSError, match="disk full"):
        save_checkpoint(tmp_path / "c.h5", state(), metadata={"iteration": 2})
    assert load_checkpoint(tmp_path / "c.h5", state())[1] == {"iteration": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["c.h5"]


def test_trajectories_round_trip(tmp_path):
    rng = np.random.default_rng(2)
    frames = rng.normal(size=(3, 4, 3))
    with write_trajectory(tmp_path / "t.h5", {"cloth": np.array([[0, 1, 2]])}) as append:
        for k, frame in enumerate(frames):
            append(0.1 * k, {"cloth": frame})
        with pytest.raises(ValueError, match="needs"):
            append(0.3, {"body": frames[0]})
        with pytest.raises(ValueError, match="changed"):
            append(0.3, {"cloth": frames[0, :2]})
    times, objects = read_trajectory(tmp_path / "t.h5")
    np.testing.assert_array_equal(times, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(objects["cloth"][0], frames)
    np.testing.assert_array_equal(objects["cloth"][1], [[0, 1, 2]])
    with pytest.raises(InputError, match="not a trajectory"):
        read_trajectory(tmp_path / "none.h5")


def test_pictures_round_trip_to_eight_bits(tmp_path):
    rng = np.random.default_rng(3)
    rgb, mask = rng.random((4, 6, 3)), rng.random((4, 6))
    normals = rng.normal(size=(4, 6, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[0, 0] = 0.0
    write_rgb(tmp_path / "rgb.png", rgb)
    write_mask(tmp_path / "mask.png", mask)
    write_normals(tmp_path / "normal.png", normals)
    np.testing.assert_allclose(read_rgb(tmp_path / "rgb.png"), rgb, atol=EIGHT_BIT)
    np.testing.assert_allclose(read_mask(tmp_path / "mask.png"), mask, atol=EIGHT_BIT)
    again = read_normals(tmp_path / "normal.png")
    np.testing.assert_allclose(again[0, 0], 1.0)  # white background
    np.testing.assert_allclose(again[1:], normals[1:], atol=2.0 * EIGHT_BIT)


def test_transparent_pixels_lie_over_white_and_alpha_is_the_mask(tmp_path):
    pixels = np.zeros((1, 2, 4), dtype=np.uint8)
    pixels[0, 0] = (255, 0, 0, 255)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_rgb(tmp_path / "a.png"), [[[1, 0, 0], [1, 1, 1]]])
    np.testing.assert_allclose(read_mask(tmp_path / "a.png"), [[1, 0]])


def test_pixels_out_of_range_are_refused(tmp_path):
    for bad in (np.full((2, 2), 1.1), np.full((2, 2), -0.1), np.full((2, 2), np.nan), np.zeros(4)):
        with pytest.raises(ValueError, match=r"pixels|shape"):
            write_mask(tmp_path / "m.png", bad)
    with pytest.raises(InputError, match="no such picture"):
        read_rgb(tmp_path / "m.png")
    (tmp_path / "m.png").write_text("text")
    with pytest.raises(InputError, match="cannot be read as a picture"):
        read_mask(tmp_path / "m.png")


def targets():
    rng = np.random.default_rng(4)
    return Targets(
        azimuths=(0, 90, 270),
        cameras=({"kind": "orthographic", "scale": 256.0}, {}, {"rotation": np.eye(3)}),
        rgb=rng.random((3, 4, 5, 3)),
        mask=rng.random((3, 4, 5)),
    )


def test_target_folders_round_trip(tmp_path):
    save_targets(tmp_path / "views", targets())
    assert (tmp_path / "views" / "rgb" / "090.png").is_file()
    again = load_targets(tmp_path / "views")
    assert again.azimuths == (0, 90, 270)
    assert again.cameras[0] == {"kind": "orthographic", "scale": 256.0}
    assert again.cameras[2]["rotation"] == np.eye(3).tolist()
    assert again.normal is None
    np.testing.assert_allclose(again.rgb, targets().rgb, atol=EIGHT_BIT)
    np.testing.assert_allclose(again.mask, targets().mask, atol=EIGHT_BIT)


def test_incomplete_target_folders_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"cameras\.json"):
        load_targets(tmp_path)
    save_targets(tmp_path, targets())
    (tmp_path / "mask" / "090.png").unlink()
    with pytest.raises(InputError, match=r"090\.png"):
        load_targets(tmp_path)
    write_mask(tmp_path / "mask" / "090.png", np.zeros((2, 2)))
    with pytest.raises(InputError, match="2x2, the first view is 5x4"):
        load_targets(tmp_path)
    (tmp_path / "cameras.json").write_text('{"views": [{"azimuth": 1.5}]}')
    with pytest.raises(InputError, match="'views' must be"):
        load_targets(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"azimuths": (0, 0, 1)}, "distinct"), ({"azimuths": (0, 1, 360)}, "0..359"),
     ({"rgb": np.zeros((2, 4, 4, 3))}, "2 rgb for 3")],
)  # fmt: skip
def test_inconsistent_targets_are_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        save_targets(tmp_path, dataclasses.replace(targets(), **change))
