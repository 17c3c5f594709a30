"""Which garment of an outfit shows in which mask (S10.2, S10.5, S10.6; host)."""

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError

_SEEN = 0.5  # coverage from which a pixel counts


def assign_parts(
    component_heights: Float[np.ndarray, " components"],
    first_view: Float[np.ndarray, "h w parts"],
) -> Int[np.ndarray, " components"]:
    """The part of the masks that every component belongs to.

    Components and parts are each sorted from the top down, the parts by where they lie in the first
    view, and matched in that order. Done once, before a fit (S21.10).

    Args:
        component_heights: of every component in the world [m].
        first_view: coverage of every part in the first picture.

    Returns:
        A part for each component; all zeros where there is one part only. Where there is one
        component and several parts, the parts are to be merged (`merged`).

    Raises:
        InputError: several of both, but not as many of one as of the other; or a part that the
            first view does not show.
    """
    components, parts = len(component_heights), first_view.shape[-1]
    if parts == 1 or components == 1:
        return np.zeros(components, dtype=np.int32)
    if components != parts:
        raise InputError(
            f"the masks tell {parts} kinds of garment apart, the pattern has {components} garments",
            where="observation",
            mend="merge masks or panels until both count the same, or give one mask",
        )
    rows = np.arange(first_view.shape[0])
    seen = (first_view > _SEEN).sum(axis=1)
    if not seen.any(axis=0).all():
        missing = int(np.argmin(seen.any(axis=0)))
        raise InputError(
            f"the first view does not show part {missing} of the masks",
            where="observation",
            mend="begin with a view that shows every garment",
        )
    heights = (rows[:, None] * seen).sum(axis=0) / seen.sum(axis=0)
    part_of = np.zeros(components, dtype=np.int32)
    part_of[np.argsort(-component_heights, kind="stable")] = np.argsort(heights, kind="stable")
    return part_of


def merged(parts: Float[np.ndarray, "v h w parts"]) -> Float[np.ndarray, "v h w 1"]:
    """All parts as one (S10.6)."""
    return np.clip(parts.sum(axis=-1, keepdims=True), 0.0, 1.0)
