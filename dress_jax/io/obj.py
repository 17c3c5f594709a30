"""The part of Wavefront OBJ that garments and bodies use, as text to arrays and back."""

import dataclasses
from pathlib import Path

import numpy as np

from dress_jax.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class ObjContents:
    """What an OBJ file holds.

    Args:
        vertices: `v` positions, shape (n, 3), in the file's unit.
        texture: `vt` coordinates, shape (t, 2); (0, 2) when absent.
        faces: triangles in vertices, shape (f, 3); polygons are split into fans.
        texture_faces: triangles in texture coordinates, shape (f, 3), or None unless every
            corner has one.
        groups: name of each group, in order of appearance.
        face_groups: index into `groups` of each triangle, shape (f,).
    """

    vertices: np.ndarray
    texture: np.ndarray
    faces: np.ndarray
    texture_faces: np.ndarray | None
    groups: tuple[str, ...]
    face_groups: np.ndarray


def read_obj(path: str | Path) -> ObjContents:
    """Read positions, texture coordinates, faces and groups; everything else is skipped.

    Raises:
        InputError: the file is missing, not text, or a line cannot be understood; names the line.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), mend="check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            "is not a text file", where=str(path), mend="export the mesh as Wavefront OBJ"
        ) from error

    vertices: list[list[float]] = []
    texture: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    texture_faces: list[tuple[int, int, int]] = []
    groups: list[str] = []
    face_groups: list[int] = []
    group = -1
    for number, line in enumerate(lines, start=1):
        key, _, rest = line.strip().partition(" ")
        try:
            if key == "v":
                vertices.append([float(x) for x in rest.split()[:3]])
                if len(vertices[-1]) != 3:
                    raise ValueError("a vertex needs three coordinates")
            elif key == "vt":
                texture.append([float(x) for x in rest.split()[:2]])
                if len(texture[-1]) != 2:
                    raise ValueError("a texture coordinate needs two numbers")
            elif key in ("g", "o"):
                name = rest.strip()
                if name not in groups:
                    groups.append(name)
                group = groups.index(name)
            elif key == "f":
                if group < 0:
                    groups.append("")
                    group = 0
                corners = [corner.split("/") for corner in rest.split()]
                if len(corners) < 3:
                    raise ValueError("a face needs three corners")
                points = [_resolve(corner[0], len(vertices)) for corner in corners]
                textured = all(len(corner) > 1 and corner[1] for corner in corners)
                coordinates = (
                    [_resolve(corner[1], len(texture)) for corner in corners] if textured else []
                )
                for k in range(1, len(points) - 1):
                    faces.append((points[0], points[k], points[k + 1]))
                    face_groups.append(group)
                    if textured:
                        texture_faces.append((coordinates[0], coordinates[k], coordinates[k + 1]))
        except ValueError as error:
            raise InputError(
                f"'{line.strip()}' cannot be understood ({error})",
                where=f"{path}, line {number}",
                mend="export the mesh again, or correct the line",
            ) from error
    return ObjContents(
        vertices=np.array(vertices, dtype=np.float64).reshape(-1, 3),
        texture=np.array(texture, dtype=np.float64).reshape(-1, 2),
        faces=np.array(faces, dtype=np.int64).reshape(-1, 3),
        texture_faces=np.array(texture_faces, dtype=np.int64)
        if faces and len(texture_faces) == len(faces)
        else None,
        groups=tuple(groups),
        face_groups=np.array(face_groups, dtype=np.int64),
    )


def _resolve(text: str, count: int) -> int:
    """An OBJ index: counted from one, or backwards from the latest when negative."""
    index = int(text)
    zero_based = index - 1 if index > 0 else count + index
    if index == 0 or not 0 <= zero_based < count:
        raise ValueError(f"index {index} of {count}")
    return zero_based
