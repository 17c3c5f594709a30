"""Static bodies from mesh files, checked before anything is draped on them."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.io.obj import read_obj

SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
# A person, baby to giant, in metres; anything else is taken for a wrong unit.
SMALLEST_HEIGHT = 0.5
LARGEST_HEIGHT = 2.5


def load_body_mesh(
    path: str | Path, *, scale: float = 1.0
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """A static body: welded, triangulated and in metres.

    Vertices that were split along texture seams are merged again, polygons become fans of
    triangles, vertices without faces are dropped. Axes are the world's: +y up.

    Args:
        path: OBJ, PLY, GLB, glTF, STL or OFF file.
        scale: factor from the file's unit to metres (0.01 for centimetres).

    Returns:
        Vertices [m], shape (n, 3), and triangles, shape (f, 3).

    Raises:
        InputError: the file is missing or broken, holds no faces or non-finite numbers, or its
            height is no person's; the message names the likely unit and the option to give.
    """
    path = Path(path)
    vertices, faces = read_surface(path)
    if len(faces) == 0:
        raise InputError(
            "holds no faces", where=str(path), mend="give a surface mesh, not a point cloud"
        )
    if not np.isfinite(vertices).all():
        bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
        raise InputError(
            f"vertex {bad} is not a finite number", where=str(path), mend="export the mesh again"
        )
    vertices, faces = _drop_unused(vertices * scale, faces)
    _check_height(vertices, where=str(path), scale=scale)
    if not _is_closed(faces):
        # Only then: a closed mesh may have coincident points on purpose (lips, fingers).
        vertices, faces = _weld(vertices, faces)
    return vertices, faces


def read_surface(
    path: str | Path,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """Vertices and triangles of a mesh file as they are, no triangles for a point cloud.

    Raises:
        InputError: the file is missing or broken, or of a format that is not read.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"'{suffix}' is not a mesh format that is read",
            where=str(path),
            mend=f"give one of {', '.join(SUFFIXES)}",
        )
    if not path.is_file():
        raise InputError("there is no such file", where=str(path), mend="check the path")
    if suffix == ".obj":
        contents = read_obj(path)
        return contents.vertices, contents.faces

    import trimesh  # slow to import, and only these formats need it

    try:
        mesh = trimesh.load(path, process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), dtype=np.int64)
    except Exception as error:  # trimesh raises whatever its readers happen to hit
        raise InputError(
            f"cannot be read as a mesh ({error})", where=str(path), mend="export the mesh again"
        ) from error
    return vertices, faces.reshape(-1, 3)


def _check_height(vertices: np.ndarray, *, where: str, scale: float) -> None:
    width, height, depth = np.ptp(vertices, axis=0)
    if SMALLEST_HEIGHT <= height <= LARGEST_HEIGHT:
        # A person stands taller than deep; arms may be wider than the height.
        if depth > 1.5 * height and SMALLEST_HEIGHT <= depth <= LARGEST_HEIGHT:
            raise InputError(
                f"the body is {depth:.2f} m along z but {height:.2f} m along y, so it seems to be "
                "z-up",
                where=where,
                mend="export it with +y up and +z to the front",
            )
        return
    largest = max(width, height, depth)
    if SMALLEST_HEIGHT <= depth <= LARGEST_HEIGHT and depth >= width * 0.8:
        problem = f"the body is {height:.3g} m tall along y and {depth:.3g} m along z"
        raise InputError(
            f"{problem}, so it seems to be z-up",
            where=where,
            mend="export it with +y up and +z to the front",
        )
    units = {"decimetres": 0.1, "inches": 0.0254, "centimetres": 0.01, "millimetres": 0.001}
    # The unit that brings the height nearest to a person of 1.7 m.
    name, factor = min(units.items(), key=lambda item: abs(np.log(height * item[1] / 1.7)))
    if height > 0 and SMALLEST_HEIGHT <= height * factor <= LARGEST_HEIGHT:
        raise InputError(
            f"the body is {height:.4g} m tall, so the file is likely in {name}",
            where=where,
            mend=f"pass scale={scale * factor:g}",
        )
    raise InputError(
        f"the body is {height:.4g} m tall (its largest extent is {largest:.4g} m), which is no "
        "person's height in any usual unit",
        where=where,
        mend="export it in metres with +y up",
    )


def _drop_unused(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, compact = np.unique(faces, return_inverse=True)
    return vertices[used], compact.reshape(faces.shape)


def _is_closed(faces: np.ndarray) -> bool:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts == 2).all())


def _weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge vertices of equal position (to a nanometre), keeping the order of first appearance."""
    _, first, labels = np.unique(
        np.round(vertices, 9), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    welded = rank[labels.ravel()][faces]
    distinct = (
        (welded[:, 0] != welded[:, 1])
        & (welded[:, 1] != welded[:, 2])
        & (welded[:, 2] != welded[:, 0])
    )
    return vertices[first[order]], welded[distinct]
