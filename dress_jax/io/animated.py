"""A moving garment and its wearer as GLB: one morph target a frame, played by its weights (S15).

Blender and three.js play such files without an extension. A mesh is its first frame; target k holds
the differences of frame k, in positions and in normals. The animation gives the weight 1 to one
target after the other, so that vertices move along straight lines between two frames.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dress_jax.io.atomic import atomic_open
from dress_jax.io.gltf import GltfDocument
from dress_jax.io.meshes import (
    BODY_COLOUR,
    GarmentMesh,
    panel_colour,
    panel_meshes,
    vertex_normals,
)


def write_animated_glb(
    path: str | Path,
    garment: GarmentMesh,
    frames: Float[np.ndarray, "t n 3"],
    *,
    fps: float,
    body: tuple[Float[np.ndarray, "t b 3"], Int[np.ndarray, "k 3"]] | None = None,
) -> None:
    """Write a node for the garment, with a primitive and a double-sided material a panel, a node
    for the body, and one animation.

    Args:
        path: the `.glb` file.
        garment: topology, panels and texture coordinates.
        frames: positions of its vertices [m].
        fps: frames per second.
        body: positions [m] and triangles.

    Raises:
        ValueError: there is no frame, or arrays do not fit each other.
        InputError: the place cannot be written to.
    """
    frames = np.asarray(frames, np.float64)
    if frames.ndim != 3 or frames.shape[1:] != garment.vertices.shape or not len(frames):
        raise ValueError(f"frames of shape {frames.shape} for {len(garment.vertices)} vertices")
    if body is not None and len(body[0]) != len(frames):
        raise ValueError(f"{len(body[0])} frames of the body, {len(frames)} of the garment")
    document = GltfDocument()
    normals = np.stack([vertex_normals(x, garment.faces) for x in frames])
    primitives = []
    for panel in panel_meshes(garment):
        primitives.append(
            _primitive(
                document,
                panel.faces,
                frames[:, panel.corners],
                normals[:, panel.corners],
                {"TEXCOORD_0": garment.rest_positions[panel.used]},
                _material(panel.name, panel_colour(panel.number), double_sided=True),
            )
        )
    nodes = [_node(document, "garment", primitives, len(frames))]
    if body is not None:
        shapes, faces = np.asarray(body[0], np.float64), np.asarray(body[1])
        turned = np.stack([vertex_normals(x, faces) for x in shapes])
        material = _material("body", BODY_COLOUR, double_sided=False)
        primitive = _primitive(document, faces, shapes, turned, {}, material)
        nodes.append(_node(document, "body", [primitive], len(frames)))
    document.add("scenes", {"nodes": nodes})
    if len(frames) > 1:
        _play(document, nodes, len(frames), fps)
    content = document.packed()
    with atomic_open(path, binary=True) as file:
        file.write(content)


def _material(name: str, color: tuple[float, float, float], *, double_sided: bool) -> dict:
    return {
        "name": name,
        "doubleSided": double_sided,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*color, 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": 0.9,
        },
    }


def _primitive(
    document: GltfDocument,
    faces: np.ndarray,
    frames: np.ndarray,
    normals: np.ndarray,
    others: dict[str, np.ndarray],
    material: dict[str, Any],
) -> dict[str, Any]:
    base = {"POSITION": frames[0], "NORMAL": normals[0], **others}
    primitive = document.primitive(faces, base, material)
    # Differences of what is written, so that rounding does not add up.
    first, up = frames[0].astype("<f4").astype(float), normals[0].astype("<f4").astype(float)
    targets = [
        {
            "POSITION": document.add_vectors(x - first, bounds=True),
            "NORMAL": document.add_vectors(n - up),
        }
        for x, n in zip(frames[1:], normals[1:], strict=True)
    ]
    return {**primitive, "targets": targets} if targets else primitive


def _node(document: GltfDocument, name: str, primitives: list[dict], frames: int) -> int:
    mesh: dict[str, Any] = {"name": name, "primitives": primitives}
    if frames > 1:
        mesh["weights"] = [0.0] * (frames - 1)
        mesh["extras"] = {"targetNames": [f"frame_{k:04d}" for k in range(1, frames)]}
    return document.add("nodes", {"name": name, "mesh": document.add("meshes", mesh)})


def _play(document: GltfDocument, nodes: list[int], frames: int, fps: float) -> None:
    times = document.add_vectors(np.arange(frames) / fps, bounds=True, vertices=False)
    weights = np.eye(frames)[:, 1:]  # the first frame is the mesh itself
    values = document.add_vectors(weights.ravel(), vertices=False)
    sampler = {"input": times, "output": values, "interpolation": "LINEAR"}
    channels = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in nodes]
    document.add("animations", {"name": "motion", "samplers": [sampler], "channels": channels})
