"""Simulation and pattern geometry run in double precision; this is where that is required."""

from typing import TypeVar

import jax
import jax.numpy as jnp

T = TypeVar("T")


def require_float64(caller: str) -> None:
    """Raise unless 64-bit arrays are turned on.

    Importing the package changes no global setting, so a program turns 64-bit on itself.

    Args:
        caller: the public function that needs double precision, named in the error.

    Raises:
        RuntimeError: 64-bit is off; the message holds the line to add.
    """
    if not jax.config.jax_enable_x64:
        raise RuntimeError(
            f"{caller} needs double precision; add this line at the start of your program:\n"
            '    jax.config.update("jax_enable_x64", True)'
        )


def as_float64(tree: T) -> T:
    """The tree with every leaf a float64 array without weak type.

    A weakly typed scalar and a float64 one are different types to a compiled function, so without
    this a leaf that went through arithmetic would compile every kernel anew.
    """
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, jnp.float64), tree)
