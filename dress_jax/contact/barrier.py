"""The barrier function and its scaling to physical units."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.core.pytree import pytree


@pytree
class ContactSettings:
    """Lengths of the contact model.

    Attributes:
        dhat: distance at which the barrier begins to push [m], counted from `thickness`, ().
        thickness: distance xi that pairs never fall below [m], ().
        slip_speed: speed below which friction is smoothed [m/s], ().
    """

    dhat: Float[Array, ""]
    thickness: Float[Array, ""]
    slip_speed: Float[Array, ""]


def contact_settings(
    *, dhat: float = 3e-3, thickness: float = 3e-4, slip_speed: float = 1e-3
) -> ContactSettings:
    """Contact settings from numbers in metres and seconds."""
    return ContactSettings(
        *(jnp.asarray(length, jnp.float64) for length in (dhat, thickness, slip_speed))
    )


class BarrierDerivatives(NamedTuple):
    """Value and derivatives of the barrier in the squared distance."""

    value: Array
    first: Array
    second: Array


def _gap_ratio(squared: Array, settings: ContactSettings) -> tuple[Array, Array]:
    """s/s^ with s = d^2 - xi^2 and s^ = dhat^2 + 2 dhat xi, and s^ itself."""
    reach = settings.dhat**2 + 2.0 * settings.dhat * settings.thickness
    return (squared - settings.thickness**2) / reach, reach


def barrier(squared: Array, settings: ContactSettings) -> Array:
    """-(z - 1)^2 ln z with z = s/s^ where z < 1, else 0; infinite where z <= 0 (S1.9).

    Args:
        squared: squared distances [m^2].

    Returns:
        Dimensionless; multiply by stiffness, area and dhat for an energy.
    """
    z, _ = _gap_ratio(squared, settings)
    active = (z < 1.0) & (z > 0.0)
    inner = jnp.where(active, z, 1.0)
    value = -((inner - 1.0) ** 2) * jnp.log(inner)
    return jnp.where(z <= 0.0, jnp.inf, value)


def barrier_derivatives(squared: Array, settings: ContactSettings) -> BarrierDerivatives:
    """The barrier with its first and second derivative in the squared distance."""
    z, reach = _gap_ratio(squared, settings)
    active = (z < 1.0) & (z > 0.0)
    inner = jnp.where(active, z, 1.0)
    log = jnp.log(inner)
    short = inner - 1.0
    first = -2.0 * short * log - short**2 / inner
    second = -2.0 * log - 4.0 * short / inner + (short / inner) ** 2
    return BarrierDerivatives(
        value=jnp.where(z <= 0.0, jnp.inf, -(short**2) * log),
        first=jnp.where(active, first / reach, 0.0),
        second=jnp.where(active, second / reach**2, 0.0),
    )
