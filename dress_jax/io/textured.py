"""Textured garments as files: OBJ with MTL and PNG, and GLB (S14.4, S14.5).

Texture coordinates are affine functions of panel coordinates, so seams of the cloth are seams of
the texture. A repeated tile has coordinates beyond 0 to 1 and, in GLB, a sampler that repeats; an
atlas has a sampler that stops at its border.
"""

import io
import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from dress_jax.io.atomic import atomic_open
from dress_jax.io.images import write_rgb
from dress_jax.io.meshes import BODY_COLOUR, GarmentMesh, vertex_normals
from dress_jax.texture.textured import Texture

# Of the glTF 2.0 specification.
_REPEAT, _CLAMP, _LINEAR, _TRILINEAR = 10497, 33071, 9729, 9987
_FLOAT, _UNSIGNED_INT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_MAGIC, _JSON_CHUNK, _BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


def write_textured_obj(
    folder: str | Path, garment: GarmentMesh, texture: Texture, *, name: str = "textured"
) -> list[Path]:
    """Write `NAME.obj`, `NAME.mtl` and a PNG per image; one group per panel, a material per image.

    Args:
        folder: made where it is missing.
        garment: the welded garment.
        texture: on its panels.
        name: of the files; images are called `NAME-IMAGE.png`.

    Returns:
        The files.

    Raises:
        ValueError: the texture does not fit the garment, or colours are out of range.
        InputError: the folder cannot be written to.
    """
    _check(garment, texture)
    folder = Path(folder)
    written = []
    for image, own in zip(texture.images, texture.names, strict=True):
        written.append(folder / f"{name}-{own}.png")
        write_rgb(written[-1], image)
    with atomic_open(folder / f"{name}.mtl") as file:
        for own, path in zip(texture.names, written, strict=True):
            file.write(f"newmtl {own}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\n")
            # Images repeat by default. `-clamp on` for an atlas would say what its coordinates
            # within 0 to 1 say already, and many readers take options for a part of the name.
            file.write(f"map_Kd {path.name}\n\n")
    with atomic_open(folder / f"{name}.obj") as file:
        file.write(f"mtllib {name}.mtl\n")
        for key, rows in (
            ("v", garment.vertices),
            ("vt", texture.coordinates),
            ("vn", vertex_normals(garment.vertices, garment.faces)),
        ):
            np.savetxt(file, rows, fmt=key + " %.17g" * rows.shape[1])
        for number, panel in enumerate(garment.panels):
            members = garment.face_panels == number
            file.write(f"g {panel}\nusemtl {texture.names[texture.panel_images[number]]}\n")
            corners = np.stack([garment.faces, garment.rest_faces, garment.faces], axis=2)[members]
            np.savetxt(file, corners.reshape(-1, 9) + 1, fmt="f" + " %d/%d/%d" * 3)
    return [*written, folder / f"{name}.mtl", folder / f"{name}.obj"]


def write_textured_glb(
    path: str | Path,
    garment: GarmentMesh,
    texture: Texture,
    *,
    body: tuple[Float[np.ndarray, "b 3"], np.ndarray] | None = None,
) -> None:
    """Write one GLB: a node, a mesh and a double-sided material per panel, images inside, and the
    body as a node of its own.

    Args:
        path: the `.glb` file.
        garment: the welded garment.
        texture: on its panels.
        body: vertices [m] and faces.

    Raises:
        ValueError: the texture does not fit the garment, or colours are out of range.
        InputError: the place cannot be written to.
    """
    _check(garment, texture)
    document = _Document()
    wrap = _REPEAT if texture.repeat else _CLAMP
    sampler = document.add(
        "samplers",
        {"magFilter": _LINEAR, "minFilter": _TRILINEAR, "wrapS": wrap, "wrapT": wrap},
    )
    textures = []
    for image, name in zip(texture.images, texture.names, strict=True):
        view = document.add_view(_png(image))
        source = document.add("images", {"name": name, "mimeType": "image/png", "bufferView": view})
        textures.append(document.add("textures", {"sampler": sampler, "source": source}))
    smooth = vertex_normals(garment.vertices, garment.faces)
    children = []
    for number, panel in enumerate(garment.panels):
        members = garment.face_panels == number
        if not members.any():
            continue
        used, first, compact = np.unique(
            garment.rest_faces[members], return_index=True, return_inverse=True
        )
        corners = garment.faces[members].ravel()[first]
        # Rows of a glTF image count from the top, so its second coordinate does as well.
        place = texture.coordinates[used] * [1.0, -1.0] + [0.0, 1.0]
        material = {
            "name": panel,
            "doubleSided": True,
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": textures[int(texture.panel_images[number])]},
                "metallicFactor": 0.0,
                "roughnessFactor": 0.9,
            },
        }
        mesh = document.add_mesh(
            panel,
            compact.reshape(-1, 3),
            {"POSITION": garment.vertices[corners], "NORMAL": smooth[corners], "TEXCOORD_0": place},
            material,
        )
        children.append(document.add("nodes", {"name": panel, "mesh": mesh}))
    roots = [document.add("nodes", {"name": "garment", "children": children})]
    if body is not None:
        vertices, faces = np.asarray(body[0], np.float64), np.asarray(body[1])
        material = {
            "name": "body",
            "pbrMetallicRoughness": {
                "baseColorFactor": [*BODY_COLOUR, 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 0.8,
            },
        }
        arrays = {"POSITION": vertices, "NORMAL": vertex_normals(vertices, faces)}
        mesh = document.add_mesh("body", faces, arrays, material)
        roots.append(document.add("nodes", {"name": "body", "mesh": mesh}))
    document.add("scenes", {"nodes": roots})
    content = document.packed()
    with atomic_open(path, binary=True) as file:
        file.write(content)


class _Document:
    """A glTF document while it is put together; everything lies in one buffer."""

    def __init__(self) -> None:
        self.lists: dict[str, list[dict[str, Any]]] = {}
        self.buffer = bytearray()

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append to a list; returns the index."""
        entries = self.lists.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def add_view(self, content: bytes, target: int | None = None) -> int:
        """Append bytes to the buffer, aligned to four."""
        self.buffer += b"\0" * (-len(self.buffer) % 4)
        view = {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": len(content)}
        self.buffer += content
        return self.add("bufferViews", view if target is None else {**view, "target": target})

    def add_mesh(
        self, name: str, faces: np.ndarray, arrays: dict[str, np.ndarray], material: dict[str, Any]
    ) -> int:
        """Append triangles with vertex attributes and their material."""
        attributes = {}
        for key, rows in arrays.items():
            rows = np.ascontiguousarray(rows, dtype="<f4")
            entry = {
                "bufferView": self.add_view(rows.tobytes(), _VERTICES),
                "componentType": _FLOAT,
                "count": len(rows),
                "type": f"VEC{rows.shape[1]}",
            }
            if key == "POSITION":  # where bounds are required
                entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
            attributes[key] = self.add("accessors", entry)
        indices = np.ascontiguousarray(faces, dtype="<u4").ravel()
        accessor = self.add(
            "accessors",
            {
                "bufferView": self.add_view(indices.tobytes(), _INDICES),
                "componentType": _UNSIGNED_INT,
                "count": len(indices),
                "type": "SCALAR",
                "min": [int(indices.min())],
                "max": [int(indices.max())],
            },
        )
        number = self.add("materials", material)
        primitive = {"attributes": attributes, "indices": accessor, "material": number}
        return self.add("meshes", {"name": name, "primitives": [primitive]})

    def packed(self) -> bytes:
        """The binary container."""
        document = {
            "asset": {"version": "2.0", "generator": "dress_jax"},
            "scene": 0,
            **self.lists,
            "buffers": [{"byteLength": len(self.buffer)}],
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.buffer) + b"\0" * (-len(self.buffer) % 4)
        return b"".join(
            [
                struct.pack("<III", _MAGIC, 2, 12 + 8 + len(text) + 8 + len(binary)),
                struct.pack("<II", len(text), _JSON_CHUNK),
                text,
                struct.pack("<II", len(binary), _BINARY_CHUNK),
                binary,
            ]
        )


def _png(image: Float[np.ndarray, "h w 3"]) -> bytes:
    content = io.BytesIO()
    pixels = np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    Image.fromarray(pixels).save(content, format="PNG")
    return content.getvalue()


def _check(garment: GarmentMesh, texture: Texture) -> None:
    found: Sequence[tuple[int, int, str]] = (
        (len(texture.coordinates), len(garment.rest_positions), "texture coordinates"),
        (len(texture.panel_images), len(garment.panels), "panel images"),
        (len(texture.names), len(texture.images), "image names"),
    )
    for count, wanted, what in found:
        if count != wanted:
            raise ValueError(f"{count} {what}, not {wanted}")
    if not np.isfinite(texture.coordinates).all():
        raise ValueError("texture coordinates are not finite")
