"""Files of moving meshes: GLB with morph targets, PC2, MDD, films (S15.1)."""

import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from dress_jax.core.errors import InputError
from dress_jax.io.animated import write_animated_glb
from dress_jax.io.meshes import GarmentMesh
from dress_jax.io.point_caches import read_mdd, read_pc2, write_mdd, write_pc2
from dress_jax.io.video import video_suffix, write_video

FRAMES, FPS = 5, 25.0


def garment() -> GarmentMesh:
    """Two panels of one triangle each, sewn along an edge."""
    return GarmentMesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float),
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        rest_positions=np.array([[0, 0], [1, 0], [1, 1], [3, 0], [4, 1], [3, 1]], float),
        rest_faces=np.array([[0, 1, 2], [3, 4, 5]]),
        panels=("front", "back"),
        face_panels=np.array([0, 1]),
    )


def moving(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return garment().vertices + 0.2 * rng.normal(size=(FRAMES, 4, 3))


def body() -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(subdivisions=1)
    shift = np.linspace(0.0, 0.5, FRAMES)[:, None, None] * np.array([0.0, 0.0, 1.0])
    return np.asarray(ball.vertices) + shift, np.asarray(ball.faces)


class Glb:
    """A GLB file taken apart by its specification, apart from the code that writes it."""

    def __init__(self, path):
        content = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", content)
        assert (magic, version, length) == (b"glTF", 2, len(content))
        size, kind = struct.unpack_from("<I4s", content, 12)
        assert kind == b"JSON" and size % 4 == 0
        self.json = json.loads(content[20 : 20 + size])
        binary, kind = struct.unpack_from("<I4s", content, 20 + size)
        assert kind == b"BIN\0" and binary % 4 == 0
        self.binary = content[28 + size : 28 + size + binary]
        assert self.json["buffers"] == [{"byteLength": self.json["buffers"][0]["byteLength"]}]
        assert 0 <= binary - self.json["buffers"][0]["byteLength"] < 4

    def read(self, number: int) -> np.ndarray:
        accessor = self.json["accessors"][number]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == 4 * width * accessor["count"]
        assert view["byteOffset"] + view["byteLength"] <= len(self.binary)
        rows = np.frombuffer(
            self.binary, kind, width * accessor["count"], view["byteOffset"]
        ).reshape(-1, width)
        for key, bound in (("min", rows.min(axis=0)), ("max", rows.max(axis=0))):
            if key in accessor:
                np.testing.assert_array_equal(np.float32(accessor[key]), np.float32(bound))
        return rows

    def shape_at(self, node: int, time: float) -> list[np.ndarray]:
        """Vertices of the primitives of a node at a time, as a player computes them."""
        mesh = self.json["meshes"][self.json["nodes"][node]["mesh"]]
        animation = self.json["animations"][0]
        channel = next(c for c in animation["channels"] if c["target"]["node"] == node)
        assert channel["target"]["path"] == "weights"
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler["interpolation"] == "LINEAR"
        times = self.read(sampler["input"]).ravel()
        count = len(mesh["weights"])
        weights = self.read(sampler["output"]).reshape(len(times), count)
        now = np.array([np.interp(time, times, column) for column in weights.T])
        shapes = []
        for primitive in mesh["primitives"]:
            assert len(primitive["targets"]) == count
            x = self.read(primitive["attributes"]["POSITION"]).astype(float)
            for weight, target in zip(now, primitive["targets"], strict=True):
                accessor = self.json["accessors"][target["POSITION"]]
                assert {"min", "max"} <= set(accessor)
                x = x + weight * self.read(target["POSITION"])
            shapes.append(x)
        return shapes


@pytest.fixture(scope="module")
def glb(tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    write_animated_glb(path, garment(), moving(), fps=FPS, body=body())
    return path


@pytest.mark.parametrize("frame", [0, 1, 2.5, FRAMES - 1])
def test_a_player_shows_every_frame(glb, frame):
    """Also between two frames, where vertices move along straight lines."""
    file, frames, (shapes, _) = Glb(glb), moving(), body()
    low, part = int(frame), frame - int(frame)
    mixed = [x[low] + part * (x[min(low + 1, FRAMES - 1)] - x[low]) for x in (frames, shapes)]
    front, back = file.shape_at(0, frame / FPS)
    np.testing.assert_allclose(front, mixed[0][[0, 1, 2]], atol=1e-6)
    np.testing.assert_allclose(back, mixed[0][[0, 2, 3]], atol=1e-6)
    (ball,) = file.shape_at(1, frame / FPS)
    np.testing.assert_allclose(ball, mixed[1], atol=1e-6)


def test_every_number_of_a_glb_refers_to_something(glb):
    file = Glb(glb)
    document = file.json
    assert document["asset"]["version"] == "2.0"
    times = file.read(document["animations"][0]["samplers"][0]["input"]).ravel()
    np.testing.assert_allclose(times, np.arange(FRAMES) / FPS, atol=1e-7)
    for mesh in document["meshes"]:
        assert len(mesh["extras"]["targetNames"]) == len(mesh["weights"]) == FRAMES - 1
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            count = document["accessors"][attributes["POSITION"]]["count"]
            for number in [*attributes.values()] + [
                n for target in primitive["targets"] for n in target.values()
            ]:
                assert document["accessors"][number]["count"] == count
                file.read(number)
            assert file.read(primitive["indices"]).max() < count
            assert primitive["material"] < len(document["materials"])
    normals = file.read(document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)


def test_trimesh_loads_the_first_frame(glb):
    scene = trimesh.load(glb)
    assert len(scene.geometry) == 3
    vertices = np.concatenate([mesh.vertices for mesh in scene.geometry.values()])
    assert len(vertices) == 6 + len(body()[0][0])
    low = np.minimum(moving()[0].min(axis=0), body()[0][0].min(axis=0))
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=1e-6)


def test_one_frame_is_a_mesh_without_animation(tmp_path):
    write_animated_glb(tmp_path / "a.glb", garment(), moving()[:1], fps=FPS)
    document = Glb(tmp_path / "a.glb").json
    assert "animations" not in document
    assert "targets" not in document["meshes"][0]["primitives"][0]


def test_frames_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(ValueError, match="for 4 vertices"):
        write_animated_glb(tmp_path / "a.glb", garment(), moving()[:, :3], fps=FPS)
    with pytest.raises(ValueError, match="of the body"):
        shapes, faces = body()
        write_animated_glb(
            tmp_path / "a.glb", garment(), moving(), fps=FPS, body=(shapes[:2], faces)
        )
    assert not list(tmp_path.iterdir())


def test_point_caches_read_back(tmp_path):
    frames = moving()
    write_pc2(tmp_path / "a.pc2", frames)
    write_mdd(tmp_path / "a.mdd", frames, fps=FPS)
    for cache, times in (
        (read_pc2(tmp_path / "a.pc2"), np.arange(FRAMES)),
        (read_mdd(tmp_path / "a.mdd"), np.arange(FRAMES) / FPS),
    ):
        np.testing.assert_array_equal(cache.frames, frames.astype(np.float32))
        np.testing.assert_allclose(cache.times, times, atol=1e-7)


def test_point_caches_have_the_bytes_of_their_formats(tmp_path):
    write_pc2(tmp_path / "a.pc2", np.ones((2, 3, 3)))
    write_mdd(tmp_path / "a.mdd", np.ones((2, 3, 3)), fps=10.0)
    content = (tmp_path / "a.pc2").read_bytes()
    assert content[:32] == b"POINTCACHE2\0" + struct.pack("<iiffi", 1, 3, 0.0, 1.0, 2)
    assert content[32:36] == struct.pack("<f", 1.0) and len(content) == 32 + 72
    content = (tmp_path / "a.mdd").read_bytes()
    assert content[:16] == struct.pack(">iiff", 2, 3, 0.0, np.float32(0.1))
    assert content[16:20] == struct.pack(">f", 1.0) and len(content) == 16 + 72


@pytest.mark.parametrize("kind", ["pc2", "mdd"])
def test_damaged_caches_are_refused(tmp_path, kind):
    write, read = ((write_pc2, read_pc2), (write_mdd, read_mdd))[kind == "mdd"]
    path = tmp_path / f"a.{kind}"
    write(path, moving(), **({"fps": FPS} if kind == "mdd" else {}))
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(InputError, match="bytes of positions"):
        read(path)
    path.write_bytes(b"no")
    with pytest.raises(InputError, match=r"is no .* cache"):
        read(path)
    with pytest.raises(InputError, match="check the path"):
        read(tmp_path / "none")


def film() -> list[np.ndarray]:
    """A bright square that moves to the right."""
    pictures = np.full((FRAMES, 64, 96, 3), 40, np.uint8)
    for k, picture in enumerate(pictures):
        picture[20:40, 8 + 12 * k : 28 + 12 * k] = (250, 250, 250)
    return list(pictures)


def test_an_animated_png_holds_all_pictures(tmp_path):
    write_video(tmp_path / "a.png", film(), fps=FPS)
    with Image.open(tmp_path / "a.png") as image:
        assert image.n_frames == FRAMES
        for number, picture in enumerate(film()):
            image.seek(number)
            assert image.info["duration"] == pytest.approx(40.0)
            np.testing.assert_array_equal(np.asarray(image.convert("RGB")), picture)


def test_an_mp4_plays_all_pictures(tmp_path):
    av = pytest.importorskip("av", reason="films in MP4 need the extra 'video'")
    assert video_suffix() == ".mp4"
    write_video(tmp_path / "a.mp4", iter(film()), fps=FPS)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert float(stream.average_rate) == pytest.approx(FPS)
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(shown) == FRAMES
    for found, picture in zip(shown, film(), strict=True):
        assert np.abs(found.astype(int) - picture).mean() < 4.0


@pytest.mark.parametrize("name", ["a.gif", "a.png"])
def test_no_film_without_pictures_or_a_known_ending(tmp_path, name):
    with pytest.raises(ValueError):
        write_video(tmp_path / name, [], fps=FPS)
    assert not list(tmp_path.iterdir())
