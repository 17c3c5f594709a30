"""Static body meshes and rigged body files: round trips and what is said about bad ones."""

import numpy as np
import pytest

from dress_jax.body.model import forward
from dress_jax.body.poses import a_pose
from dress_jax.body.skeleton import PARENTS
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import body_from_argument, load_body_model, load_default_body
from dress_jax.io.body_meshes import load_body_mesh

BOX = """v 0 0 0\nv 0.4 0 0\nv 0.4 1.7 0\nv 0 1.7 0\nv 0 0 0.3
v 0.4 0 0.3\nv 0.4 1.7 0.3\nv 0 1.7 0.3
vt 0 0\nvt 1 0\n
f 4/1 3/2 2/1 1/2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8
"""


def write(path, text):
    path.write_text(text)
    return path


def test_quads_become_triangles(tmp_path):
    vertices, faces = load_body_mesh(write(tmp_path / "box.obj", BOX))
    assert vertices.shape == (8, 3)
    assert faces.shape == (12, 3)
    assert np.ptp(vertices, axis=0) == pytest.approx([0.4, 1.7, 0.3])


@pytest.mark.parametrize("suffix", ["ply", "glb", "stl"])
def test_split_vertices_are_merged_in_every_format(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box(extents=(0.4, 1.7, 0.3))
    corners = trimesh.Trimesh(
        box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    corners.export(tmp_path / f"split.{suffix}")
    vertices, faces = load_body_mesh(tmp_path / f"split.{suffix}")
    assert (len(vertices), len(faces)) == (8, 12)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (100, "centimetres.*scale=0.01"),
        (1000, "millimetres"),
        (39.37, "inches"),
        (1e6, "no person"),
    ],
)
def test_a_wrong_unit_is_named_with_its_mend(tmp_path, factor, message):
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / "body.ply"
    trimesh.creation.box(extents=np.array([0.4, 1.7, 0.3]) * factor).export(path)
    with pytest.raises(InputError, match=message):
        load_body_mesh(path)
    vertices, _ = load_body_mesh(path, scale=1.0 / factor)
    assert np.ptp(vertices[:, 1]) == pytest.approx(1.7, rel=1e-5)


def test_a_z_up_body_is_named(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box(extents=(0.5, 0.3, 1.7)).export(tmp_path / "lying.ply")
    with pytest.raises(InputError, match="z-up"):
        load_body_mesh(tmp_path / "lying.ply")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", BOX.replace("0.4 1.7 0\n", "nan 1.7 0\n"), "vertex 2 is not a finite"),
        ("b.obj", BOX + "f 1 2 99\n", r"line \d+.*index 99"),
        ("c.obj", BOX + "f 1 2\n", "three corners"),
        ("d.obj", "v 0 0 0\nv 0 1.7 0\n", "no faces"),
        ("e.fbx", "", "not a mesh format"),
        ("f.glb", "not a mesh", "cannot be read as a mesh"),
    ],
)
def test_bad_meshes_are_refused_by_name(tmp_path, name, text, message):
    with pytest.raises(InputError, match=message) as caught:
        load_body_mesh(write(tmp_path / name, text))
    assert name in str(caught.value)


def test_a_missing_mesh_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.obj: there is no such file"):
        load_body_mesh(tmp_path / "none.obj")


def test_real_bodies_load(shared_data):
    vertices, faces = load_body_mesh(shared_data / "bodies" / "f_smpl_average_A40.obj")
    assert vertices.shape == (6890, 3)
    assert faces.shape == (13776, 3)


def smplx_arrays(*, vertices=30, seed=0):
    """Random numbers under the keys and shapes of an SMPL-X file."""
    rng = np.random.default_rng(seed)
    weights, regressor = rng.random((vertices, 55)), rng.random((55, vertices))
    tree = np.array([PARENTS, range(55)], dtype=np.int64)
    tree[0, 0] = 2**32 - 1  # the placeholder that real files hold
    return {
        "v_template": rng.normal(size=(vertices, 3)),
        "f": rng.integers(0, vertices, size=(40, 3)).astype(np.uint32),
        "shapedirs": 0.1 * rng.normal(size=(vertices, 3, 400)),
        "posedirs": 0.01 * rng.normal(size=(vertices, 3, 486)),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "kintree_table": tree,
        "hands_meanl": rng.normal(size=45),
        "hands_meanr": rng.normal(size=45),
        "dynamic_lmk": np.array([{"an": "object"}], dtype=object),
    }


def test_an_smplx_file_gives_a_model(tmp_path):
    arrays = smplx_arrays()
    np.savez(tmp_path / "model.npz", **arrays)
    model = load_body_model(tmp_path / "model.npz", shape_components=10)
    assert model.parents == PARENTS
    rng = np.random.default_rng(1)
    shape = rng.normal(size=10)
    state = forward(model, np.zeros((55, 3)), shape, np.zeros(3))
    rest = arrays["v_template"] + arrays["shapedirs"][:, :, :10] @ shape
    np.testing.assert_allclose(state.vertices, rest, atol=1e-12)
    np.testing.assert_allclose(state.joints, arrays["J_regressor"] @ rest, atol=1e-12)

    relaxed = load_body_model(tmp_path / "model.npz", shape_components=10, flat_hands=False)
    pose = np.zeros((55, 3))
    pose[25:40] = arrays["hands_meanl"].reshape(15, 3)
    pose[40:55] = arrays["hands_meanr"].reshape(15, 3)
    np.testing.assert_allclose(
        forward(relaxed, np.zeros((55, 3)), shape, np.zeros(3)).vertices,
        forward(model, pose, shape, np.zeros(3)).vertices,
        atol=1e-12,
    )


def test_old_smplx_files_have_ten_shape_components(tmp_path):
    arrays = smplx_arrays()
    arrays["shapedirs"] = arrays["shapedirs"][:, :, :20]
    np.savez(tmp_path / "model.npz", **arrays)
    assert load_body_model(tmp_path / "model.npz", shape_components=10).shapedirs.shape[2] == 10
    with pytest.raises(InputError, match="10 shape components"):
        load_body_model(tmp_path / "model.npz", shape_components=16)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": None, "f": None}, "lacks f, weights"),
        ({"weights": np.zeros((3, 55))}, r"'weights' has shape \(3, 55\)"),
        ({"posedirs": np.zeros((30, 3, 207))}, "'posedirs'"),
        ({"J_regressor": np.full((55, 30), np.nan)}, "not finite"),
    ],
)
def test_broken_model_files_are_refused(tmp_path, change, message):
    arrays = smplx_arrays() | change
    np.savez(tmp_path / "m.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(InputError, match=message):
        load_body_model(tmp_path / "m.npz")


def test_files_that_are_no_npz_are_refused(tmp_path):
    with pytest.raises(InputError, match="not a valid npz"):
        load_body_model(write(tmp_path / "text.npz", "hello"))
    with pytest.raises(InputError, match="cannot be read"):
        load_body_model(tmp_path / "none.npz")


def test_the_command_line_argument_gives_a_posed_body(tmp_path):
    named = body_from_argument("default", pose="a", shape="female")
    np.savez(tmp_path / "pose.npz", pose=a_pose())
    loaded = body_from_argument("default", pose=tmp_path / "pose.npz", shape="female")
    np.testing.assert_array_equal(named.vertices, loaded.vertices)
    assert named.model is not None
    static = body_from_argument(write(tmp_path / "box.obj", BOX))
    assert static.model is None
    assert static.vertices.shape == (8, 3)


def test_bad_arguments_are_named(tmp_path):
    np.savez(tmp_path / "short.npz", pose=np.zeros((24, 3)))
    np.savez(tmp_path / "other.npz", angles=np.zeros((55, 3)))
    np.savez(tmp_path / "betas.npz", pose=np.zeros((55, 3)), betas=np.zeros(10))
    for options, message in [
        ({"pose": "lotus"}, "neither a named pose"),
        ({"shape": "giant"}, "no shape 'giant'"),
        ({"pose": tmp_path / "short.npz"}, r"shape \(24, 3\)"),
        ({"pose": tmp_path / "other.npz"}, "no 'pose'"),
        ({"pose": tmp_path / "betas.npz"}, "mean nothing on the default body"),
        ({"body": write(tmp_path / "box.obj", BOX), "pose": "a"}, "static mesh"),
    ]:
        with pytest.raises(InputError, match=message):
            body_from_argument(**options)


def test_the_default_body_has_the_documented_size():
    model = load_default_body()
    assert model.template.shape == (12272, 3)
    assert model.faces.shape == (24540, 3)
    assert model.shapedirs.shape == (12272, 3, 16)
    np.testing.assert_allclose(np.asarray(model.skin_weights).sum(axis=1), 1.0, atol=1e-12)
