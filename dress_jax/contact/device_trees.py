"""Box trees of all primitives as arrays on the device, with boxes fitted by compiled code.

The topology is made once, on the host, by the median splits of `bvh`. Here every tree is complete
with one primitive in a leaf, or none: the number of its leaves is a power of two, a shape that
meshes of similar size share. The trees stand side by side, all nodes of one height together, so
that one level of boxes follows from the one below by a single reduction.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dress_jax.contact.broad_phase import CollisionMesh
from dress_jax.contact.bvh import build_tree
from dress_jax.core.components import split
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree, static

# A traversal begins with all pairs of nodes on this level of two trees. Above it there is not
# enough to do for a chunk of pairs.
_SEED_LEVEL = 6
# Keys of pairs have this many bits for each of their primitives.
ID_BITS = 30


@pytree
class Forest:
    """Topology of the trees; made by `plant`.

    Nodes are numbered by height: the p leaves first, then their parents, and so on. Positions of
    leaves, and ids of primitives, run through the trees of vertices, edges and faces in this order,
    in each of these kinds the cloth before the body.

    Attributes:
        leaf_ids: primitive in each leaf, -1 where there is none, (p,).
        leaf_corners: its vertices, the last one repeated where there are fewer than three, (3, p).
        corners: the same by the id of the primitive, (3, p).
        is_body: 1 for primitives of the body, by id, (p,).
        child: first child of each node, the other one follows it; 0 for leaves, (k,).
        first: positions of the leaves below a node are first to last - 1, (k,).
        last: see `first`, (k,).
        vertex_face_seeds: pairs of nodes above all vertex-face pairs, (2, s).
        edge_edge_seeds: pairs of nodes above all edge-edge pairs, (2, t).
        counts: number of nodes of each height.
        splits: from no seed does it take more splits of a node to get to a pair of leaves.
    """

    leaf_ids: Int[Array, " p"]
    leaf_corners: Int[Array, "3 p"]
    corners: Int[Array, "3 p"]
    is_body: Int[Array, " p"]
    child: Int[Array, " k"]
    first: Int[Array, " k"]
    last: Int[Array, " k"]
    vertex_face_seeds: Int[Array, "2 s"]
    edge_edge_seeds: Int[Array, "2 t"]
    counts: tuple[int, ...] = static()
    splits: int = static()


@pytree
class Boxes:
    """Boxes of all nodes around the motion of what is below them.

    Attributes:
        low: lower corners, a component in each row [m], (3, k).
        high: upper corners [m], (3, k).
        radius: the largest radius of a primitive below each node [m], -1 where there is none, (k,).
    """

    low: tuple[Float[Array, " k"], ...]
    high: tuple[Float[Array, " k"], ...]
    radius: Float[Array, " k"]


def plant(mesh: CollisionMesh, positions: Float[np.ndarray, "n 3"]) -> Forest:
    """Build the trees of a mesh and put them on the device.

    Args:
        mesh: the primitives.
        positions: typical positions [m], shape (n, 3); they shape the trees, not the results.

    Raises:
        InputError: there are more primitives than keys have bits for.
    """
    kinds = [
        mesh.cloth_vertices,
        mesh.body_vertices,
        mesh.cloth_edges,
        mesh.body_edges,
        mesh.cloth_faces,
        mesh.body_faces,
    ]
    depths = [max(len(primitives) - 1, 0).bit_length() for primitives in kinds]
    leaves = [1 << depth for depth in depths]
    bases = np.cumsum([0, *leaves])
    if bases[-1] >= 1 << ID_BITS:
        raise InputError(
            f"{sum(map(len, kinds))} primitives are too many for the broad phase on the device",
            mend='use the broad phase "trees"',
        )
    rows = np.zeros((3, bases[-1]), np.int32)
    orders, leaf_corners = [], []
    for primitives, depth, base in zip(kinds, depths, bases[:-1], strict=True):
        count, sides = primitives.shape
        corners = primitives.T[[min(k, sides - 1) for k in range(3)]]
        rows[:, base : base + count] = corners
        order = np.full(1 << depth, -1)
        if count:
            tree = build_tree(positions[primitives].mean(axis=1), depth=depth)
            inner = (1 << depth) - 1
            filled = tree.last[inner:] > tree.first[inner:]
            order[filled] = base + tree.order[tree.first[inner:][filled]]
        orders.append(order)
        leaf_corners.append(rows[:, np.maximum(order, 0)])
    # The deepest trees first: on every height those that go on are the first ones.
    layout = sorted(range(len(kinds)), key=lambda tree: -depths[tree])
    starts, counts = _heights(depths, layout)
    nodes = _nodes(depths, bases, layout, starts)
    vertices, edges, faces = (0, 1), (2, 3), (4, 5)
    vertex_face = [(vertices[0], faces[0]), (vertices[0], faces[1]), (vertices[1], faces[0])]
    edge_edge = [(edges[0], edges[0]), (edges[0], edges[1])]
    below = [max(depth - _SEED_LEVEL, 0) for depth in depths]
    return Forest(
        leaf_ids=_int32(np.concatenate([orders[tree] for tree in layout])),
        leaf_corners=_int32(np.concatenate([leaf_corners[tree] for tree in layout], axis=1)),
        corners=_int32(rows),
        is_body=_int32(np.repeat([0, 1, 0, 1, 0, 1], leaves)),
        child=_int32(nodes[0]),
        first=_int32(nodes[1]),
        last=_int32(nodes[2]),
        vertex_face_seeds=_seeds(vertex_face, depths, below, starts),
        edge_edge_seeds=_seeds(edge_edge, depths, below, starts),
        counts=counts,
        splits=max(below[a] + below[b] for a, b in (*vertex_face, *edge_edge)),
    )


def _int32(array: np.ndarray) -> Int[Array, "..."]:
    return jnp.asarray(array, jnp.int32)


def _heights(
    depths: list[int], layout: list[int]
) -> tuple[dict[tuple[int, int], int], tuple[int, ...]]:
    """The first node of each tree and height, and the number of nodes of each height."""
    starts, counts, node = {}, [], 0
    for height in range(max(depths) + 1):
        begin = node
        for tree in layout:
            if depths[tree] >= height:
                starts[tree, height] = node
                node += 1 << (depths[tree] - height)
        counts.append(node - begin)
    return starts, tuple(counts)


def _nodes(
    depths: list[int], bases: np.ndarray, layout: list[int], starts: dict[tuple[int, int], int]
) -> np.ndarray:
    """First child, first position and end of the positions of each node, (3, k)."""
    columns = []
    for height in range(max(depths) + 1):
        for tree in layout:
            if depths[tree] < height:
                continue
            k = np.arange(1 << (depths[tree] - height))
            child = starts[tree, height - 1] + 2 * k if height else 0 * k
            first = bases[tree] + (k << height)
            columns.append(np.stack([child, first, first + (1 << height)]))
    return np.concatenate(columns, axis=1)


def _seeds(
    pairs: list[tuple[int, int]],
    depths: list[int],
    below: list[int],
    starts: dict[tuple[int, int], int],
) -> Int[Array, "2 s"]:
    """All pairs of nodes of two trees at the seed level, or of leaves where it is not reached."""
    columns = []
    for pair in pairs:
        nodes = [
            starts[tree, below[tree]] + np.arange(1 << (depths[tree] - below[tree]))
            for tree in pair
        ]
        columns.append([part.ravel() for part in np.meshgrid(*nodes, indexing="ij")])
    return _int32(np.concatenate(columns, axis=1))


@jax.jit
def fit(
    forest: Forest,
    start: Float[Array, "n 3"],
    end: Float[Array, "n 3"],
    radii: Float[Array, " n"],
) -> tuple[Boxes, Bool[Array, "3"]]:
    """Boxes around a linear motion, and whether start, end and radii are sound numbers.

    A NaN compares as "not near" to everything and its pairs would be lost: the caller has to look.

    Args:
        forest: the trees.
        start: positions [m], shape (n, 3).
        end: positions [m], shape (n, 3).
        radii: at the vertices [m], shape (n,).
    """
    filled = forest.leaf_ids >= 0
    a, b, c = (forest.leaf_corners[k] for k in range(3))
    low, high = [], []
    for x, y in zip(split(start), split(end), strict=True):
        least, most = jnp.minimum(x, y), jnp.maximum(x, y)
        least = jnp.minimum(jnp.minimum(least[a], least[b]), least[c])
        most = jnp.maximum(jnp.maximum(most[a], most[b]), most[c])
        low.append(_upwards(jnp.where(filled, least, jnp.inf), jnp.minimum, forest.counts))
        high.append(_upwards(jnp.where(filled, most, -jnp.inf), jnp.maximum, forest.counts))
    radius = jnp.minimum(jnp.minimum(radii[a], radii[b]), radii[c])
    radius = _upwards(jnp.where(filled, radius, -1.0), jnp.maximum, forest.counts)
    sound = jnp.stack(
        [jnp.all(jnp.isfinite(start)), jnp.all(jnp.isfinite(end)), jnp.all(radii >= 0.0)]
    )
    return Boxes(tuple(low), tuple(high), radius), sound


def _upwards(leaves: Array, reduction, counts: tuple[int, ...]) -> Array:
    """Values of all nodes from those of the leaves."""
    levels = [leaves]
    for count in counts[1:]:
        below = levels[-1][: 2 * count]
        levels.append(reduction(below[0::2], below[1::2]))
    return jnp.concatenate(levels)
