"""Which vertex-face and edge-edge pairs can come within a radius during a linear motion.

Runs on the host. Box trees give the pairs whose boxes are close; a pair is kept unless its distance
half-way exceeds the radius by more than its parts can move towards each other. Every pair whose
distance can fall to `radius` at some time of the motion is returned, and nothing is ever dropped:
the output buffer grows until all pairs fit.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dress_jax.contact.bvh import Tree, build_tree, refit, swept_boxes
from dress_jax.core.errors import InputError
from dress_jax.core.native import compiled
from dress_jax.geometry.host_distance import edge_edge, point_triangle
from dress_jax.geometry.topology import unique_edges

# Of the squared radius that boxes are compared with: rounding must not lose a pair at the very
# radius.
ROUNDING = 1.0 + 1e-12


@dataclass(frozen=True)
class CollisionMesh:
    """Cloth and body primitives in one vertex numbering: cloth vertices first, then the body's.

    Attributes:
        n: number of vertices, cloth and body together.
        n_cloth: number of cloth vertices.
        cloth_vertices: cloth vertices that take part, shape (v, 1).
        cloth_edges: shape (e, 2).
        cloth_faces: shape (f, 3).
        body_vertices: shape (bv, 1).
        body_edges: shape (be, 2).
        body_faces: shape (bf, 3).
        weld_ids: primitives that share a weld id never collide, shape (n,).
    """

    n: int
    n_cloth: int
    cloth_vertices: Int[np.ndarray, "v 1"]
    cloth_edges: Int[np.ndarray, "e 2"]
    cloth_faces: Int[np.ndarray, "f 3"]
    body_vertices: Int[np.ndarray, "bv 1"]
    body_edges: Int[np.ndarray, "be 2"]
    body_faces: Int[np.ndarray, "bf 3"]
    weld_ids: Int[np.ndarray, "n"]


def make_collision_mesh(
    cloth_faces: Int[np.ndarray, "f 3"],
    n_cloth: int,
    body_faces: Int[np.ndarray, "bf 3"] | None = None,
    n_body: int = 0,
    weld_ids: Int[np.ndarray, "n"] | None = None,
    cloth_vertices: Int[np.ndarray, "v"] | None = None,
) -> CollisionMesh:
    """Collect the primitives that take part in contact.

    Args:
        cloth_faces: cloth vertex indices, shape (f, 3).
        n_cloth: number of cloth vertices.
        body_faces: body vertex indices, counted from 0 within the body, shape (bf, 3).
        n_body: number of body vertices.
        weld_ids: one id per vertex (cloth, then body); pairs whose primitives share an id are left
            out. Default: every vertex has its own.
        cloth_vertices: cloth vertices tested against faces; default those of `cloth_faces`.

    Raises:
        InputError: an index or an array length does not fit the number of vertices.
    """
    n = n_cloth + n_body
    cloth_faces = _checked(cloth_faces, n_cloth, "cloth_faces").reshape(-1, 3)
    body = np.zeros((0, 3), np.int32) if body_faces is None else body_faces
    body = _checked(body, n_body, "body_faces").reshape(-1, 3) + np.int32(n_cloth)
    if cloth_vertices is None:
        cloth_vertices = np.unique(cloth_faces)
    weld_ids = np.arange(n) if weld_ids is None else np.asarray(weld_ids)
    if weld_ids.shape != (n,):
        raise InputError(
            f"weld_ids have shape {weld_ids.shape}, expected ({n},)",
            mend="give one id per vertex, cloth first, then body",
        )
    return CollisionMesh(
        n=n,
        n_cloth=n_cloth,
        cloth_vertices=_checked(cloth_vertices, n_cloth, "cloth_vertices").reshape(-1, 1),
        cloth_edges=unique_edges(cloth_faces).astype(np.int32),
        cloth_faces=cloth_faces,
        body_vertices=np.unique(body).astype(np.int32).reshape(-1, 1),
        body_edges=unique_edges(body).astype(np.int32),
        body_faces=body,
        weld_ids=weld_ids.astype(np.int32),
    )


def _checked(indices: np.ndarray, n: int, name: str) -> np.ndarray:
    indices = np.asarray(indices)
    if indices.size and (indices.min() < 0 or indices.max() >= n):
        raise InputError(
            f"indices run from {indices.min()} to {indices.max()} but there are {n} vertices",
            where=name,
        )
    return np.ascontiguousarray(indices, np.int32)


@dataclass
class _FittedTree:
    """A box tree of one set of primitives with the boxes of the last motion."""

    primitives: np.ndarray
    tree: Tree
    leaf_boxes: np.ndarray
    node_boxes: np.ndarray

    def refit(self, start: np.ndarray, end: np.ndarray) -> None:
        swept_boxes(start, end, self.primitives, self.tree.order, self.leaf_boxes)
        refit(self.leaf_boxes, self.tree.first, self.tree.last, self.node_boxes)


def _fit(primitives: np.ndarray, positions: np.ndarray) -> _FittedTree:
    tree = build_tree(positions[primitives].mean(axis=1))
    return _FittedTree(
        primitives, tree, np.empty((len(primitives), 6)), np.empty((len(tree.first), 6))
    )


@dataclass
class BroadPhase:
    """Box trees of a mesh, kept between calls of `find_candidates`; made by `make_broad_phase`.

    The body's boxes are kept until it moves: pass `body_moved=False` where the caller knows that
    it did not.
    """

    mesh: CollisionMesh
    cloth: list[_FittedTree]
    body: list[_FittedTree]
    capacity: int = 1 << 16
    body_fitted: bool = False


def make_broad_phase(mesh: CollisionMesh, positions: Float[np.ndarray, "n 3"]) -> BroadPhase:
    """Build the trees of a mesh.

    Args:
        mesh: the primitives.
        positions: typical positions [m], shape (n, 3); they shape the trees, not the results.
    """
    positions = _positions(positions, mesh.n, "positions")
    return BroadPhase(
        mesh,
        cloth=[
            _fit(p, positions) for p in (mesh.cloth_vertices, mesh.cloth_edges, mesh.cloth_faces)
        ],
        body=[_fit(p, positions) for p in (mesh.body_vertices, mesh.body_edges, mesh.body_faces)],
    )


def _positions(array: np.ndarray, n: int, name: str) -> np.ndarray:
    array = np.ascontiguousarray(array, np.float64)
    if array.shape != (n, 3):
        raise InputError(f"shape {array.shape}, expected ({n}, 3)", where=name)
    if not np.isfinite(array).all():
        # A NaN would compare as "not near" to everything and its pairs would be lost.
        raise InputError("positions that are not finite", where=name)
    return array


def find_candidates(
    mesh: CollisionMesh | BroadPhase,
    start: Float[np.ndarray, "n 3"],
    end: Float[np.ndarray, "n 3"],
    radius: float | Float[np.ndarray, " n"],
    *,
    body_moved: bool = True,
) -> tuple[Int[np.ndarray, "m 4"], Int[np.ndarray, "k 4"]]:
    """Every pair that can come within `radius` while vertices move linearly from start to end.

    Vertex-face pairs: cloth with cloth, cloth vertices with body faces, body vertices with cloth
    faces. Edge-edge pairs: cloth with cloth (once), cloth with body. Pairs that share a weld id and
    pairs within the body are left out.

    Args:
        mesh: a mesh, or a `BroadPhase` that keeps its trees between calls.
        start: positions [m], shape (n, 3).
        end: positions [m], shape (n, 3).
        radius: distance [m], of all pairs or at each vertex; a pair has the smallest of its four.
        body_moved: False keeps the body's boxes of the previous call.

    Returns:
        Rows [vertex, face corners] and rows [edge a, edge b], sorted, int32.

    Raises:
        InputError: positions of the wrong shape or not finite, or a negative radius.
    """
    start = _positions(start, (mesh if isinstance(mesh, CollisionMesh) else mesh.mesh).n, "start")
    state = make_broad_phase(mesh, start) if isinstance(mesh, CollisionMesh) else mesh
    end = _positions(end, state.mesh.n, "end")
    radii = np.ascontiguousarray(np.broadcast_to(radius, state.mesh.n), np.float64)
    if not np.all(radii >= 0):
        raise InputError(f"radius is {radius}", mend="give distances of at least 0")
    for tree in state.cloth:
        tree.refit(start, end)
    if body_moved or not state.body_fitted:
        for tree in state.body:
            tree.refit(start, end)
        state.body_fitted = True
    (cv, ce, cf), (bv, be, bf) = state.cloth, state.body
    vertex_face = [
        _pairs(state, a, b, start, end, radii) for a, b in ((cv, cf), (cv, bf), (bv, cf))
    ]
    edge_edge = [_pairs(state, ce, b, start, end, radii) for b in (ce, be)]
    return np.concatenate(vertex_face), np.concatenate(edge_edge)


def _pairs(
    state: BroadPhase,
    a: _FittedTree,
    b: _FittedTree,
    start: np.ndarray,
    end: np.ndarray,
    radii: np.ndarray,
) -> np.ndarray:
    """Sorted rows of the close pairs of two sets of primitives; a is b: each pair once."""
    if not len(a.primitives) or not len(b.primitives):
        return np.zeros((0, 4), np.int32)
    while True:
        keys = np.empty(state.capacity, np.int64)
        count = _traverse(
            a.primitives,
            a.tree.order,
            a.leaf_boxes,
            b.primitives,
            b.tree.order,
            b.leaf_boxes,
            b.node_boxes,
            b.tree.first,
            b.tree.last,
            state.mesh.weld_ids,
            start,
            end,
            radii,
            a is b,
            keys,
        )
        if count <= len(keys):
            break
        state.capacity = count + count // 2
    keys = np.sort(keys[:count])
    return np.concatenate([a.primitives[keys >> 32], b.primitives[keys & 0xFFFFFFFF]], axis=1)


@compiled
def _traverse(
    primitives_a,
    order_a,
    boxes_a,
    primitives_b,
    order_b,
    boxes_b,
    node_boxes,
    first,
    last,
    weld_ids,
    start,
    end,
    radii,
    same,
    keys,
):
    """Count pairs within their radius; keys (row a << 32 | row b) go to `keys` while they fit.

    `same`: both sets are one, and each pair is reported with the smaller row first.
    """
    inner = first.shape[0] // 2
    stack = np.empty(64, np.int32)
    corners = np.empty(4, np.int32)
    sides = primitives_a.shape[1]
    count = 0
    for i in range(order_a.shape[0]):
        low0, low1, low2 = boxes_a[i, 0], boxes_a[i, 1], boxes_a[i, 2]
        high0, high1, high2 = boxes_a[i, 3], boxes_a[i, 4], boxes_a[i, 5]
        row_a = order_a[i]
        radius_a = np.inf
        for p in range(sides):
            corners[p] = primitives_a[row_a, p]
            radius_a = min(radius_a, radii[corners[p]])
        squared = radius_a * radius_a * ROUNDING
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            # Of one set, only later positions of the leaf order: each pair once.
            if same and last[node] <= i + 1:
                continue
            gap0 = max(0.0, max(node_boxes[node, 0] - high0, low0 - node_boxes[node, 3]))
            gap1 = max(0.0, max(node_boxes[node, 1] - high1, low1 - node_boxes[node, 4]))
            gap2 = max(0.0, max(node_boxes[node, 2] - high2, low2 - node_boxes[node, 5]))
            if gap0 * gap0 + gap1 * gap1 + gap2 * gap2 > squared:
                continue
            if node < inner:
                stack[top] = 2 * node + 2
                stack[top + 1] = 2 * node + 1
                top += 2
                continue
            for j in range(first[node], last[node]):
                if same and j <= i:
                    continue
                gap0 = max(0.0, max(boxes_b[j, 0] - high0, low0 - boxes_b[j, 3]))
                gap1 = max(0.0, max(boxes_b[j, 1] - high1, low1 - boxes_b[j, 4]))
                gap2 = max(0.0, max(boxes_b[j, 2] - high2, low2 - boxes_b[j, 5]))
                if gap0 * gap0 + gap1 * gap1 + gap2 * gap2 > squared:
                    continue
                row_b = order_b[j]
                welded = False
                radius = radius_a
                for q in range(primitives_b.shape[1]):
                    corner = primitives_b[row_b, q]
                    corners[sides + q] = corner
                    radius = min(radius, radii[corner])
                    for p in range(sides):
                        if weld_ids[corners[p]] == weld_ids[corner]:
                            welded = True
                # By the radius of the pair: its fate is not to depend on the order of leaves.
                beyond = gap0 * gap0 + gap1 * gap1 + gap2 * gap2 > radius * radius * ROUNDING
                if welded or beyond:
                    continue
                if _stays_apart(
                    start, end, corners[0], corners[1], corners[2], corners[3], sides == 1, radius
                ):
                    continue
                if count < keys.shape[0]:
                    low, high = np.int64(row_a), np.int64(row_b)
                    if same and low > high:
                        low, high = high, low
                    keys[count] = (low << 32) | high
                count += 1
    return count


@compiled
def _half_way(start, end, i):
    """Position of vertex i half-way; a tuple, because views of arrays cost reference counts."""
    return (
        0.5 * (start[i, 0] + end[i, 0]),
        0.5 * (start[i, 1] + end[i, 1]),
        0.5 * (start[i, 2] + end[i, 2]),
    )


@compiled
def _motion(start, end, i, mean):
    """Length of the displacement of vertex i less a mean displacement."""
    x = end[i, 0] - start[i, 0] - mean[0]
    y = end[i, 1] - start[i, 1] - mean[1]
    z = end[i, 2] - start[i, 2] - mean[2]
    return (x * x + y * y + z * z) ** 0.5


@compiled
def _stays_apart(start, end, i, j, k, m, is_vertex_face, radius):
    """Whether the distance half-way exceeds the radius by more than half of the relative motion."""
    a, b = _half_way(start, end, i), _half_way(start, end, j)
    c, d = _half_way(start, end, k), _half_way(start, end, m)
    # Displacement = 2 (half-way - start).
    mean = (
        0.5 * (a[0] + b[0] + c[0] + d[0] - start[i, 0] - start[j, 0] - start[k, 0] - start[m, 0]),
        0.5 * (a[1] + b[1] + c[1] + d[1] - start[i, 1] - start[j, 1] - start[k, 1] - start[m, 1]),
        0.5 * (a[2] + b[2] + c[2] + d[2] - start[i, 2] - start[j, 2] - start[k, 2] - start[m, 2]),
    )
    first, second = _motion(start, end, i, mean), _motion(start, end, j, mean)
    third, fourth = _motion(start, end, k, mean), _motion(start, end, m, mean)
    if is_vertex_face:
        squared = point_triangle(a, b, c, d)
        speed = first + max(second, third, fourth)
    else:
        squared = edge_edge(a, b, c, d)
        speed = max(first, second) + max(third, fourth)
    # The slack covers rounding of the distance, also of slivers.
    size = abs(b[0] - d[0]) + abs(b[1] - d[1]) + abs(b[2] - d[2])
    size += abs(c[0] - d[0]) + abs(c[1] - d[1]) + abs(c[2] - d[2])
    reach = radius + 0.5 * speed + 1e-7 * size
    return squared > reach * reach
