"""What rides on a moving body: pins, and the cloth that lies on it (S8.7, S15.1)."""

import dataclasses

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from dress_jax.geometry.nearest import barycentric, nearest_on_surface
from dress_jax.geometry.topology import neighbour_graph, neighbour_mean

# Cloth closer than this goes with the body beneath it [m]; the rest follows its neighbours.
_NEAR = 0.008
# Length over which cloth that hangs free passes from its neighbours' motion to that of the body as
# a whole, and sweeps that spread the motion along the mesh [m].
_SPREAD, _SWEEPS = 0.10, 40


@dataclasses.dataclass(frozen=True)
class Riders:
    """Points fixed to the triangles of a body; made by `make_riders`.

    Args:
        corners: of the triangle that each point rides on, (k, 3).
        weights: barycentric coordinates of the point below it, (k, 3).
        offsets: from there to the point, along a side of the triangle, across it in its plane, and
            along its normal [m], (k, 3).
    """

    corners: Int[np.ndarray, "k 3"]
    weights: Float[np.ndarray, "k 3"]
    offsets: Float[np.ndarray, "k 3"]

    def places(self, body: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "k 3"]:
        """Where the points are on a body of the same triangles [m]."""
        triangles = body[self.corners]
        below = np.einsum("kc,kcd->kd", self.weights, triangles)
        return below + np.einsum("kd,kde->ke", self.offsets, _frames(triangles))


def make_riders(
    points: Float[np.ndarray, "k 3"],
    body: Float[np.ndarray, "b 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Riders:
    """Fix points to the nearest triangle of a body.

    Args:
        points: [m].
        body, faces: the body [m].
    """
    if not len(points):
        empty = np.zeros((0, 3))
        return Riders(np.zeros((0, 3), np.int64), empty, empty)
    found = nearest_on_surface(points, body[faces])
    triangles = body[faces[found.triangle]]
    offsets = np.einsum("ked,kd->ke", _frames(triangles), points - found.point)
    return Riders(faces[found.triangle], barycentric(found.point, triangles), offsets)


def _frames(triangles: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3 3"]:
    """Rows: along the first side, across it, along the normal; of triangles that have an area."""
    side = triangles[:, 1] - triangles[:, 0]
    normal = np.cross(side, triangles[:, 2] - triangles[:, 0])
    side = side / np.linalg.norm(side, axis=1, keepdims=True)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([side, np.cross(normal, side), normal], axis=1)


class Carrier:
    """Says how cloth goes along with a body that moves, as the start of a step.

    Cloth on the body moves exactly as the body beneath it, so that what is left of its motion in
    the step is slip. The rest of the cloth follows its neighbours, and far from the body the body's
    rigid motion.
    """

    def __init__(
        self, faces: Int[np.ndarray, "f 3"], body_faces: Int[np.ndarray, "k 3"], edge_length: float
    ):
        """Prepare.

        Args:
            faces: of the cloth.
            body_faces: of the body.
            edge_length: typical, of the cloth [m].
        """
        self._body_faces = np.asarray(body_faces)
        self._mean = neighbour_mean(neighbour_graph(faces, int(np.max(faces)) + 1))
        self._pull = (edge_length / _SPREAD) ** 2
        self._around = _incident(self._body_faces)

    def motion(
        self,
        cloth: Float[np.ndarray, "n 3"],
        before: Float[np.ndarray, "b 3"],
        after: Float[np.ndarray, "b 3"],
    ) -> Float[np.ndarray, "n 3"]:
        """How the cloth goes along while the body moves [m].

        Args:
            cloth: positions [m].
            before, after: the body [m].
        """
        moved = after - before
        corners, weights, distance = self._below(cloth, before)
        on_body = np.einsum("nc,ncd->nd", weights, moved[corners])
        turn, shift = _rigid(before, after)
        whole = cloth @ turn.T + shift - cloth
        held = (distance < _NEAR)[:, None]
        # Spread what differs from the rigid motion, which so stays what it is far out and at edges.
        known = np.where(held, on_body - whole, 0.0)
        differs = known
        for _ in range(_SWEEPS):
            differs = np.where(held, known, (self._mean @ differs) / (1.0 + self._pull))
        return whole + differs

    def _below(self, cloth: np.ndarray, body: np.ndarray):
        """Corners and weights of the body's point below each vertex, and the distance to it.

        Of the triangles around the nearest vertex of the body; the nearest of all may be another
        one where a body's triangles are long, and then the cloth goes with its neighbour.
        """
        _, nearest = cKDTree(body).query(cloth)
        around = self._around[nearest]
        used = np.flatnonzero(around.ravel() >= 0)
        rows = np.repeat(np.arange(len(cloth)), around.shape[1])[used]
        chosen = around.ravel()[used]
        triangles = body[self._body_faces[chosen]]
        points = trimesh.triangles.closest_point(triangles, cloth[rows])
        squared = np.full(around.size, np.inf)
        squared[used] = np.sum((points - cloth[rows]) ** 2, axis=1)
        squared = squared.reshape(around.shape)
        best = np.argmin(squared, axis=1)
        every = np.arange(len(cloth))
        place = np.empty((around.size, 3))
        place[used] = points
        place = place.reshape(*around.shape, 3)[every, best]
        corners = self._body_faces[around[every, best]]
        weights = barycentric(place, body[corners])
        return corners, weights, np.sqrt(squared[every, best])


def _incident(faces: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, "b most"]:
    """Triangles around each vertex, -1 where there are fewer; the first one where there is none."""
    count = int(faces.max()) + 1
    order = np.argsort(faces.ravel(), kind="stable")
    vertex = faces.ravel()[order]
    first = np.searchsorted(vertex, np.arange(count))
    number = np.arange(len(vertex)) - first[vertex]
    table = np.full((count, int(number.max()) + 1), -1, np.int64)
    table[vertex, number] = order // 3
    table[table[:, 0] < 0, 0] = 0
    return table


def _rigid(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation and shift that take one shape closest to another: x -> R x + t."""
    middle, there = before.mean(axis=0), after.mean(axis=0)
    u, _, vt = np.linalg.svd((after - there).T @ (before - middle))
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = u @ sign @ vt
    return turn, there - turn @ middle
