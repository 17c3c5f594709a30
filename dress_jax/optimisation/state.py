"""What is optimised, and everything that a fit needs to go on where it stopped."""

from typing import Protocol

import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.pattern.parameters import PatternParameters

GROUPS = ("vertices", "controls", "log_stiffness", "pin_shift", "colors")
"""Groups of unknowns, each with a learning rate and an optimiser state of its own."""


@pytree
class Unknowns:
    """The optimised quantities (S9.1), or a gradient in them.

    Attributes:
        pattern: corners [m] and control points [chord lengths].
        log_stiffness: what is unknown of the fabric, by default the logarithms of the factors on
            stretching and bending stiffness, so that both stay positive (S9.14); see
            `fabric_freedom`, (s,).
        pin_shift: common displacement of all pins [m], (3,): how high a waist loop sits is not
            known before the garment is.
        colors: RGB of the garment's vertices, (n, 3).
    """

    pattern: PatternParameters
    log_stiffness: Float[Array, " s"]
    pin_shift: Float[Array, "3"]
    colors: Float[Array, "n 3"]


class DrapedUnknowns(Protocol):
    """What the states of all methods have: unknowns, and their intersection-free drape [m]."""

    @property
    def unknowns(self) -> Unknowns:
        """Last accepted values."""
        ...

    @property
    def positions(self) -> Float[Array, "n 3"]:
        """The drape there."""
        ...


@pytree
class FitState:
    """A fit by Adam between two iterations; its unknowns always drape without intersections.

    Attributes:
        unknowns: last accepted values.
        gradient: of the loss there.
        positions: the drape there, and the start of the next one (S9.5) [m], (n, 3).
        loss: there, ().
        optimizer: state of the optimiser of each group and of the panel stretches, by name.
        iteration: steps so far, accepted or not, ().
        rate_scale: factor on all learning rates, lowered by rejected steps, ().
    """

    unknowns: Unknowns
    gradient: Unknowns
    positions: Float[Array, "n 3"]
    loss: Float[Array, ""]
    optimizer: dict[str, optax.OptState]
    iteration: Int[Array, ""]
    rate_scale: Float[Array, ""]


def groups(unknowns: Unknowns) -> dict[str, Array]:
    """The unknowns by the names of `GROUPS`."""
    return {
        "vertices": unknowns.pattern.vertices,
        "controls": unknowns.pattern.controls,
        "log_stiffness": unknowns.log_stiffness,
        "pin_shift": unknowns.pin_shift,
        "colors": unknowns.colors,
    }


def from_groups(arrays: dict[str, Array]) -> Unknowns:
    """The inverse of `groups`."""
    return Unknowns(
        pattern=PatternParameters(vertices=arrays["vertices"], controls=arrays["controls"]),
        log_stiffness=arrays["log_stiffness"],
        pin_shift=arrays["pin_shift"],
        colors=arrays["colors"],
    )


def finite(unknowns: Unknowns) -> bool:
    """Whether no number is NaN or infinite."""
    return all(bool(jnp.all(jnp.isfinite(array))) for array in groups(unknowns).values())
