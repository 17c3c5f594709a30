"""Panels become one welded surface around the body, without a crossing (S8.1, S8.2).

Panels stand around the body where the pattern file places them. The welded surface that lies as
close to them as a smooth surface can,

    min_x  sum_v M_v |x_v - p_v|^2 + l_v^4 |M^-1 (L x - b)|_v^2 M_v,

is one sparse linear solve (M masses and L cotangent Laplacian of the rest shape, p the placed
panels, b what L p is along edges that are not sewn: without it smoothing would squash the cloth at
its free edges). It passes through the seams without a crease, so panels that overlap as placed,
caps that reach into armholes and gathers that are wider than what they are sewn to cannot cross
there. Where it crosses itself all the same, the smoothing length l grows locally until it does not.

Some panels are placed so that this ends in knots (a circle skirt that lies on the sleeves, flounces
of two legs in one another), or so that the wearer's skeleton, around which the garment is to be,
leaves it for a few centimetres (a crotch that smoothing has lifted). Then p moves, a little further
in every round: outward where the skeleton pierces the surface, and where two sheets meet, apart, in
the direction from one sheet to the other as a whole; the normals of sheets that have run through
each other say nothing. Sheets of one place, a fold in itself, go back to where their surroundings
are.

Lengths of the joined surface are not those of the rest shape; the first relaxation of the cloth
restores them.
"""

import dataclasses

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from dress_jax.contact.broad_phase import find_candidates, make_collision_mesh
from dress_jax.geometry.harmonic import cotangent_laplacian
from dress_jax.geometry.intersection import edge_face_intersections
from dress_jax.geometry.topology import unique_edges

_FIRST_LENGTH = 0.03  # smoothing length to begin with [m], at least 1.5 edges
_EDGES = 1.5
_GROWTH = 1.35  # of the smoothing length where the surface is not free
_REACH = 0.08  # how far from a crossing it grows [m]
_ROUNDS = 16
_PUSH = 0.015  # per round [m]
_PUSH_ROUNDS = 40
_PIERCED_ROUNDS = 24  # of them with the skeleton outside: it must not take in a garment beside it
# Averages over the neighbours of a vertex: how far a push fades out, what is near a triangle, and
# which sheet it belongs to.
_FADING, _NEIGHBOURHOOD, _SHEET = 12, 40, 200
_ONE_PLACE = 0.03  # two sheets that are no further apart, on the whole, are one [m]


@dataclasses.dataclass(frozen=True)
class Surface:
    """One garment component: triangles twice, and where its panels stand.

    Attributes:
        faces: triangles in welded vertices, (f, 3).
        rest_faces: the same triangles in panel vertices, (f, 3).
        weld_map: welded vertex of every panel vertex; only those in `rest_faces` are read, (p,).
        rest_positions: panel coordinates [m], (p, 2).
        placed: panel vertices as the pattern file places them [m], (p, 3).
        vertex_count: number of welded vertices.
        edge_length: wanted edge length of the mesh [m].
    """

    faces: Int[np.ndarray, "f 3"]
    rest_faces: Int[np.ndarray, "f 3"]
    weld_map: Int[np.ndarray, " p"]
    rest_positions: Float[np.ndarray, "p 2"]
    placed: Float[np.ndarray, "p 3"]
    vertex_count: int
    edge_length: float


@dataclasses.dataclass(frozen=True)
class Joined:
    """A welded surface.

    Attributes:
        positions: vertices [m], (n, 3).
        crossed: triangles that still cross or nearly touch another one, (f,); none of them where
            joining succeeded.
        smoothing_length: the longest one used [m].
    """

    positions: Float[np.ndarray, "n 3"]
    crossed: Bool[np.ndarray, " f"]
    smoothing_length: float

    @property
    def free(self) -> bool:
        """Whether the surface is free of crossings."""
        return not self.crossed.any()


def join(
    surface: Surface,
    *,
    clearance: float,
    core: tuple[Float[np.ndarray, "c 3"], Int[np.ndarray, "k 3"]] | None = None,
) -> Joined:
    """The smooth welded surface near the placed panels, free of self-intersections if possible.

    Args:
        surface: the panels.
        clearance: distance that parts without a common vertex keep from each other [m]; where the
            surface is compressed that is much less than in its rest shape.
        core: vertices [m] and triangles of what the surface is to be around, thin; without one it
            is smoothed, but not pushed.

    Returns:
        The surface; its `crossed` tells where it could not be freed of itself. It may still be
        pierced by the core.
    """
    smoother, crossings = _Smoother(surface), _Crossings(surface, clearance, core)
    first = max(_FIRST_LENGTH, _EDGES * surface.edge_length)
    length = np.full(surface.vertex_count, first)
    for number in range(_ROUNDS):
        positions = smoother.solve(length)
        touched = crossings.with_itself(positions)
        if not touched.any() or number == _ROUNDS - 1:
            break
        distance, _ = cKDTree(positions[touched]).query(positions)
        length *= _GROWTH ** np.clip(1.5 - distance / _REACH, 0.0, 1.0)
    smoothed = Joined(positions, np.any(touched[surface.faces], axis=1), float(length.max()))
    if core is None or (smoothed.free and not len(crossings.with_core(positions))):
        return smoothed
    if not smoothed.free:
        length = first * smoother.sizes
    return _pushed(smoother, crossings, length) or smoothed


def _pushed(
    smoother: "_Smoother", crossings: "_Crossings", length: Float[np.ndarray, " n"]
) -> Joined | None:
    """The surface after it has been pushed free, or None where that does not free it."""
    faces = crossings.faces
    offset = np.zeros((len(length), 3))
    outside = 0
    for _ in range(_PUSH_ROUNDS):
        positions = smoother.solve(length, offset)
        touched = np.any(crossings.with_itself(positions)[faces], axis=1)
        pierced = np.zeros(len(faces), bool)
        pierced[crossings.with_core(positions)] = True
        if not (touched.any() or pierced.any()):
            return Joined(positions, touched, float(length.max()))
        outside += bool(pierced.any())
        if outside > _PIERCED_ROUNDS:
            return None
        wanted = np.where(
            pierced[:, None], crossings.outward(positions), crossings.apart(positions)
        )
        offset += _PUSH * crossings.spread(touched | pierced, wanted)
    return None


class _Crossings:
    """Where a surface meets itself, and what it is to be around."""

    def __init__(self, surface: Surface, clearance: float, core):
        self.faces, self._clearance = surface.faces, clearance
        self._mesh = make_collision_mesh(surface.faces, surface.vertex_count)
        self._edges = unique_edges(surface.faces)
        ends = np.concatenate([self._edges, self._edges[:, ::-1]])
        links = scipy.sparse.csr_matrix(
            (np.ones(len(ends)), (ends[:, 0], ends[:, 1])), 2 * (surface.vertex_count,)
        )
        self._mean = scipy.sparse.diags(1.0 / np.maximum(links.sum(axis=1).A1, 1.0)) @ links
        self._core, core_faces = (np.zeros((0, 3)), None) if core is None else core
        if core_faces is not None:
            self._core_faces = np.asarray(core_faces)
            self._core_edges = unique_edges(self._core_faces)
            self._tree = cKDTree(self._core)

    def with_itself(self, positions: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Vertices of crossing triangles, or of pairs closer than the clearance."""
        touched = np.zeros(len(positions), bool)
        crossings = edge_face_intersections(positions, self._edges, self.faces)
        touched[self._edges[crossings[:, 0]]] = True
        touched[self.faces[crossings[:, 1]]] = True
        for rows in find_candidates(self._mesh, positions, positions, self._clearance):
            touched[rows] = True
        return touched

    def with_core(self, positions: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " k"]:
        """Triangles that the core pierces, or that pierce it."""
        everything, n = np.concatenate([positions, self._core]), len(positions)
        through = edge_face_intersections(everything, self._core_edges + n, self.faces)[:, 1]
        edges = edge_face_intersections(everything, self._edges, self._core_faces + n)[:, 0]
        reached = np.zeros(n, bool)
        reached[self._edges[edges]] = True
        return np.union1d(through, np.flatnonzero(reached[self.faces].sum(axis=1) >= 2))

    def spread(
        self, moved: Bool[np.ndarray, " f"], directions: Float[np.ndarray, "f 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Directions of some triangles, fading out along the surface, at most 1 long."""
        corners = self.faces[moved]
        sums = np.zeros((len(self._mean.indptr) - 1, 4))
        for k in range(3):
            np.add.at(sums[:, :3], corners[:, k], directions[moved])
            np.add.at(sums[:, 3], corners[:, k], 1.0)
        sums /= np.maximum(sums[:, 3:], 1.0)
        for _ in range(_FADING):
            sums = self._mean @ sums
        weights = sums[:, 3:]
        return sums[:, :3] / np.maximum(weights.max(), 1e-12)

    def apart(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "f 3"]:
        """Unit vectors from the sheet that crosses each triangle to the triangle's own.

        Where both are in one place, or nothing crosses, back to what is near the triangle.
        """
        near = around = positions
        for number in range(_SHEET):
            around = self._mean @ around
            near = around if number + 1 == _NEIGHBOURHOOD else near
        crossings = edge_face_intersections(positions, self._edges, self.faces)
        edges, faces = self._edges[crossings[:, 0]], self.faces[crossings[:, 1]]
        away = around[edges].mean(axis=1) - around[faces].mean(axis=1)
        sums = np.zeros_like(positions)
        np.add.at(sums, edges, away[:, None])
        np.add.at(sums, faces, -away[:, None])
        apart = sums[self.faces].mean(axis=1)
        back = (near - positions)[self.faces].mean(axis=1)
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        return np.where(
            length > _ONE_PLACE,
            apart / np.maximum(length, _ONE_PLACE),
            back / np.maximum(np.linalg.norm(back, axis=1, keepdims=True), 1e-3),
        )

    def outward(self, positions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "f 3"]:
        """Unit normals, turned so that on the whole they point away from the core."""
        corners = positions[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        centres = corners.mean(axis=1)
        away = centres - self._core[self._tree.query(centres)[1]]
        sign = 1.0 if np.sum(normals * away) >= 0.0 else -1.0
        return sign * normals / np.linalg.norm(normals, axis=1, keepdims=True)


class _Smoother:
    """The sparse matrices of one surface.

    Attributes:
        sizes: of what is around each vertex, over the median, at most 1: where sheets are pushed,
            the tip of a needle must not be as stiff as a sleeve, or it grows to a multiple of its
            length, (n,).
    """

    def __init__(self, surface: Surface):
        self._count = surface.vertex_count
        weld, rest_faces = surface.weld_map, surface.rest_faces
        used = np.unique(rest_faces)
        compact = np.searchsorted(used, rest_faces)
        rest = surface.rest_positions[used]
        gather = scipy.sparse.csc_matrix(
            (np.ones(len(used)), (weld[used], np.arange(len(used)))), (self._count, len(used))
        )
        self._laplacian = gather @ cotangent_laplacian(rest, compact) @ gather.T
        corners = rest[compact]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        sixths = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 6.0
        mass = np.bincount(compact.ravel(), np.repeat(sixths, 3), len(used))
        self._mass = gather @ mass
        self.sizes = np.sqrt(np.minimum(self._mass / np.median(self._mass), 1.0))
        placed = surface.placed[used]
        self._wanted = gather @ (mass[:, None] * placed)
        self._flux = gather @ _free_edge_flux(placed, compact, weld[used])

    def solve(self, length: np.ndarray, offset: np.ndarray | None = None) -> np.ndarray:
        """Positions for smoothing lengths per vertex [m], the panels moved by an offset [m]."""
        bending = self._laplacian @ scipy.sparse.diags(length**4 / self._mass)
        matrix = (scipy.sparse.diags(self._mass) + bending @ self._laplacian).tocsc()
        factor = scipy.sparse.linalg.splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        wanted = self._wanted if offset is None else self._wanted + self._mass[:, None] * offset
        return factor.solve(wanted + bending @ self._flux)


def _free_edge_flux(
    placed: Float[np.ndarray, "q 3"], faces: Int[np.ndarray, "f 3"], weld: Int[np.ndarray, " q"]
) -> Float[np.ndarray, "q 3"]:
    """Laplacian times the placed panels, from edges that belong to one welded triangle only."""
    first, second = faces, np.roll(faces, -1, axis=1)
    low = np.minimum(weld[first], weld[second]).astype(np.int64)
    keys = (low << 32) | np.maximum(weld[first], weld[second])
    _, inverse, counts = np.unique(keys.ravel(), return_inverse=True, return_counts=True)
    free = counts[inverse].reshape(faces.shape) == 1
    i, j, k = first[free], second[free], np.roll(faces, -2, axis=1)[free]
    along, inward = placed[j] - placed[i], placed[k] - placed[i]
    squared = np.sum(along**2, axis=1, keepdims=True)
    inward = inward - np.sum(inward * along, axis=1, keepdims=True) / squared * along
    half = 0.5 * np.sqrt(squared) * inward / np.linalg.norm(inward, axis=1, keepdims=True)
    flux = np.zeros_like(placed)
    np.add.at(flux, i, -half)
    np.add.at(flux, j, -half)
    return flux
