"""SewFactory, 4D-Dress and CloSe: synthetic frames, and the real SewFactory scene."""

import dataclasses
import pickle

import jax.numpy as jnp
import numpy as np
import pytest
from capture_scenes import SQUARE, save, write
from PIL import Image, ImageDraw
from scipy import ndimage
from scipy.spatial.transform import Rotation

from dress_jax.capture import BodyFamily, ClothesLabel
from dress_jax.capture.body import world_vertices
from dress_jax.capture.frames import about_y, opencv_camera, view_azimuth
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import load_default_body
from dress_jax.io.capture.close_scans import eight_bit, read_close
from dress_jax.io.capture.four_d_dress import read_four_d_dress
from dress_jax.io.capture.pickles import read_pickle
from dress_jax.io.capture.sewfactory import read_sewfactory
from dress_jax.render.cameras import project

PIXELS = 1e-3
EXACT = 1e-9
INSIDE = 0.985  # of the garment's silhouette lies on the person: polygons gain half a pixel
COVERED = 0.5  # IoU of two bodies of different shape in one pose
SAME = 0.95  # IoU of the drawn garment and the dress by its colour, where nothing hides it


# --- SewFactory ---------------------------------------------------------------------------------

POINT = np.array([[20.0, 110.0, -7.0]])  # [cm]


def sewfactory_pixel(camera, points):
    """Column and row by SewFactory's formula, with the picture's corner at the origin."""
    p = (points - camera["cam_T"]) @ np.array(camera["cam_R"])
    (f, _, cx), (_, _, cy), _ = camera["cam_K"]
    return cx + f * p[:, 0] / -p[:, 2], cy - f * p[:, 1] / -p[:, 2]


def sewfactory_camera(azimuth):
    """A camera 3 m away that stands `azimuth` degrees from +z towards +x."""
    a = np.radians(azimuth)
    toward = np.array([np.sin(a), 0.0, np.cos(a)])
    rotation = np.array([[np.cos(a), 0.0, -np.sin(a)], [0.0, 1.0, 0.0], toward]).T
    return {
        "cam_T": (300.0 * toward + [1.0, 60.0, -2.0]).tolist(),
        "cam_K": [[90.0, 0.0, 32.0], [0.0, 90.0, 30.0], [0.0, 0.0, 1.0]],
        "cam_R": rotation.tolist(),
    }


def sewfactory_scene(folder, *, kinds=("one_piece",)):
    rng = np.random.default_rng(3)
    pixels = np.full((60, 64, 3), 255, np.uint8)
    pixels[10:50, 20:40] = 30
    views = {"front": 90.0, "right": 0.0, "30_0": 30.0}
    for place, pose in (("static", "static"), ("renders", "0000")):
        for name, azimuth in views.items():
            write(folder / place / f"{pose}_{name}cam_pos.json", sewfactory_camera(azimuth))
            save(folder / place / f"{pose}_{name}.png", pixels)
    garment = "v 0 100 10\nv 30 100 10\nv 0 140 10\nf 1 2 3\n"
    write(folder / "static" / "dress_specification.json", SQUARE)
    still = {"shape": [0.1] * 10, "pose": [[0.0] * 3] * 52, "trans": [1.0, 70.0, 3.0]}
    moved = {**still, "pose": (90 * rng.normal(size=(52, 3))).tolist(), "trans": [2.0, 75.0, 8.0]}
    write(folder / "static" / "static__body_info.json", still)
    write(folder / "poses" / "0000__body_info.json", moved)
    write(
        folder / "static" / "spec_config.json",
        {kind: {"spec": "x", "delta": [1.5, 91.0, 0.5]} for kind in kinds},
    )
    (folder / "static" / "dress.obj").write_text(garment)
    (folder / "objects").mkdir()
    (folder / "objects" / "dress_0.obj").write_text(garment)
    return folder


@pytest.mark.parametrize("pose", ["static", "0000"])
def test_sewfactorys_points_fall_on_its_pixels(tmp_path, pose):
    bundle = read_sewfactory(sewfactory_scene(tmp_path), pose=pose)
    assert bundle.present == ("body", "scan", "views", "pattern")
    turn = np.eye(3) if pose == "static" else about_y(-0.5 * np.pi)
    azimuths = {"front": 90.0, "right": 0.0, "30_0": 30.0}
    for view in bundle.views:
        column, row = sewfactory_pixel(sewfactory_camera(azimuths[view.name]), POINT)
        u, v, _ = project(view.camera, jnp.asarray(0.01 * POINT @ turn.T))
        # Our pixel centres lie at whole numbers, its picture's corner does.
        assert float(u[0]) == pytest.approx(column[0] - 0.5, abs=PIXELS)
        assert float(v[0]) == pytest.approx(row[0] - 0.5, abs=PIXELS)
        assert view.matte is not None and view.matte.sum() == 255 * 800
    front = {view.name: view_azimuth(view.camera) for view in bundle.views}["front"]
    assert front == (270 if pose == "static" else 0)  # the animated person faces its front camera
    assert bundle.scan is not None and bundle.scan.labels is not None
    np.testing.assert_allclose(bundle.scan.vertices[1], turn @ [0.3, 1.0, 0.1], atol=EXACT)
    assert set(bundle.scan.labels) == {ClothesLabel.DRESS}


def test_sewfactorys_pelvis_is_where_the_scene_has_it(tmp_path):
    bundle = read_sewfactory(sewfactory_scene(tmp_path), pose="0000")
    body = bundle.body
    assert body is not None and body.family is BodyFamily.SMPLH
    rest = np.array([1.0, 70.0, 3.0]) - [1.5, 91.0, 0.5]  # the pelvis in the model's frame [cm]
    pelvis = body.to_world @ (0.01 * rest + body.transl)
    np.testing.assert_allclose(pelvis, about_y(-0.5 * np.pi) @ [0.02, 0.75, 0.08], atol=EXACT)
    angles = np.radians(
        np.array(np.random.default_rng(3).normal(size=(52, 3)) * 90)[4]
    )  # of the left knee: x first, then y, then z
    x, y, z = (Rotation.from_rotvec(a * axis) for a, axis in zip(angles, np.eye(3), strict=True))
    found = Rotation.from_rotvec(body.body_pose[3])
    assert ((z * y * x).inv() * found).magnitude() < EXACT


def test_bad_scenes_of_sewfactory_are_named(tmp_path):
    with pytest.raises(InputError, match="holds no static/"):
        read_sewfactory(tmp_path)
    folder = sewfactory_scene(tmp_path / "a")
    with pytest.raises(InputError, match=r"has no pose '0050'.*its poses are 0000"):
        read_sewfactory(folder, pose="0050")
    camera = folder / "renders" / "0000_frontcam_pos.json"
    write(camera, {**sewfactory_camera(0.0), "cam_R": np.ones((3, 3)).tolist()})
    with pytest.raises(InputError, match=r"0000_frontcam_pos\.json.*no.* orthonormal"):
        read_sewfactory(folder, pose="0000")
    write(camera, {"cam_K": [], "cam_R": []})
    with pytest.raises(InputError, match=r"0000_frontcam_pos\.json: holds no 'cam_T'"):
        read_sewfactory(folder, pose="0000")
    (folder / "renders" / "0000_front.png").unlink()
    with pytest.raises(InputError, match=r"0000_front\.png: there is no such picture"):
        read_sewfactory(folder, pose="0000")
    two = read_sewfactory(sewfactory_scene(tmp_path / "b", kinds=("top", "bottom")))
    assert two.scan is not None and two.scan.labels is None


@pytest.fixture(scope="module")
def real_scene(shared_data):
    scenes = sorted((shared_data / "sewfactory").glob("*/data_props.json"))
    if not scenes:
        pytest.skip("no SewFactory scene in the trial data")
    return scenes[0].parent


def silhouette(camera, vertices, faces):
    columns, rows, _ = (np.asarray(a) for a in project(camera, jnp.asarray(vertices)))
    drawn = Image.new("1", (camera.width, camera.height))
    pen = ImageDraw.Draw(drawn)
    for face in faces:
        pen.polygon([(columns[k], rows[k]) for k in face], fill=1)
    return np.array(drawn)


@pytest.mark.parametrize(("pose", "name"), [("0000", "back"), ("static", "left")])
def test_the_true_garment_of_sewfactory_projects_onto_its_pixels(real_scene, pose, name):
    """In two views in which no arm hides the dress, which is bluer than skin and hair."""
    bundle = read_sewfactory(real_scene, pose=pose)
    assert len(bundle.views) == 12 and bundle.scan is not None
    [view] = [view for view in bundle.views if view.name == name]
    assert view.matte is not None and view.rgb is not None
    drawn = silhouette(view.camera, bundle.scan.vertices, bundle.scan.faces)
    person = view.matte > 0
    assert (drawn & person).sum() > INSIDE * drawn.sum()
    red, blue = view.rgb[..., 0].astype(int), view.rgb[..., 2].astype(int)
    dress = ndimage.binary_closing(person & (blue >= red + 4), iterations=6)
    dress = ndimage.binary_fill_holes(dress) & person
    assert (drawn & dress).sum() > SAME * (drawn | dress).sum()
    if pose != "static":  # which is its own mirror image
        mirrored = drawn[:, ::-1]
        assert (mirrored & dress).sum() < SAME * (mirrored | dress).sum()


def test_the_true_body_of_sewfactory_stands_on_its_pixels(real_scene):
    """The default body in the scene's pose, though of another shape, covers most of the person.

    With the angles composed in another order it covers a quarter.
    """
    bundle = read_sewfactory(real_scene, pose="0000")
    body = bundle.body
    assert body is not None
    model = load_default_body()
    # Shape spaces differ: the pose alone, with the pelvis where the scene has it.
    pelvis = np.array([-0.0007, -0.2125, 0.0293])  # of SMPL-H for the scene's shape [m]
    moved = body.transl + pelvis - np.asarray(model.joint_template)[0]
    vertices = world_vertices(dataclasses.replace(body, betas=np.zeros(1), transl=moved), model)
    [view] = [view for view in bundle.views if view.name == "front"]
    assert view.matte is not None
    drawn, person = silhouette(view.camera, vertices, np.asarray(model.faces)), view.matte > 0
    assert (drawn & person).sum() > COVERED * (drawn | person).sum()


# --- pickles ------------------------------------------------------------------------------------


class Asks:
    """What a malicious pickle does: it names a function to call."""

    def __reduce__(self):
        return print, ("this must not run",)


class AsksNumpy:
    """A function of numpy is no array either."""

    def __reduce__(self):
        return np.fromfile, ("/etc/hostname",)


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_plain_pickles_of_arrays_are_read(tmp_path, protocol):
    content = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.float32(0.5),
        "c": {"d": [1, 2.5, "x", None, True, (np.int64(3),)]},
        "e": np.array(["text"]),
    }
    (tmp_path / "p.pkl").write_bytes(pickle.dumps(content, protocol=protocol))
    found = read_pickle(tmp_path / "p.pkl")
    np.testing.assert_array_equal(found["a"], content["a"])
    assert found["b"] == 0.5 and found["c"] == content["c"] and found["e"][0] == "text"


def test_arrays_of_older_numpys_are_read(tmp_path):
    content = pickle.dumps({"a": np.arange(3)}, protocol=2)
    old = content.replace(b"numpy._core", b"numpy.core")
    (tmp_path / "old.pkl").write_bytes(old)
    np.testing.assert_array_equal(read_pickle(tmp_path / "old.pkl")["a"], [0, 1, 2])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"a": Asks()}, r"asks for builtins\.print"),
        ({"a": AsksNumpy()}, r"asks for numpy.*fromfile"),
        ({"a": BodyFamily.SMPL}, r"asks for dress_jax\.capture\.body\.BodyFamily"),
        ([1], "holds a list"),
    ],
)
def test_pickles_that_ask_for_more_are_refused(tmp_path, capsys, value, message):
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps(value))
    with pytest.raises(InputError, match=message) as caught:
        read_pickle(tmp_path / "bad.pkl")
    assert "bad.pkl" in str(caught.value) and "this must not" not in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"text", pickle.dumps({"a": np.zeros(99)})[:60]])
def test_damaged_pickles_are_named(tmp_path, content):
    (tmp_path / "bad.pkl").write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.pkl"):
        read_pickle(tmp_path / "bad.pkl")
    with pytest.raises(InputError, match="cannot be read"):
        read_pickle(tmp_path / "none.pkl")


# --- 4D-Dress -----------------------------------------------------------------------------------


def dump(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(content))


def four_d_dress(folder, *, turn=None):
    rng = np.random.default_rng(4)
    vertices = rng.normal(size=(5, 3))
    dump(
        folder / "Meshes_pkl" / "mesh-f00011.pkl",
        {
            "vertices": vertices,
            "faces": np.array([[0, 1, 2], [2, 3, 4]]),
            "colors": rng.integers(0, 256, (5, 4), dtype=np.uint8),
        },
    )
    labels = np.array([0, 1, 3, 4, 5])
    dump(folder / "Semantic" / "labels" / "label-f00011.pkl", {"scan_labels": labels})
    dump(folder / "basic_info.pkl", {"rotation": turn, "scan_frames": ["00011"]})
    dump(
        folder / "SMPLX" / "mesh-f00011_smplx.pkl",
        {
            "betas": np.ones(10),
            "global_orient": np.array([0.0, 0.2, 0.0]),
            "body_pose": rng.normal(size=63),
            "transl": np.array([0.1, 0.2, 0.3]),
            "left_hand_pose": np.ones(12),
            "right_hand_pose": np.ones(45),
        },
    )
    rotation = Rotation.from_euler("xyz", [175.0, 10.0, 5.0], degrees=True).as_matrix()
    extrinsics = np.concatenate([rotation, [[0.1], [0.9], [3.0]]], axis=1)
    camera = {"intrinsics": np.array([[90.0, 0, 20.0], [0, 95.0, 30.0], [0, 0, 1]])}
    camera["extrinsics"] = extrinsics
    dump(folder / "Capture" / "cameras.pkl", {"0004": camera, "0028": camera})
    pixels = rng.integers(0, 256, (64, 47, 3), dtype=np.uint8)
    save(folder / "Capture" / "0004" / "images" / "capture-f00011.png", pixels)
    save(folder / "Capture" / "0004" / "masks" / "mask-f00011.png", pixels[..., 0])
    return vertices, camera, pixels


@pytest.mark.parametrize("turn", [None, about_y(0.7)])
def test_a_frame_of_4d_dress_is_seen_as_opencv_sees_it(tmp_path, turn):
    vertices, camera, pixels = four_d_dress(tmp_path, turn=turn)
    bundle = read_four_d_dress(tmp_path, frame="00011")
    assert bundle.present == ("body", "scan", "views")
    [view] = bundle.views  # the other camera's pictures are not there
    assert view.name == "0004" and bundle.scan is not None and view.matte is not None
    seen = vertices @ camera["extrinsics"][:, :3].T + camera["extrinsics"][:, 3]
    expected = seen @ camera["intrinsics"].T
    columns, rows, depth = project(view.camera, jnp.asarray(bundle.scan.vertices))
    np.testing.assert_allclose(columns, expected[:, 0] / expected[:, 2], atol=PIXELS)
    np.testing.assert_allclose(rows, expected[:, 1] / expected[:, 2], atol=PIXELS)
    np.testing.assert_allclose(depth, seen[:, 2], atol=1e-6)
    np.testing.assert_array_equal(view.rgb, pixels)
    np.testing.assert_array_equal(view.matte, pixels[..., 0])
    assert bundle.scan.labels is not None
    np.testing.assert_array_equal(bundle.scan.labels, [1, 2, 3, 4, 3])
    assert bundle.body is not None and not bundle.body.left_hand_pose.any()
    assert (bundle.body.right_hand_pose == 1.0).all()
    np.testing.assert_array_equal(bundle.body.to_world, np.eye(3) if turn is None else turn)


def test_bad_frames_of_4d_dress_are_named(tmp_path):
    four_d_dress(tmp_path)
    with pytest.raises(InputError, match=r"has no frame '99'.*00011"):
        read_four_d_dress(tmp_path, frame="99")
    dump(tmp_path / "Semantic" / "labels" / "label-f00011.pkl", {"scan_labels": np.full(5, 8)})
    with pytest.raises(InputError, match=r"label-f00011\.pkl.*does not know id 8"):
        read_four_d_dress(tmp_path, frame="00011")
    dump(tmp_path / "Semantic" / "labels" / "label-f00011.pkl", {"scan_labels": np.zeros(4, int)})
    with pytest.raises(InputError, match=r"scan_labels: has shape \(4,\) for 5 vertices"):
        read_four_d_dress(tmp_path, frame="00011")
    (tmp_path / "Semantic" / "labels" / "label-f00011.pkl").unlink()
    dump(tmp_path / "Capture" / "cameras.pkl", {"0004": {"intrinsics": np.eye(3)}})
    with pytest.raises(InputError, match="camera 0004: holds no 'extrinsics'"):
        read_four_d_dress(tmp_path, frame="00011")


def test_skewed_cameras_are_refused():
    skewed = np.array([[90.0, 1.0, 20.0], [0, 90.0, 30.0], [0, 0, 1]])
    with pytest.raises(InputError, match="skewed"):
        opencv_camera(skewed, np.eye(4), height=8, width=8)


# --- CloSe --------------------------------------------------------------------------------------


def test_a_scan_of_close_keeps_its_labels_and_body(tmp_path):
    rng = np.random.default_rng(6)
    fields = {
        "points": rng.normal(size=(4, 3)),
        "faces": np.array([[0, 1, 2]]),
        "colors": rng.random((4, 3)),
        "labels": np.array([1.0, 6.0, 9.0, 12.0]),
        "pose": rng.normal(size=72),
        "betas": rng.normal(size=10),
        "trans": rng.normal(size=3),
        "names": np.array([{}]),  # an object array, which only a pickle could hold
    }
    np.savez(tmp_path / "s.npz", **fields)
    bundle = read_close(tmp_path / "s.npz")
    scan, body = bundle.scan, bundle.body
    assert scan is not None and body is not None and scan.labels is not None
    np.testing.assert_array_equal(scan.labels, [1, 5, 4, 2])
    np.testing.assert_array_equal(scan.colors, np.round(255 * fields["colors"]))
    np.testing.assert_array_equal(body.pose[:22].ravel(), fields["pose"][:66])
    assert body.family is BodyFamily.SMPL
    for name, value, message in [
        ("labels", np.array([0, 1, 2, 18]), r"s\.npz.*does not know id 18"),
        ("labels", np.array([0, 1, 2]), r"labels: has shape \(3,\) for 4 points"),
        ("points", np.zeros((4, 2)), r"points: has shape \(4, 2\)"),
    ]:
        np.savez(tmp_path / "s.npz", **{**fields, name: value})
        with pytest.raises(InputError, match=message):
            read_close(tmp_path / "s.npz")


def test_colours_are_read_in_any_range():
    bytes_ = np.array([[0, 128, 255]], np.uint8)
    for colors in (bytes_, bytes_.astype(float), bytes_ / 255.0):
        np.testing.assert_array_equal(eight_bit(colors), bytes_)
    assert eight_bit(None) is None
