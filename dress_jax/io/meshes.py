"""Draped garments and bodies as mesh files: OBJ with panels and texture, GLB to look at."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_open
from dress_jax.io.obj import read_obj

BODY_COLOUR = (0.82, 0.72, 0.65)


@dataclasses.dataclass(frozen=True)
class GarmentMesh:
    """A welded garment with its flat panels.

    Args:
        vertices: draped positions [m], shape (n, 3).
        faces: triangles in vertices, shape (f, 3).
        rest_positions: panel coordinates [m], shape (p, 2); written as texture coordinates.
        rest_faces: the same triangles in panel vertices, shape (f, 3).
        panels: panel names.
        face_panels: panel of each triangle, shape (f,).
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"]
    rest_positions: Float[np.ndarray, "p 2"]
    rest_faces: Int[np.ndarray, "f 3"]
    panels: tuple[str, ...]
    face_panels: Int[np.ndarray, " f"]


def write_garment_obj(path: str | Path, garment: GarmentMesh, *, normals: bool = True) -> None:
    """Write a garment: one group per panel, texture coordinates in metres on the flat panel.

    Triangles are grouped by panel, in the given order within each; numbers have 17 digits, so they
    read back exactly.

    Raises:
        ValueError: array lengths do not agree or a panel's name is not one line of text.
        InputError: the place cannot be written to.
    """
    _check(garment)
    with atomic_open(path) as file:
        _rows(file, "v", garment.vertices)
        _rows(file, "vt", garment.rest_positions)
        if normals:
            _rows(file, "vn", vertex_normals(garment.vertices, garment.faces))
        for number, name in enumerate(garment.panels):
            file.write(f"g {name}\n")
            members = garment.face_panels == number
            pairs = zip(garment.faces[members] + 1, garment.rest_faces[members] + 1, strict=True)
            for face, rest in pairs:
                corners = (
                    f"{v}/{t}/{v}" if normals else f"{v}/{t}"
                    for v, t in zip(face, rest, strict=True)
                )
                file.write(f"f {' '.join(corners)}\n")


def read_garment_obj(path: str | Path) -> GarmentMesh:
    """Read a garment that `write_garment_obj` wrote, or any textured OBJ with groups.

    Raises:
        InputError: the file cannot be read, has no faces or no texture coordinates.
    """
    contents = read_obj(path)
    if len(contents.faces) == 0 or contents.texture_faces is None:
        raise InputError(
            "is no garment: it lacks faces with texture coordinates",
            where=str(path),
            mend="export it with texture coordinates, which hold the flat panels",
        )
    return GarmentMesh(
        vertices=contents.vertices,
        faces=contents.faces,
        rest_positions=contents.texture,
        rest_faces=contents.texture_faces,
        panels=contents.groups,
        face_panels=contents.face_groups,
    )


def write_body_obj(
    path: str | Path, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]
) -> None:
    """Write a plain triangle mesh [m].

    Raises:
        InputError: the place cannot be written to.
    """
    with atomic_open(path) as file:
        _rows(file, "v", vertices)
        np.savetxt(file, np.asarray(faces) + 1, fmt="f %d %d %d")


def write_glb(
    path: str | Path,
    *,
    garments: Sequence[GarmentMesh] = (),
    body: tuple[np.ndarray, np.ndarray] | None = None,
) -> None:
    """Write one GLB with a node and a coloured double-sided material per panel, and the body.

    Args:
        path: the `.glb` file.
        garments: garments; texture coordinates are panel coordinates [m].
        body: vertices [m] and faces.

    Raises:
        ValueError: there is nothing to write, or a garment's arrays do not agree.
        InputError: the place cannot be written to.
    """
    import trimesh

    if not garments and body is None:
        raise ValueError("there is neither a garment nor a body to write")
    scene = trimesh.Scene()
    for number, garment in enumerate(garments):
        _check(garment)
        smooth = vertex_normals(garment.vertices, garment.faces)
        for panel in panel_meshes(garment):
            material = trimesh.visual.material.PBRMaterial(
                name=panel.name,
                baseColorFactor=(*panel_colour(panel.number), 1.0),
                metallicFactor=0.0,
                roughnessFactor=0.9,
                doubleSided=True,
            )
            mesh = trimesh.Trimesh(
                vertices=garment.vertices[panel.corners],
                faces=panel.faces,
                vertex_normals=smooth[panel.corners],
                visual=trimesh.visual.TextureVisuals(
                    uv=garment.rest_positions[panel.used], material=material
                ),
                process=False,
            )
            root = f"garment{number}" if len(garments) > 1 else "garment"
            node = f"{root}/{panel.name}"
            scene.add_geometry(mesh, node_name=node, geom_name=node)
    if body is not None:
        vertices, faces = np.asarray(body[0], dtype=np.float64), np.asarray(body[1])
        material = trimesh.visual.material.PBRMaterial(
            name="body",
            baseColorFactor=(*BODY_COLOUR, 1.0),
            metallicFactor=0.0,
            roughnessFactor=0.8,
        )
        mesh = trimesh.Trimesh(
            vertices=vertices,
            faces=faces,
            vertex_normals=vertex_normals(vertices, faces),
            visual=trimesh.visual.TextureVisuals(material=material),
            process=False,
        )
        scene.add_geometry(mesh, node_name="body", geom_name="body")
    content = scene.export(file_type="glb", include_normals=True)
    with atomic_open(path, binary=True) as file:
        file.write(content)


class PanelMesh(NamedTuple):
    """A panel of a garment on its own: a vertex for each of its panel vertices.

    Texture may then jump at seams, while normals, taken from the whole garment, do not.

    Attributes:
        number, name: of the panel.
        used: panel vertices, (u,).
        corners: vertices of the garment at them, (u,).
        faces: triangles in these, (g, 3).
    """

    number: int
    name: str
    used: Int[np.ndarray, " u"]
    corners: Int[np.ndarray, " u"]
    faces: Int[np.ndarray, "g 3"]


def panel_meshes(garment: GarmentMesh) -> Iterator[PanelMesh]:
    """The panels that have a triangle."""
    for number, name in enumerate(garment.panels):
        members = garment.face_panels == number
        if not members.any():
            continue
        used, first, compact = np.unique(
            garment.rest_faces[members], return_index=True, return_inverse=True
        )
        corners = garment.faces[members].ravel()[first]
        yield PanelMesh(number, name, used, corners, compact.reshape(-1, 3))


def vertex_normals(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "n 3"]:
    """Area-weighted unit normals; +y where a vertex has no face of positive area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    doubled = np.cross(b - a, c - a)
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(doubled[:, k], 3), len(vertices)) for k in range(3)],
        axis=1,
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    empty = lengths == 0.0
    return np.where(empty, np.array([0.0, 1.0, 0.0]), sums / np.where(empty, 1.0, lengths))


def panel_colour(index: int) -> tuple[float, float, float]:
    """A colour per panel that differs clearly from its neighbours in number."""
    import colorsys

    # Golden-ratio steps around the colour circle never come close to repeating early.
    return colorsys.hsv_to_rgb((0.58 + 0.618034 * index) % 1.0, 0.45, 0.85)


def _rows(file: IO[Any], key: str, rows: np.ndarray) -> None:
    np.savetxt(file, np.asarray(rows, dtype=np.float64), fmt=key + " %.17g" * rows.shape[1])


def _check(garment: GarmentMesh) -> None:
    counts = {len(garment.faces), len(garment.rest_faces), len(garment.face_panels)}
    if len(counts) != 1:
        raise ValueError(f"faces, rest faces and face panels differ in number: {sorted(counts)}")
    if len(garment.face_panels) and not (
        garment.face_panels.min() >= 0 and garment.face_panels.max() < len(garment.panels)
    ):
        raise ValueError("a face belongs to a panel that has no name")
    for name in garment.panels:
        if not name or name != name.strip() or "\n" in name:
            raise ValueError(f"'{name}' cannot name a group: it must be one line without margins")
