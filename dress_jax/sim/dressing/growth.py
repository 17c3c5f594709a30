"""The way of a collider from a thin skeleton to its full shape (S8.1).

A garment is put around a body that is thin enough to stand free inside of it, if need be with the
arms drawn in. What the wearer has on already thins with the body.
"""

import dataclasses

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from dress_jax.geometry.contraction import CurveSkeleton, curve_skeleton
from dress_jax.geometry.intersection import count_intersections, edge_face_intersections
from dress_jax.geometry.limbs import LimbKind, drawn_in
from dress_jax.geometry.topology import unique_edges

_LEVELS = np.linspace(0.4, 1.0, 4)  # tried contractions; 1 is about a tenth of the thickness
_ARM_FRAMES = np.linspace(0.0, 1.0, 13)  # part of the arms' length, while they grow out
_SHOULDER = 0.08  # length over which an arm passes from its own contraction to the trunk's [m]
_SHEATH = 0.1  # distance of a worn component from a thin body, of its distance from the full one


@dataclasses.dataclass(frozen=True)
class Collider:
    """The body and what it wears already.

    Attributes:
        body: body vertices [m], (b, 3).
        skeleton: of the body.
        worn: vertices of the components that are on already [m], (w, 3).
        faces: triangles of body and components, body vertices first, (k, 3).
    """

    body: Float[np.ndarray, "b 3"]
    skeleton: CurveSkeleton
    worn: Float[np.ndarray, "w 3"]
    faces: Int[np.ndarray, "k 3"]

    @property
    def vertices(self) -> Float[np.ndarray, "c 3"]:
        """All vertices, the body's first [m]."""
        return np.concatenate([self.body, self.worn])

    def wearing(self, positions: np.ndarray, faces: np.ndarray) -> "Collider":
        """The same with one more component on."""
        offset = len(self.body) + len(self.worn)
        return dataclasses.replace(
            self,
            worn=np.concatenate([self.worn, positions]),
            faces=np.concatenate([self.faces, np.asarray(faces) + offset]),
        )

    def thinned(
        self, amount: float, *, arms: float | None = None, arm_length: float = 1.0
    ) -> Float[np.ndarray, "c 3"]:
        """Vertices after a contraction.

        Args:
            amount: from 0 (the body as it is) to 1 (about a tenth of its thickness).
            arms: contraction of the arms where it is another one.
            arm_length: part of the arms' length that is left; they must be thin.
        """
        targets = self.skeleton.targets
        amounts = np.full((len(self.body), 1), amount)
        limbs = tuple(limb for limb in self.skeleton.limbs if limb.kind is LimbKind.ARM)
        difference = 0.0 if arms is None else arms - amount
        for limb in limbs:
            amounts += difference * np.clip(limb.along / _SHOULDER, 0.0, 1.0)[:, None]
        thin = (1.0 - amounts) * self.body + amounts * targets
        if arm_length < 1.0:
            thin = drawn_in(thin, limbs, remaining=arm_length)
        if not len(self.worn):
            return thin
        # What is worn comes along with the body beneath it, and as close to it.
        beneath = cKDTree(self.body).query(self.worn)[1]
        away = self.worn - self.body[beneath]
        kept = 1.0 - (1.0 - _SHEATH) * amounts[beneath]
        return np.concatenate([thin, thin[beneath] + kept * away])


def make_collider(body: Float[np.ndarray, "b 3"], faces: Int[np.ndarray, "k 3"]) -> Collider:
    """A body that wears nothing yet."""
    body = np.asarray(body, np.float64)
    return Collider(
        body=body,
        skeleton=curve_skeleton(body, faces),
        worn=np.zeros((0, 3)),
        faces=np.asarray(faces),
    )


@dataclasses.dataclass(frozen=True)
class Growth:
    """How the collider grows inside a garment.

    Attributes:
        frames: its vertices from the first shape, which is free of the garment, to the full one;
            where the arms are drawn in they stay so [m], (frames, c, 3).
        arm_frames: where the arms are drawn in, its vertices while they grow out again; the last
            one is the full collider [m], (k, c, 3).
        contraction: of the first frame.
    """

    frames: Float[np.ndarray, "frames c 3"]
    arm_frames: Float[np.ndarray, "k c 3"]
    contraction: float

    @property
    def arms_drawn_in(self) -> bool:
        """Whether the arms were drawn in."""
        return len(self.arm_frames) > 0


def plan_growth(
    collider: Collider, positions: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]
) -> Growth | None:
    """The growth from the fullest collider that is free of a garment.

    Args:
        collider: body and worn components.
        positions: garment vertices [m].
        faces: garment triangles.

    Returns:
        None where even the skeleton with its arms drawn in crosses the garment.
    """
    whole = collider.vertices
    for amount in _LEVELS:
        if _free(positions, faces, collider.thinned(amount), collider.faces):
            frames = [collider.thinned(level) for level in _LEVELS[::-1] if level <= amount]
            return Growth(np.array([*frames, whole]), np.zeros((0, *whole.shape)), float(amount))
    for amount in _LEVELS:
        first = collider.thinned(amount, arms=1.0, arm_length=0.0)
        if _free(positions, faces, first, collider.faces):
            levels = [0.0, *(level for level in _LEVELS if level <= amount)]
            frames = [collider.thinned(x, arms=1.0, arm_length=0.0) for x in levels[::-1]]
            out = [collider.thinned(0.0, arms=1.0, arm_length=part) for part in _ARM_FRAMES[1:]]
            out += [collider.thinned(0.0, arms=level) for level in _LEVELS[-2::-1]]
            return Growth(np.array(frames), np.array([*out, whole]), float(amount))
    return None


def _free(positions, faces, vertices, collider_faces) -> bool:
    return count_intersections(positions, faces, vertices, collider_faces).body == 0


def crossed_faces(
    positions: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    collider: Collider,
) -> Int[np.ndarray, " k"]:
    """Garment triangles that the thinnest collider, arms drawn in, runs through."""
    everything = np.concatenate([positions, collider.thinned(1.0, arm_length=0.0)])
    edges = unique_edges(collider.faces + len(positions))
    return np.unique(edge_face_intersections(everything, edges, faces)[:, 1])
