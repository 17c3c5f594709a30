"""Shrink a closed body surface onto its curve skeleton, so that cloth can start outside it.

Panels are placed around a body with little room to spare. Draping therefore starts around a thin
body, and the body grows back as a moving boundary (checklist S8.1, S8.7).

The skeleton comes from two ideas, one sparse solve each:

1. a geodesic field d from the highest point (heat method: a heat solve, then a Poisson solve). Its
   level sets are rings around the head, torso, arms, legs and fingers;
2. diffusion of the coordinates *along the rings only*:

       min_T  int |T - X|^2 + kappa |grad T . u|^2,     u = tangent of the level sets of d,

   so every ring collapses to its own centroid while nothing pulls along the limb. Mean-curvature
   flow would thin a wrist long before a waist and shorten every limb; this does neither.

`kappa` is a multiple of the squared local radius, found by repeating the solve: thick and thin
parts then collapse by the same factor. Levels interpolate linearly between surface and skeleton,
so thinning is monotone.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

# A ring of radius r is collapsed to about 1 / (1 + RING_STRENGTH) of it; larger values also
# straighten the skeleton, because a piecewise linear map cannot bend without varying along rings.
RING_STRENGTH = 15.0
# First guess of kappa [m^2 per squared body height]; the local radius replaces it.
FIRST_KAPPA = 0.17
PASSES = 3
# Heat time in squared mean edge lengths: smooth level sets on irregular triangles.
HEAT_TIME = 25.0
# Points closer than this, relative to the height, are one point (texture seams split vertices).
MERGE_TOLERANCE = 1e-7


def skeleton_targets(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Float[np.ndarray, "n 3"]:
    """The point of the curve skeleton that each vertex shrinks to.

    Args:
        vertices: body vertices [m], shape (n, 3). Vertices split along texture seams are welded
            for the solve.
        faces: triangles, shape (f, 3). Further components (eyeballs) follow the nearest vertex of
            the largest one.
        up: direction whose highest vertex (the crown) starts the geodesic field.

    Returns:
        Skeleton points [m], shape (n, 3).

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
    ring_targets = _collapse_rings(points, compact, up=np.asarray(up), height=height)

    # Whatever is not part of the main surface moves along with the nearest point of it.
    targets = np.empty_like(welded)
    targets[used] = ring_targets
    rest = np.setdiff1d(np.arange(len(welded)), used)
    if len(rest):
        _, nearest = cKDTree(points).query(welded[rest])
        targets[rest] = welded[rest] + (ring_targets - points)[nearest]
    return targets[weld_map]


def contract(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    amount: float,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Float[np.ndarray, "n 3"]:
    """Shrink a body toward its curve skeleton; the result may intersect itself.

    Args:
        vertices: body vertices [m], shape (n, 3).
        faces: triangles, shape (f, 3).
        amount: 0 leaves the body as it is, 1 is the thinnest (about a tenth of its thickness).
        up: direction of the crown.

    Returns:
        Vertices of the thin body [m], shape (n, 3).

    Raises:
        ValueError: `amount` outside [0, 1], or a body without usable triangles.
    """
    if not 0.0 <= amount <= 1.0:
        raise ValueError(f"amount must lie between 0 and 1, not {amount}")
    targets = skeleton_targets(vertices, faces, up=up)
    return (1.0 - amount) * np.asarray(vertices, dtype=np.float64) + amount * targets


def contraction_path(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    levels: int,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Float[np.ndarray, "levels n 3"]:
    """Evenly spaced levels from the full body (level 0) to the thinnest (last).

    Thickness falls linearly and monotonically with the level. All levels lie on straight vertex
    paths, so linear interpolation between any two of them reproduces the ones in between.

    Args:
        vertices: body vertices [m], shape (n, 3).
        faces: triangles, shape (f, 3).
        levels: number of levels, at least 2.
        up: direction of the crown.

    Returns:
        Vertices per level [m], shape (levels, n, 3); `[0]` equals `vertices`.

    Raises:
        ValueError: fewer than two levels, or a body without usable triangles.
    """
    if levels < 2:
        raise ValueError(f"a path needs at least two levels, not {levels}")
    vertices = np.asarray(vertices, dtype=np.float64)
    targets = skeleton_targets(vertices, faces, up=up)
    amounts = np.linspace(0.0, 1.0, levels)[:, None, None]
    return (1.0 - amounts) * vertices + amounts * targets


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


def _collapse_rings(
    points: np.ndarray, faces: np.ndarray, *, up: np.ndarray, height: float
) -> np.ndarray:
    count = len(points)
    gradients, areas, normals = _hat_gradients(points, faces)
    masses = np.bincount(faces.ravel(), np.repeat(areas / 3.0, 3), count)

    rows, columns = np.repeat(faces, 3, axis=1).ravel(), np.tile(faces, (1, 3)).ravel()

    def assemble(blocks: np.ndarray) -> sparse.csc_array:
        return sparse.coo_array((blocks.ravel(), (rows, columns)), shape=(count, count)).tocsc()

    stiffness = assemble(np.einsum("fik,fjk->fij", gradients, gradients) * areas[:, None, None])
    mass = sparse.diags_array(masses).tocsc()
    source = int(np.argmax(points @ up))
    distance = _geodesic_field(faces, gradients, areas, masses, stiffness, source)

    slope = _unit(np.einsum("fik,fi->fk", gradients, distance[faces]))
    along_ring = np.einsum("fik,fk->fi", gradients, np.cross(normals, slope))
    ring_blocks = along_ring[:, :, None] * along_ring[:, None, :] * areas[:, None, None]

    # kappa carries the squared mesh height so that the result does not depend on the unit.
    kappa = np.full(len(faces), FIRST_KAPPA * height**2)
    smallest = (3e-3 * height) ** 2
    targets = points
    for _ in range(PASSES):
        smoother = _factorize(mass + assemble(ring_blocks * kappa[:, None, None]))
        targets = smoother(masses[:, None] * points)
        # Averaged along the ring: a ring has one radius, however near its flat side is.
        radius_squared = smoother(masses * ((points - targets) ** 2).sum(axis=1))
        kappa = RING_STRENGTH * np.maximum(radius_squared[faces].mean(axis=1), smallest)
    return targets


def _geodesic_field(
    faces: np.ndarray,
    gradients: np.ndarray,
    areas: np.ndarray,
    masses: np.ndarray,
    stiffness: sparse.csc_array,
    source: int,
) -> np.ndarray:
    """Distance from `source` along the surface by the heat method (Crane et al. 2013)."""
    count = len(masses)
    mass = sparse.diags_array(masses).tocsc()
    impulse = np.zeros(count)
    impulse[source] = 1.0
    heat = _factorize(mass + HEAT_TIME * 2.0 * areas.mean() * stiffness)(impulse)
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
    distance = _factorize(stiffness + shift * mass)(divergence)
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
