"""A glTF 2.0 document while it is put together, and its binary container."""

import json
import struct
from typing import Any

import numpy as np

# Of the specification.
FLOAT, UNSIGNED_INT = 5126, 5125
VERTICES, INDICES = 34962, 34963
_MAGIC, _JSON_CHUNK, _BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


class GltfDocument:
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

    def add_vectors(self, rows: np.ndarray, *, bounds: bool = False, vertices: bool = True) -> int:
        """Append numbers or vectors in single precision; returns the accessor.

        Args:
            rows: (n,) or (n, 2), (n, 3), (n, 4).
            bounds: smallest and largest components, required of positions and times.
            vertices: whether they belong to vertices.
        """
        rows = np.ascontiguousarray(rows, dtype="<f4")
        entry = {
            "bufferView": self.add_view(rows.tobytes(), VERTICES if vertices else None),
            "componentType": FLOAT,
            "count": len(rows),
            "type": "SCALAR" if rows.ndim == 1 else f"VEC{rows.shape[1]}",
        }
        if bounds:
            low, high = np.atleast_1d(rows.min(axis=0)), np.atleast_1d(rows.max(axis=0))
            entry |= {"min": low.tolist(), "max": high.tolist()}
        return self.add("accessors", entry)

    def primitive(
        self, faces: np.ndarray, arrays: dict[str, np.ndarray], material: dict[str, Any]
    ) -> dict[str, Any]:
        """Append triangles with vertex attributes and their material."""
        attributes = {
            key: self.add_vectors(rows, bounds=key == "POSITION") for key, rows in arrays.items()
        }
        indices = np.ascontiguousarray(faces, dtype="<u4").ravel()
        accessor = self.add(
            "accessors",
            {
                "bufferView": self.add_view(indices.tobytes(), INDICES),
                "componentType": UNSIGNED_INT,
                "count": len(indices),
                "type": "SCALAR",
                "min": [int(indices.min())],
                "max": [int(indices.max())],
            },
        )
        number = self.add("materials", material)
        return {"attributes": attributes, "indices": accessor, "material": number}

    def add_mesh(
        self, name: str, faces: np.ndarray, arrays: dict[str, np.ndarray], material: dict[str, Any]
    ) -> int:
        """Append a mesh of one primitive; returns its index."""
        primitive = self.primitive(faces, arrays, material)
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
