"""Meshes as the renderer wants them: twin half-edges, vertex normals, a scene of two meshes.

Half-edge `3 f + k` is edge k of face f and runs from its vertex k to its vertex (k + 1) % 3.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree


@pytree
class RenderMesh:
    """A triangle mesh with one row of attributes per vertex.

    Args:
        positions: vertex positions [m], shape (n, 3).
        faces: vertex indices, shape (f, 3).
        adjacency: twin half-edges from `build_adjacency`, shape (f, 3).
        colors: RGB in [0, 1], shape (n, 3).
        attributes: any further channels, shape (n, c); they are antialiased like the colours.
    """

    positions: Float[Array, "n 3"]
    faces: Int[Array, "f 3"]
    adjacency: Int[Array, "f 3"]
    colors: Float[Array, "n 3"]
    attributes: Float[Array, "n c"]


def build_adjacency(
    faces: Num[np.ndarray, "f 3"], weld_map: Num[np.ndarray, "n"] | None = None
) -> Int[np.ndarray, "f 3"]:
    """The half-edge on the other side of every edge, or -1 at a boundary. Host numpy.

    Faces need no common orientation. An edge of more than two faces counts as a boundary of each.

    Args:
        faces: vertex indices, shape (f, 3).
        weld_map: joint index of every vertex, shape (n,). Vertices that share one are the two sides
            of a seam: connected here, while each keeps its position. None welds nothing.

    Returns:
        Twin half-edge of edge k of face f at [f, k], shape (f, 3), int32.

    Raises:
        InputError: wrong shape, or a face names a vertex outside the weld map.
    """
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"faces have shape {faces.shape}, not (f, 3)", where="build_adjacency")
    joint = faces.astype(np.int64)
    if faces.size and joint.min() < 0:
        raise InputError("a face has a negative vertex index", where="build_adjacency")
    if weld_map is not None:
        if faces.size and joint.max() >= len(weld_map):
            raise InputError(
                f"a face names vertex {joint.max()} of a weld map of {len(weld_map)}",
                where="build_adjacency",
            )
        joint = np.asarray(weld_map, dtype=np.int64)[joint]
    start, end = joint.reshape(-1), np.roll(joint, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    # A run of exactly two equal edges is an interior edge; zero-length edges have no other side.
    before = np.concatenate([[False], same[:-1]]) if len(same) else same
    after = np.concatenate([same[1:], [False]]) if len(same) else same
    pair = same & ~before & ~after & (low[order][1:] != high[order][1:])
    twin = np.full(3 * len(faces), -1, dtype=np.int32)
    first, second = order[:-1][pair], order[1:][pair]
    twin[first], twin[second] = second, first
    return twin.reshape(-1, 3)


def make_render_mesh(
    positions: Float[Array, "n 3"],
    faces: Num[np.ndarray, "f 3"],
    *,
    colors: Float[Array, "n 3"] | None = None,
    attributes: Float[Array, "n c"] | None = None,
    weld_map: Num[np.ndarray, "n"] | None = None,
) -> RenderMesh:
    """A `RenderMesh` with its adjacency; checked once, here on the host.

    Args:
        positions: vertex positions [m], shape (n, 3).
        faces: vertex indices, shape (f, 3).
        colors: RGB per vertex, shape (n, 3); white when None.
        attributes: further channels, shape (n, c); none when None.
        weld_map: see `build_adjacency`.

    Raises:
        InputError: shapes disagree, or a face names a vertex that does not exist.
    """
    positions = jnp.asarray(positions)
    faces = np.asarray(faces)
    count = len(positions)
    colors = jnp.ones((count, 3), positions.dtype) if colors is None else jnp.asarray(colors)
    if attributes is None:
        attributes = jnp.zeros((count, 0), positions.dtype)
    attributes = jnp.asarray(attributes)
    for name, array, shape in (
        ("positions", positions, (count, 3)),
        ("colors", colors, (count, 3)),
        ("attributes", attributes, (count, *attributes.shape[1:2])),
    ):
        if array.shape != shape:
            raise InputError(
                f"{name} have shape {array.shape}, not {shape}", where="make_render_mesh"
            )
    if faces.size and int(faces.max()) >= count:
        raise InputError(
            f"a face names vertex {faces.max()} of {count} vertices", where="make_render_mesh"
        )
    adjacency = build_adjacency(faces, weld_map)
    return RenderMesh(
        positions=positions,
        faces=jnp.asarray(faces, dtype=jnp.int32),
        adjacency=jnp.asarray(adjacency),
        colors=colors,
        attributes=attributes,
    )


def vertex_normals(positions: Float[Array, "n 3"], faces: Int[Array, "f 3"]) -> Float[Array, "n 3"]:
    """Area-weighted unit vertex normals; zero at vertices whose faces have no area.

    Args:
        positions: vertex positions [m], shape (n, 3).
        faces: vertex indices, shape (f, 3).

    Returns:
        Unit normals on the side from which the faces run counter-clockwise, shape (n, 3).
    """
    corner = positions[faces]
    area = jnp.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = jnp.zeros_like(positions)
    for k in range(3):
        total = total.at[faces[:, k]].add(area)
    return unit_rows(total)


def unit_rows(vectors: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Every row divided by its length; zero rows stay zero and have a zero derivative."""
    squared = jnp.sum(vectors * vectors, axis=-1, keepdims=True)
    some = squared > 0
    return jnp.where(some, vectors * jax.lax.rsqrt(jnp.where(some, squared, 1.0)), 0.0)


def join_meshes(
    first: RenderMesh, second: RenderMesh | None
) -> tuple[Float[Array, "n 3"], Int[Array, "f 3"], Int[Array, "f 3"]]:
    """Positions, faces and adjacency of two meshes seen as one; the first keeps its indices."""
    if second is None:
        return first.positions, first.faces, first.adjacency
    vertex_offset = first.positions.shape[0]
    edge_offset = 3 * first.faces.shape[0]
    moved = jnp.where(second.adjacency >= 0, second.adjacency + edge_offset, -1)
    return (
        jnp.concatenate([first.positions, second.positions.astype(first.positions.dtype)]),
        jnp.concatenate([first.faces, second.faces + vertex_offset]),
        jnp.concatenate([first.adjacency, moved]),
    )
