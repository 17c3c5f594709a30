"""What results are judged by: mask IoU and Chamfer distance (S17.2). Host side, numpy."""

import enum

import numpy as np
from jaxtyping import Float, Num
from scipy.spatial import cKDTree

from dress_jax.core.errors import InputError
from dress_jax.geometry.nearest import nearest_on_surface

CENTIMETRES_PER_METRE = 100.0


class ChamferTarget(enum.Enum):
    """What a sample's distance is measured to."""

    SURFACE = "surface"
    SAMPLES = "samples"


class ChamferMean(enum.Enum):
    """How the two directions are joined."""

    MEAN = "mean"
    SUM = "sum"


def iou(
    mask_a: Num[np.ndarray, "*v h w"], mask_b: Num[np.ndarray, "*v h w"], *, threshold: float = 0.5
) -> float:
    """Intersection over union of two masks, pixels of all views taken together.

    Args:
        mask_a, mask_b: coverage in [0, 1], equal shapes, with or without a leading axis of views.
        threshold: coverage above which a pixel counts.

    Returns:
        The ratio in [0, 1]; 1 when both masks are empty.

    Raises:
        InputError: the shapes differ.
    """
    a, b = np.asarray(mask_a), np.asarray(mask_b)
    if a.shape != b.shape:
        raise InputError(f"masks have shapes {a.shape} and {b.shape}", where="iou")
    a, b = a > threshold, b > threshold
    union = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / union if union else 1.0


def chamfer_distance(
    vertices_a: Float[np.ndarray, "n 3"],
    faces_a: Num[np.ndarray, "f 3"],
    vertices_b: Float[np.ndarray, "m 3"],
    faces_b: Num[np.ndarray, "g 3"],
    *,
    samples: int = 10_000,
    seed: int = 0,
    squared: bool = False,
    to: ChamferTarget = ChamferTarget.SURFACE,
    directions: ChamferMean = ChamferMean.MEAN,
    scale: float = CENTIMETRES_PER_METRE,
) -> float:
    """Chamfer distance of two surfaces (S17.4, S22.14).

    By default: `samples` points drawn uniformly by area from each surface, each point's Euclidean
    distance to the nearest point of the other surface's triangles, the mean over points, the mean
    of the two directions, in centimetres. Nothing is aligned or rescaled first. Publications differ
    in every one of these, so each is an option, and numbers of different options do not compare.

    Args:
        vertices_a, vertices_b: positions [m].
        faces_a, faces_b: vertex indices.
        samples: points per surface.
        seed: of the sampling; the same seed gives the same points.
        squared: average squared distances (then `scale` applies before squaring).
        to: distance to the other surface, or to its samples only.
        directions: mean or sum of the two directions.
        scale: units of the result per metre; 100 for centimetres.

    Raises:
        InputError: a mesh has no area or is not finite, or `samples` is not positive.
    """
    if samples <= 0:
        raise InputError(f"samples is {samples}; it has to be positive", where="chamfer_distance")
    random = np.random.default_rng(seed)
    triangles_a = _triangles(vertices_a, faces_a, "the first mesh")
    triangles_b = _triangles(vertices_b, faces_b, "the second mesh")
    points_a = sample_surface(triangles_a, samples, random)
    points_b = sample_surface(triangles_b, samples, random)
    if to is ChamferTarget.SURFACE:
        there = distance_to_surface(points_a, triangles_b)
        back = distance_to_surface(points_b, triangles_a)
    else:
        there = np.asarray(cKDTree(points_b).query(points_a)[0])
        back = np.asarray(cKDTree(points_a).query(points_b)[0])
    power = 2 if squared else 1
    total = np.mean((scale * there) ** power) + np.mean((scale * back) ** power)
    return float(total if directions is ChamferMean.SUM else 0.5 * total)


def sample_surface(
    triangles: Float[np.ndarray, "f 3 3"], samples: int, random: np.random.Generator
) -> Float[np.ndarray, "s 3"]:
    """Points distributed uniformly by area over triangles."""
    edge_1, edge_2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area = np.linalg.norm(np.cross(edge_1, edge_2), axis=1)
    chosen = random.choice(len(triangles), size=samples, p=area / area.sum())
    # Uniform on the parallelogram, then the far half is folded onto the triangle.
    weight = random.random((samples, 2))
    outside = weight.sum(axis=1) > 1
    weight[outside] = 1 - weight[outside]
    return triangles[chosen, 0] + weight[:, :1] * edge_1[chosen] + weight[:, 1:] * edge_2[chosen]


def distance_to_surface(
    points: Float[np.ndarray, "s 3"], triangles: Float[np.ndarray, "f 3 3"]
) -> Float[np.ndarray, "s"]:
    """Exact distance of every point to the nearest triangle [m]."""
    return nearest_on_surface(points, triangles).distance


def _triangles(vertices, faces, name: str) -> np.ndarray:
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(
            f"{name} has vertices {vertices.shape} and faces {faces.shape}, not (n, 3) and (f, 3)",
            where="chamfer_distance",
        )
    triangles = vertices[faces]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    if not (np.isfinite(triangles).all() and np.linalg.norm(normal, axis=1).sum() > 0):
        raise InputError(f"{name} is not finite or has no area", where="chamfer_distance")
    return triangles
