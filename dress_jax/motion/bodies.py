"""The bodies of a motion's frames (S15)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.body.model import BodyModel, forward
from dress_jax.motion.clip import Motion


@dataclasses.dataclass(frozen=True)
class RiggedBody:
    """A body that can move.

    Args:
        model: the rig.
        pose: in which the garment was draped [rad], (55, 3).
        shape: coefficients, (b,).
        translation: puts the body onto the floor in its rest pose [m], (3,).
    """

    model: BodyModel
    pose: Float[np.ndarray, "55 3"]
    shape: Float[np.ndarray, " b"]
    translation: Float[np.ndarray, "3"]

    @property
    def faces(self) -> Int[np.ndarray, "f 3"]:
        """Triangles."""
        return np.asarray(self.model.faces)

    def joints(self) -> Float[np.ndarray, "55 3"]:
        """In the rest pose, on the floor [m]."""
        return self._state(np.zeros_like(self.pose), np.zeros(3)).joints

    def vertices(
        self, pose: Float[np.ndarray, "55 3"], root: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Of one frame [m].

        Args:
            pose: [rad].
            root: see `Motion`.
        """
        return self._state(pose, root).vertices

    def _state(self, pose: np.ndarray, root: np.ndarray):
        real = self.model.template.dtype
        state = forward(
            self.model,
            jnp.asarray(pose, real),
            jnp.asarray(self.shape, real),
            jnp.asarray(self.translation + root, real),
        )
        return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), state)


def posed_bodies(body: RiggedBody, motion: Motion) -> Float[np.ndarray, "t n 3"]:
    """The body in every frame [m]."""
    return np.stack(
        [body.vertices(pose, root) for pose, root in zip(motion.pose, motion.root, strict=True)]
    )
