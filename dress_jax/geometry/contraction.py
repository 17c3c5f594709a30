"""Shrink a closed body surface onto its curve skeleton, so that cloth can start outside it.

Panels are placed around a body with little room to spare. Draping therefore starts around a thin
body, and the body grows back as a moving boundary (checklist S8.1, S8.7): its vertices move in
straight lines between the surface and their points of the skeleton.

The skeleton comes from two ideas, one sparse solve each:

1. a geodesic field d from the highest point (heat method: a heat solve, then a Poisson solve). Its
   level sets are rings around the head, torso, arms, legs and fingers;
2. diffusion of the coordinates *along the rings only*:

       min_T  int |T - X|^2 + kappa |grad T . u|^2,     u = tangent of the level sets of d,

   so every ring collapses to its own centroid while nothing pulls along the limb. Mean-curvature
   flow would thin a wrist long before a waist and shorten every limb; this does neither.

`kappa` is a multiple of the squared local radius, found by repeating the solve: thick and thin
parts then collapse by the same factor. Linear interpolation between surface and skeleton thins
monotonically.

Rings seen from the crown run askew over shoulders and hips, and their centroids leave the body
below the armpits and the crotch. So every limb gets a second field, from its own tip: there the
rings run around the limb, up to the armhole or the leg opening, and lead into the joint.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from dress_jax.geometry.limbs import Limb, find_branches, make_limb

# A ring of radius r is collapsed to about 1 / (1 + RING_STRENGTH) of it; larger values also
# straighten the skeleton, because a piecewise linear map cannot bend without varying along rings.
RING_STRENGTH = 15.0
# First guess of kappa [m^2 per squared body height]; the local radius replaces it.
FIRST_KAPPA = 0.17
PASSES = 3
# Heat time in squared mean edge lengths: smooth level sets on irregular triangles.
HEAT_TIME = 25.0
# The skeleton of a limb passes into that of the trunk over this length, relative to the height.
JOINT_BAND = 0.05
# Length of the pieces of a limb's curve, relative to the height.
CURVE_PIECE = 0.006
# Points closer than this, relative to the height, are one point (texture seams split vertices).
MERGE_TOLERANCE = 1e-7


@dataclass(frozen=True)
class CurveSkeleton:
    """The curves inside a body that its surface shrinks to.

    Attributes:
        targets: the point of the skeleton that each vertex shrinks to [m], shape (n, 3).
        limbs: arms and legs with their curves; none where the body does not branch like a person.
    """

    targets: Float[np.ndarray, "n 3"]
    limbs: tuple[Limb, ...]


def curve_skeleton(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> CurveSkeleton:
    """The curve skeleton of a closed surface.

    Args:
        vertices: body vertices [m], shape (n, 3). Vertices split along texture seams are welded
            for the solve.
        faces: triangles, shape (f, 3). Further components (eyeballs) follow the nearest vertex of
            the largest one.
        up: direction whose highest vertex (the crown) starts the geodesic field.

    Raises:
        ValueError: there are no faces of positive area, or a vertex is not finite.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(faces)
    if not np.isfinite(vertices).all():
        raise ValueError("the body has vertices that are not finite numbers")
    height = float(np.ptp(vertices @ np.asarray(up, dtype=np.float64)))
    welded, weld_map = _weld(vertices, tolerance=MERGE_TOLERANCE * height)
    faces = weld_map[faces]
    faces = faces[_doubled_areas(welded, faces) > 1e-14 * height**2]
    if len(faces) == 0:
        raise ValueError("the body has no triangle of positive area")

    used, compact = _largest_component(len(welded), faces)
    points = welded[used]
    nearest = _nearest_used(welded, used)
    own, limbs = _skeleton(points, compact, up=np.asarray(up), height=height)

    # Whatever is not part of the main surface moves along with the nearest point of it.
    targets = welded + (own - points)[nearest]
    targets[used] = own
    pick = nearest[weld_map]
    return CurveSkeleton(
        targets[weld_map],
        tuple(replace(limb, part=limb.part[pick], along=limb.along[pick]) for limb in limbs),
    )


def _nearest_used(points: np.ndarray, used: np.ndarray) -> np.ndarray:
    """For every point its place in `used`, or that of the nearest used point."""
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    rest = np.flatnonzero(place < 0)
    if len(rest):
        place[rest] = cKDTree(points[used]).query(points[rest])[1]
    return place


def _skeleton(
    points: np.ndarray, faces: np.ndarray, *, up: np.ndarray, height: float
) -> tuple[np.ndarray, tuple[Limb, ...]]:
    """Skeleton points of one connected surface, and its limbs."""
    surface = _surface(points, faces)
    distance = _geodesic_field(surface, int(np.argmax(points @ up)))
    targets = _collapse_rings(surface, distance, height=height)
    limbs = []
    for branch in find_branches(points, faces, distance):
        from_tip = _geodesic_field(surface, branch.tip)
        own = _collapse_rings(surface, from_tip, height=height)
        along = from_tip[branch.fork] - from_tip
        share = np.clip(1.0 + along / (JOINT_BAND * height), 0.0, 1.0)[:, None]
        targets = (1.0 - share) * targets + share * own
        limbs.append(make_limb(branch.kind, along, own, piece=CURVE_PIECE * height))
    return targets, tuple(limbs)


def _weld(vertices: np.ndarray, *, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge coincident points; returns the points and the map from old to new indices."""
    pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    graph = sparse.coo_array(
        (np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2
    )
    _, labels = csgraph.connected_components(graph, directed=False)
    _, first, weld_map = np.unique(labels, return_index=True, return_inverse=True)
    return vertices[first], weld_map


def _largest_component(count: int, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertex indices of the component with most faces, and its faces in those."""
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = sparse.coo_array(
        (np.ones(len(edges), dtype=bool), (edges[:, 0], edges[:, 1])), shape=(count, count)
    )
    _, labels = csgraph.connected_components(graph, directed=False)
    face_labels = labels[faces[:, 0]]
    kept = faces[face_labels == np.bincount(face_labels).argmax()]
    used, compact = np.unique(kept, return_inverse=True)
    return used, compact.reshape(kept.shape)


def _doubled_areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


@dataclass(frozen=True)
class _Surface:
    """A triangle mesh with its finite-element matrices."""

    points: np.ndarray
    faces: np.ndarray
    gradients: np.ndarray
    areas: np.ndarray
    normals: np.ndarray
    masses: np.ndarray
    stiffness: sparse.csc_array

    def assemble(self, blocks: np.ndarray) -> sparse.csc_array:
        """The matrix of one 3x3 block per face."""
        rows = np.repeat(self.faces, 3, axis=1).ravel()
        columns = np.tile(self.faces, (1, 3)).ravel()
        count = len(self.points)
        return sparse.coo_array((blocks.ravel(), (rows, columns)), shape=(count, count)).tocsc()


def _surface(points: np.ndarray, faces: np.ndarray) -> _Surface:
    gradients, areas, normals = _hat_gradients(points, faces)
    masses = np.bincount(faces.ravel(), np.repeat(areas / 3.0, 3), len(points))
    bare = _Surface(points, faces, gradients, areas, normals, masses, sparse.csc_array((0, 0)))
    blocks = np.einsum("fik,fjk->fij", gradients, gradients) * areas[:, None, None]
    return replace(bare, stiffness=bare.assemble(blocks))


def _collapse_rings(surface: _Surface, distance: np.ndarray, *, height: float) -> np.ndarray:
    """Every point's place after its level set of `distance` has shrunk to its centroid."""
    faces, masses, points = surface.faces, surface.masses, surface.points
    slope = _unit(np.einsum("fik,fi->fk", surface.gradients, distance[faces]))
    along_ring = np.einsum("fik,fk->fi", surface.gradients, np.cross(surface.normals, slope))
    ring_blocks = along_ring[:, :, None] * along_ring[:, None, :] * surface.areas[:, None, None]
    mass = sparse.diags_array(masses).tocsc()

    # kappa carries the squared mesh height so that the result does not depend on the unit.
    kappa = np.full(len(faces), FIRST_KAPPA * height**2)
    smallest = (3e-3 * height) ** 2
    targets = points
    for _ in range(PASSES):
        smoother = _factorize(mass + surface.assemble(ring_blocks * kappa[:, None, None]))
        targets = smoother(masses[:, None] * points)
        # Averaged along the ring: a ring has one radius, however near its flat side is.
        radius_squared = smoother(masses * ((points - targets) ** 2).sum(axis=1))
        kappa = RING_STRENGTH * np.maximum(radius_squared[faces].mean(axis=1), smallest)
    return targets


def _geodesic_field(surface: _Surface, source: int) -> np.ndarray:
    """Distance from `source` along the surface by the heat method (Crane et al. 2013)."""
    faces, gradients, areas = surface.faces, surface.gradients, surface.areas
    count = len(surface.masses)
    mass = sparse.diags_array(surface.masses).tocsc()
    impulse = np.zeros(count)
    impulse[source] = 1.0
    heat = _factorize(mass + HEAT_TIME * 2.0 * areas.mean() * surface.stiffness)(impulse)
    # The gradient of log(heat) points like that of heat and does not underflow on far triangles.
    log_heat = np.log(np.maximum(heat, np.finfo(np.float64).tiny))
    flow = -_unit(np.einsum("fik,fi->fk", gradients, log_heat[faces]))
    divergence = np.bincount(
        faces.ravel(),
        (np.einsum("fik,fk->fi", gradients, flow) * areas[:, None]).ravel(),
        count,
    )
    # The constant null space is removed by a multiple of the mass too small to bend the field.
    shift = 1e-8 * areas.sum() ** -1
    distance = _factorize(surface.stiffness + shift * mass)(divergence)
    return distance - distance[source]


def _hat_gradients(
    points: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradients of the three linear basis functions (f, 3, 3), areas (f,), unit normals (f, 3)."""
    opposite = [points[faces[:, (k + 2) % 3]] - points[faces[:, (k + 1) % 3]] for k in range(3)]
    normals = np.cross(opposite[0], opposite[1])
    doubled = np.linalg.norm(normals, axis=1)
    normals = normals / doubled[:, None]
    gradients = np.stack([np.cross(normals, side) / doubled[:, None] for side in opposite], axis=1)
    return gradients, 0.5 * doubled, normals


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def _factorize(matrix: sparse.csc_array):
    """A solver for a symmetric positive definite matrix."""
    return splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    ).solve
