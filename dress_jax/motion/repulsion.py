"""Bodies free of self-intersection: the nearest one, by XPBD repulsion (S15.2, paper 7.2).

Skinning lets an arm sink into the trunk and folds the skin of a bent joint into itself. A field of
displacements d, as small and as smooth as it can be, takes the surface apart again: XPBD with

    d_i - d_j = 0   along edges          compliance a_e,
    d_i = 0         at vertices          compliance a_a,
    n.(x_v - x_q) >= gap                 rigid, for vertices and the faces that they have come near,

where only faces count that are much closer than in the rest pose and face the vertex: a finger's
front is always near its back. The sign of a distance is that of the face's normal, so a part may
be up to `depth` inside of another and still finds its way out on the side where it came in.

Folds that are left by then lie in a crease, where both sides are one patch of skin: there the patch
is smoothed, over ever wider rings. What remains is counted by the exact test and reported; this
simulator takes a body as a collider that only pushes outwards, and steps on in any case.
"""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.geometry.intersection import edge_face_intersections
from dress_jax.geometry.topology import neighbour_graph, neighbour_mean, unique_edges
from dress_jax.motion.repulsion_kernels import closest_contacts, near_pairs, relax, vertex_normals

_EDGE, _ANCHOR = 0.05, 3.0  # compliances of the displacement's differences, and of itself
_ITERATIONS = 12  # of XPBD between two looks at who is close
_STILL = 1e-4  # rounds end where no vertex moves further [m]
_CLOSER = 2.0  # a pair counts where its distance at rest is this many times larger
_REST_GAP = 0.25  # of the distance at rest: a gap that neighbours in a crease can have
_SMOOTHING = 4  # sweeps over a patch
_SMOOTHED = 14  # times that patches are smoothed, a ring wider every other time
_FARTHEST = 0.05  # that smoothing may take a vertex: beyond, a limb has lost its shape [m]


@dataclasses.dataclass(frozen=True)
class RepulsionOptions:
    """How far parts of the body are kept from each other.

    Attributes:
        gap: between parts that are apart in the rest pose [m]; room for cloth between them.
        depth: how deep a part may be inside of another [m].
        rounds: looks at who is close, at most.
    """

    gap: float = 0.006
    depth: float = 0.03
    rounds: int = 10

    def __post_init__(self) -> None:
        if not (0.0 <= self.gap < self.depth <= 0.1 and self.rounds >= 1):
            raise InputError(
                f"a gap of {self.gap} m, a depth of {self.depth} m, {self.rounds} rounds",
                where="repulsion of the body",
                mend="give a gap below the depth, a depth of at most 0.1 m, at least one round",
            )


@dataclasses.dataclass(frozen=True)
class Freed:
    """A body after repulsion.

    Attributes:
        vertices: [m], (n, 3).
        before, after: edges that meet faces with which they share no vertex, by the exact test.
        largest, mean: displacement [m]; the mean is over the vertices that moved by more than
            0.1 mm, 0 where none did.
        moved: number of these vertices.
    """

    vertices: Float[np.ndarray, "n 3"]
    before: int
    after: int
    largest: float
    mean: float
    moved: int


class Repulsion:
    """Frees the bodies of a motion, one after the other; each starts from the last displacement."""

    def __init__(
        self,
        rest: Float[np.ndarray, "n 3"],
        faces: Int[np.ndarray, "f 3"],
        options: RepulsionOptions | None = None,
    ):
        """Prepare for a body.

        Args:
            rest: a pose in which nothing meets, arms and legs apart [m].
            faces: triangles.
            options: see `RepulsionOptions`.
        """
        self._rest = np.asarray(rest, np.float64)
        self._faces = np.asarray(faces, np.int64)
        self._edges = unique_edges(self._faces)
        self._options = RepulsionOptions() if options is None else options
        self._graph = neighbour_graph(self._faces, len(self._rest))
        self._mean = neighbour_mean(self._graph)
        self.displacement = np.zeros_like(self._rest)

    def free(self, posed: Float[np.ndarray, "n 3"]) -> Freed:
        """The nearest body without self-intersection.

        Args:
            posed: as skinning made it [m].
        """
        posed = np.asarray(posed, np.float64)
        before = len(self._crossings(posed))
        x = posed + self._repelled(posed)
        crossings = self._crossings(x)
        best, left = x, len(crossings)
        for time in range(_SMOOTHED):
            if not len(crossings):
                break
            x = self._smoothed(x, crossings, rings=1 + time // 2)
            if np.max(np.abs(x - posed)) > _FARTHEST:
                break
            crossings = self._crossings(x)
            if len(crossings) < left:
                best, left = x, len(crossings)
        x = best
        self.displacement = x - posed
        length = np.linalg.norm(self.displacement, axis=1)
        moved = length > 1e-4
        return Freed(
            vertices=x,
            before=before,
            after=left,
            largest=float(length.max(initial=0.0)),
            mean=float(length[moved].mean()) if moved.any() else 0.0,
            moved=int(moved.sum()),
        )

    def _repelled(self, posed: np.ndarray) -> np.ndarray:
        """Displacements after XPBD."""
        d = self.displacement.copy()
        candidates = self._candidates(posed + d)
        if not len(candidates) and not d.any():
            return d
        for _ in range(self._options.rounds):
            begin = d.copy()
            normals = vertex_normals(posed + d, self._faces)
            contacts = closest_contacts(
                posed + d,
                self._faces,
                normals,
                candidates,
                self._rest,
                self._options.gap,
                self._options.depth,
                _CLOSER,
                _REST_GAP,
            )
            relax(d, posed, self._edges, *contacts, _ITERATIONS, _EDGE, _ANCHOR)
            if np.max(np.abs(d - begin)) < _STILL:
                break
        return d

    def _candidates(self, x: np.ndarray) -> np.ndarray:
        """Rows [vertex, face] that face each other, closer than at rest."""
        reach = self._options.depth + self._options.gap
        return near_pairs(x, self._faces, self._rest, reach=reach, closer=_CLOSER)

    def _crossings(self, x: np.ndarray) -> np.ndarray:
        return edge_face_intersections(x, self._edges, self._faces)

    def _smoothed(self, x: np.ndarray, crossings: np.ndarray, *, rings: int) -> np.ndarray:
        """Means of their neighbours for vertices around crossings."""
        inside = np.zeros(len(x), bool)
        inside[self._edges[crossings[:, 0]]] = True
        inside[self._faces[crossings[:, 1]]] = True
        for _ in range(rings - 1):
            inside |= self._graph @ inside.astype(float) > 0.0
        x = x.copy()
        for _ in range(_SMOOTHING):
            x[inside] = (self._mean @ x)[inside]
        return x
