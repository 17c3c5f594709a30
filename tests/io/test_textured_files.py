"""S14.4, S14.5: textured garments as OBJ and GLB, read back by other code and by hand."""

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from dress_jax.core.errors import InputError
from dress_jax.io.meshes import GarmentMesh
from dress_jax.io.obj import read_obj
from dress_jax.io.textured import write_textured_glb, write_textured_obj
from dress_jax.texture.textured import Texture

REPEAT, CLAMP = 10497, 33071
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
DTYPES = {5126: "<f4", 5125: "<u4"}
BODY = (
    np.array([[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, -2.0]]),
    np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
)


def garment():
    """Two square panels, sewn at x = 1 and folded there; they meet in vertices 1 and 2."""
    return GarmentMesh(
        vertices=np.array(
            [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 1], [1, 1, 1]], np.float64
        ),
        faces=np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]),
        rest_positions=np.array(
            [[0, 0], [1, 0], [1, 1], [0, 1], [5, 0], [6, 0], [6, 1], [5, 1]], np.float64
        ),
        rest_faces=np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]),
        panels=("front", "side"),
        face_panels=np.array([0, 0, 1, 1]),
    )


def texture(*, repeat):
    made = garment()
    rng = np.random.default_rng(0)
    scale = 0.3 if repeat else 8.0
    return Texture(
        images=(rng.random((6, 8, 3)), rng.random((4, 4, 3)))
        if repeat
        else (rng.random((8, 8, 3)),),
        names=("tile-a", "tile-b") if repeat else ("atlas",),
        coordinates=made.rest_positions / scale,
        panel_images=np.array([0, 1]) if repeat else np.array([0, 0]),
        repeat=repeat,
    )


def opened(path):
    """The JSON and the binary chunk of a GLB, taken apart by the specification."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON" and size % 4 == 0
    document = json.loads(content[20 : 20 + size])
    binary_size, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert kind == b"BIN\0" and binary_size % 4 == 0
    binary = content[28 + size :]
    assert len(binary) == binary_size
    assert 0 <= binary_size - document["buffers"][0]["byteLength"] < 4
    return document, binary


def array(document, binary, index):
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype = np.dtype(DTYPES[accessor["componentType"]])
    width = COMPONENTS[accessor["type"]]
    assert view["byteOffset"] % 4 == 0
    assert view["byteLength"] == accessor["count"] * width * dtype.itemsize
    assert view["byteOffset"] + view["byteLength"] <= len(binary)
    values = np.frombuffer(binary, dtype, accessor["count"] * width, view["byteOffset"])
    values = values.reshape(accessor["count"], width)
    if "min" in accessor:
        np.testing.assert_array_equal(values.min(axis=0), np.asarray(accessor["min"], dtype))
        np.testing.assert_array_equal(values.max(axis=0), np.asarray(accessor["max"], dtype))
    return values


@pytest.mark.parametrize("repeat", [True, False])
def test_the_glb_is_well_formed(tmp_path, repeat):
    made, cloth = garment(), texture(repeat=repeat)
    write_textured_glb(tmp_path / "a.glb", made, cloth, body=BODY)
    document, binary = opened(tmp_path / "a.glb")
    assert document["asset"]["version"] == "2.0"
    assert [s["wrapS"] for s in document["samplers"]] == [REPEAT if repeat else CLAMP]
    assert [s["wrapT"] for s in document["samplers"]] == [REPEAT if repeat else CLAMP]
    for image, true in zip(document["images"], cloth.images, strict=True):
        view = document["bufferViews"][image["bufferView"]]
        assert "target" not in view
        stored = binary[view["byteOffset"] :][: view["byteLength"]]
        pixels = np.asarray(Image.open(io.BytesIO(stored)))
        np.testing.assert_array_equal(pixels, np.round(255 * true).astype(np.uint8))
    names = [node["name"] for node in document["nodes"]]
    assert [names[k] for k in document["scenes"][0]["nodes"]] == ["garment", "body"]
    parent = document["nodes"][names.index("garment")]
    assert [names[k] for k in parent["children"]] == ["front", "side"]
    for number, panel in enumerate(made.panels):
        mesh = document["meshes"][document["nodes"][names.index(panel)]["mesh"]]
        (primitive,) = mesh["primitives"]
        keys = primitive["attributes"]
        assert set(keys) == {"POSITION", "NORMAL", "TEXCOORD_0"}
        assert "min" in document["accessors"][keys["POSITION"]]
        corners = array(document, binary, primitive["indices"]).ravel()
        points = array(document, binary, keys["POSITION"])[corners]
        place = array(document, binary, keys["TEXCOORD_0"])[corners]
        normal = array(document, binary, keys["NORMAL"])
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-6)
        own = made.face_panels == number
        np.testing.assert_allclose(points, made.vertices[made.faces[own].ravel()])
        true = cloth.coordinates[made.rest_faces[own].ravel()]
        np.testing.assert_allclose(place, np.stack([true[:, 0], 1 - true[:, 1]], 1), atol=1e-6)
        material = document["materials"][primitive["material"]]
        assert material["doubleSided"]
        source = material["pbrMetallicRoughness"]["baseColorTexture"]["index"]
        image = document["textures"][source]["source"]
        assert document["images"][image]["name"] == cloth.names[cloth.panel_images[number]]
    body = document["meshes"][document["nodes"][names.index("body")]["mesh"]]["primitives"][0]
    assert "TEXCOORD_0" not in body["attributes"]


@pytest.mark.parametrize("repeat", [True, False])
def test_trimesh_reads_the_glb(tmp_path, repeat):
    made, cloth = garment(), texture(repeat=repeat)
    write_textured_glb(tmp_path / "a.glb", made, cloth, body=BODY)
    scene = trimesh.load_scene(tmp_path / "a.glb")
    assert set(scene.geometry) == {"front", "side", "body"}
    for number, panel in enumerate(made.panels):
        mesh = scene.geometry[panel]
        used = np.unique(made.rest_faces[made.face_panels == number])
        assert len(mesh.vertices) == len(used)
        # trimesh counts rows from the bottom, as OBJ does.
        np.testing.assert_allclose(mesh.visual.uv, cloth.coordinates[used], atol=1e-6)
        picture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
        true = cloth.images[cloth.panel_images[number]]
        np.testing.assert_array_equal(picture, np.round(255 * true).astype(np.uint8))


@pytest.mark.parametrize("repeat", [True, False])
def test_the_obj_reads_back(tmp_path, repeat):
    made, cloth = garment(), texture(repeat=repeat)
    files = write_textured_obj(tmp_path, made, cloth)
    assert all(path.is_file() for path in files)
    contents = read_obj(tmp_path / "textured.obj")
    np.testing.assert_array_equal(contents.vertices, made.vertices)
    np.testing.assert_array_equal(contents.texture, cloth.coordinates)
    np.testing.assert_array_equal(contents.texture_faces, made.rest_faces)
    np.testing.assert_array_equal(contents.faces, made.faces)
    assert contents.groups == made.panels
    materials = (tmp_path / "textured.mtl").read_text()
    assert materials.count("newmtl") == len(cloth.images)
    assert "-clamp" not in materials  # readers take it for a part of the name
    scene = trimesh.load_scene(tmp_path / "textured.obj")
    for mesh in scene.geometry.values():
        assert mesh.visual.uv is not None
        number = cloth.names.index(mesh.visual.material.name)
        picture = np.asarray(mesh.visual.material.image.convert("RGB"))
        np.testing.assert_array_equal(
            picture, np.round(255 * cloth.images[number]).astype(np.uint8)
        )


def test_a_texture_of_another_garment_is_refused(tmp_path):
    cloth = texture(repeat=True)
    other = Texture(cloth.images, cloth.names, cloth.coordinates[:-1], cloth.panel_images, True)
    with pytest.raises(ValueError, match="texture coordinates"):
        write_textured_obj(tmp_path, garment(), other)
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot be written"):
        write_textured_glb(tmp_path / "file" / "a.glb", garment(), texture(repeat=True))
