"""The arms and legs of a standing body, and how they are drawn into the trunk.

Panels that are to be sewn at the wearer's sides may have a hand or an arm between them. Such a
garment is put on with the arms drawn in; afterwards they grow out again along their own curve
skeleton, which leads them through armholes and sleeves (checklist S8.1).
"""

import enum
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

# Length that a part must have to count as a limb, relative to the height; an ear has less.
_LEAST_LENGTH = 0.15
# What is left of the thickness of a limb that is drawn in: its triangles stay triangles.
_STUB = 0.1
_LEVELS = 200


class LimbKind(enum.Enum):
    """Upper and lower limbs."""

    ARM = "arm"
    LEG = "leg"


@dataclass(frozen=True)
class Branch:
    """Where a limb leaves the trunk.

    Attributes:
        kind: arm or leg.
        tip: vertex of the finger tips or toes that is farthest from the crown.
        fork: vertex of the limb in the armpit or crotch.
    """

    kind: LimbKind
    tip: int
    fork: int


@dataclass(frozen=True)
class Limb:
    """A limb and its curve.

    Attributes:
        kind: arm or leg.
        part: which body vertices belong to it, shape (n,).
        along: distance from its root along the limb [m], 0 elsewhere, shape (n,).
        curve: points of its skeleton from root to tip [m], shape (k, 3).
        stations: distance from the root of each of them [m], increasing, shape (k,).
    """

    kind: LimbKind
    part: Bool[np.ndarray, "n"]
    along: Float[np.ndarray, "n"]
    curve: Float[np.ndarray, "k 3"]
    stations: Float[np.ndarray, "k"]


def find_branches(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    distance: Float[np.ndarray, "n"],
) -> tuple[Branch, ...]:
    """The arms and legs of a standing body; none where it does not branch like one.

    Walking down from the crown, the body first falls into three parts at the armpits: the trunk in
    the middle and an arm on either side. Further down the trunk falls into two legs.

    Args:
        vertices: of one connected surface [m], shape (n, 3); +x is the wearer's left.
        faces: triangles, shape (f, 3).
        distance: from the crown along the surface [m], shape (n,).
    """
    edges = np.concatenate([faces[:, :2], faces[:, 1:], faces[:, [2, 0]]])
    least = _LEAST_LENGTH * float(np.max(np.ptp(vertices, axis=0)))
    inside = np.ones(len(vertices), bool)
    branches: list[Branch] = []
    for level in np.linspace(0.0, float(distance.max()), _LEVELS, endpoint=False)[1:]:
        parts = [
            part
            for part in _parts(edges, inside & (distance > level))
            if distance[part].max() - level >= least
        ]
        if not branches and len(parts) >= 3:
            middles = [float(vertices[part, 0].mean()) for part in parts]
            sides = (parts[int(np.argmin(middles))], parts[int(np.argmax(middles))])
            trunk = max(parts, key=np.count_nonzero)
            if any(trunk is side for side in sides):
                return ()
            branches = [_branch(LimbKind.ARM, side, trunk, vertices, distance) for side in sides]
            inside = trunk
        elif branches and len(parts) == 2:
            first, second = parts
            branches.append(_branch(LimbKind.LEG, first, second, vertices, distance))
            branches.append(_branch(LimbKind.LEG, second, first, vertices, distance))
            break
    return tuple(branches)


def _branch(kind: LimbKind, part, neighbour, vertices, distance) -> Branch:
    """`neighbour`: the part that it has just split from; the fork is where they are closest."""
    own = np.flatnonzero(part)
    gaps, _ = cKDTree(vertices[neighbour]).query(vertices[own])
    return Branch(kind, tip=int(own[np.argmax(distance[own])]), fork=int(own[np.argmin(gaps)]))


def _parts(edges: np.ndarray, inside: np.ndarray) -> list[np.ndarray]:
    """Masks of the connected parts of a set of vertices."""
    kept = edges[inside[edges].all(axis=1)]
    count = len(inside)
    graph = sparse.coo_array(
        (np.ones(len(kept), np.int8), (kept[:, 0], kept[:, 1])), shape=(count, count)
    )
    label = csgraph.connected_components(graph, directed=False)[1]
    sizes = np.bincount(label[inside], minlength=label.max() + 1)
    return [(label == number) & inside for number in np.flatnonzero(sizes)]


def make_limb(
    kind: LimbKind,
    along: Float[np.ndarray, "n"],
    targets: Float[np.ndarray, "n 3"],
    *,
    piece: float,
) -> Limb:
    """A limb from its vertices' stations and skeleton points.

    Args:
        kind: arm or leg.
        along: distance from the root along the limb [m], negative off the limb, shape (n,).
        targets: skeleton points [m], shape (n, 3).
        piece: length of the pieces of the curve [m].
    """
    part = along > 0.0
    number = (along[part] / piece).astype(np.int64)
    used, inverse, sizes = np.unique(number, return_inverse=True, return_counts=True)
    curve = np.stack(
        [np.bincount(inverse, targets[part, axis]) / sizes for axis in range(3)], axis=1
    )
    return Limb(kind, part, np.where(part, along, 0.0), curve, (used + 0.5) * piece)


def drawn_in(
    vertices: Float[np.ndarray, "n 3"], limbs: tuple[Limb, ...], *, remaining: float
) -> Float[np.ndarray, "n 3"]:
    """A thin body with limbs shortened along their own curves.

    Args:
        vertices: of the thin body [m], shape (n, 3).
        limbs: those to draw in.
        remaining: length that is left, from 0 (stubs at the armpits) to 1 (the body as it is).

    Returns:
        Vertices [m], shape (n, 3).
    """
    moved = np.array(vertices, np.float64)
    for limb in limbs:
        own = limb.along[limb.part]
        for axis in range(3):
            here, there = (
                np.interp(scale * own, limb.stations, limb.curve[:, axis])
                for scale in (1.0, remaining)
            )
            offset = moved[limb.part, axis] - here
            moved[limb.part, axis] = there + max(remaining, _STUB) * offset
    return moved
