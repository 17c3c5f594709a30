"""The embedded networks against reference values, and faults in networks.

`references.npz` holds what onnxruntime 1.32.0 gave for u2netp.onnx (every eighth row and column of
its first output) and LiteRT 2.3.0 for pose_landmark_full.tflite, on the pictures of
`network_inputs`.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from network_inputs import landmark_picture, matting_picture

from dress_jax.core.errors import InputError
from dress_jax.io.networks import load_landmark_network, load_matting_network, read_network
from dress_jax.vision import networks
from dress_jax.vision.networks import (
    Graph,
    Network,
    Node,
    graph_document,
    graph_from_document,
    run_network,
)

# Single precision through a hundred convolutions: measured 4e-5 for coverage in [0, 1] and 0.003
# for coordinates up to 256.
COVERAGE_TOLERANCE = 3e-4
LANDMARK_TOLERANCE = 0.02


@pytest.fixture(scope="module")
def references():
    with np.load(Path(__file__).with_name("references.npz")) as data:
        return dict(data)


def test_matting_network_gives_the_reference_values(references):
    (coverage,) = run_network(load_matting_network(), matting_picture())
    assert coverage.dtype == np.float32 and coverage.shape == (1, 320, 320, 1)
    np.testing.assert_allclose(
        coverage[0, ::8, ::8, 0], references["coverage"], atol=COVERAGE_TOLERANCE
    )
    assert references["coverage"].max() > 0.9  # it does see the mannequin


def test_landmark_network_gives_the_reference_values(references):
    landmarks, presence = run_network(load_landmark_network(), landmark_picture())
    np.testing.assert_allclose(landmarks, references["landmarks"], atol=LANDMARK_TOLERANCE)
    np.testing.assert_allclose(presence, references["presence"], atol=1e-4)


def test_networks_compile_once():
    network = load_landmark_network()
    run_network(network, landmark_picture())
    before = networks._run._cache_size()
    run_network(network, 0.5 * landmark_picture())
    assert networks._run._cache_size() == before


def test_a_graph_survives_its_document():
    graph = load_landmark_network().graph
    assert graph_from_document(graph_document(graph)) == graph


def test_pictures_of_another_size_are_refused():
    with pytest.raises(InputError, match=r"\(b, 256, 256, 3\)"):
        run_network(load_landmark_network(), np.zeros((1, 64, 64, 3)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"operation": "attention"}, "attention"),
        ({"activation": "gelu"}, "gelu"),
        ({"inputs": ("nothing",)}, "uses nothing"),
        ({"weights": ("kernel",)}, "uses kernel"),
        ({"output": "other"}, "lacks its output end"),
    ],
)
def test_faulty_networks_are_refused(change, message):
    node = dataclasses.replace(Node("activate", ("picture",), "end"), **change)
    with pytest.raises(InputError, match=message):
        Network(Graph((node,), "picture", (4, 4), ("end",)), {})


def test_an_archive_without_a_network_is_named(tmp_path):
    np.savez(tmp_path / "a.npz", weights=np.zeros(3))
    with pytest.raises(InputError, match=r"a\.npz: holds no network"):
        read_network(tmp_path / "a.npz")
    with pytest.raises(InputError, match="no description"):
        graph_from_document({"nodes": [{"layer": 3}]})
