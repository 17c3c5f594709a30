"""Meshes for the page's 3D view, packed into text."""

import base64
import dataclasses
import json
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError

_STEPS = 65535


@dataclasses.dataclass(frozen=True)
class ViewedMesh:
    """A mesh in the view.

    Attributes:
        name: on its switch.
        vertices: [m], shape (n, 3).
        faces: shape (f, 3).
        color: RGB in [0, 1].
        shown: whether it is on at first.
    """

    name: str
    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"]
    color: tuple[float, float, float]
    shown: bool = True


def viewer(identity: str, meshes: Sequence[ViewedMesh], *, instead: str) -> str:
    """HTML of a 3D view: turn, move and zoom by mouse or fingers; switches for every mesh.

    Args:
        identity: unique in the page; letters, digits and hyphens.
        meshes: to be seen.
        instead: HTML that stays where a browser has no WebGL or runs no scripts.

    Raises:
        InputError: a mesh without triangles, or numbers that are not finite.
    """
    scene = {"meshes": [_packed(mesh) for mesh in meshes]}
    # A closing tag inside of the data would end the element.
    data = json.dumps(scene).replace("</", "<\\/")
    return (
        f'<div class="viewer" data-scene="{identity}">{instead}</div>\n'
        f'<script type="application/json" id="{identity}">{data}</script>\n'
    )


def _packed(mesh: ViewedMesh) -> dict:
    """Positions as 16-bit steps along each axis: 0.03 mm for a person."""
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    if not len(faces) or not np.isfinite(vertices).all():
        raise InputError("has no triangles, or is not finite", where=f"mesh '{mesh.name}'")
    origin = vertices.min(axis=0)
    step = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / _STEPS
    steps = np.round((vertices - origin) / step).astype("<u2")
    return {
        "name": mesh.name,
        "color": [float(c) for c in mesh.color],
        "shown": mesh.shown,
        "origin": origin.tolist(),
        "step": step,
        "positions": base64.b64encode(steps.tobytes()).decode("ascii"),
        "indices": base64.b64encode(faces.astype("<u4").tobytes()).decode("ascii"),
    }
