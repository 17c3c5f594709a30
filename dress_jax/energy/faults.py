"""Faults of parameters and of the rest shape, named with triangle and panel before a solve."""

import jax
import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import HINGE_LEAVES, Cloth, Parameters
from dress_jax.energy.material import LARGEST_ANISOTROPY
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.panels import FacePanels, triangle_place
from dress_jax.geometry.topology import connected_components

_FLAT = 1e-10  # twice the area over the square of the longest edge

# What a leaf may be: a lower bound, whether it may be reached, and an upper bound that may not.
_BOUNDS: dict[str, tuple[float, bool, float]] = {
    "density": (0.0, False, np.inf),
    "stretching_stiffness": (0.0, True, np.inf),
    "warp_stiffness": (0.0, True, np.inf),
    "weft_stiffness": (0.0, True, np.inf),
    "shear_stiffness": (0.0, True, np.inf),
    "poisson_ratio": (-1.0, False, 1.0),
    "bending_stiffness": (0.0, True, np.inf),
    "bending_anisotropy": (-LARGEST_ANISOTROPY, False, LARGEST_ANISOTROPY),
    "pin_stiffness": (0.0, True, np.inf),
    "stitch_stiffness": (0.0, True, np.inf),
    "barrier_stiffness": (0.0, True, np.inf),
    "friction_coefficient": (0.0, True, np.inf),
}
_NEEDED = {  # stiffness without which a membrane is none
    MembraneModel.ORTHOTROPIC: ("warp_stiffness", "weft_stiffness", "shear_stiffness")
}
_SCALARS = ("pin_stiffness", "stitch_stiffness", "barrier_stiffness", "friction_coefficient")


def check_parameters(parameters: Parameters, cloth: Cloth, panels: FacePanels | None) -> None:
    """Check that parameters are finite, of the right shape and physical, and the rest shape flat.

    Args:
        panels: of the triangles, for messages.

    Raises:
        InputError: a number that is not finite or out of its range, an array of the wrong length,
            a rest triangle without area or turned inside out, or a vertex without mass.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(parameters):
        _check_finite(jax.tree_util.keystr(path).lstrip("."), np.asarray(leaf), cloth, panels)
    for name, bounds in _BOUNDS.items():
        _check_range(name, np.asarray(getattr(parameters, name)), bounds, cloth, panels)
    _check_shape("grain_angle", np.asarray(parameters.grain_angle), cloth)
    limit = parameters.strain_limit
    if limit is not None:
        _check_range(
            "strain_limit.stretch", np.asarray(limit.stretch), (1.0, False, np.inf), cloth, panels
        )
        _check_range(
            "strain_limit.stiffness", np.asarray(limit.stiffness), (0.0, True, np.inf), cloth, None
        )
    _check_rest(np.asarray(parameters.rest_positions), np.asarray(cloth.rest_faces).T, panels)
    bare = np.setdiff1d(np.arange(cloth.vertex_count), np.asarray(cloth.faces))
    if len(bare):
        raise InputError(
            f"vertex {bare[0]} has no mass: no triangle has it as a corner",
            where="cloth",
            mend="leave such vertices out of the mesh",
        )


def _element(name: str, index: int, leaf: np.ndarray, cloth: Cloth, panels) -> str:
    """Which value of a leaf is meant."""
    if leaf.ndim == 0:
        return name
    if name in HINGE_LEAVES:
        a, b = np.asarray(cloth.hinges)[:2, index]
        face = int(np.asarray(cloth.hinge_faces)[0, index])
        return f"{name}, {triangle_place(face, panels)}, edge ({a}, {b})"
    if leaf.shape == (cloth.faces.shape[1],):
        return f"{name}, {triangle_place(index, panels)}"
    return f"{name}, row {index}"


def _check_finite(name: str, leaf: np.ndarray, cloth: Cloth, panels: FacePanels | None) -> None:
    bad = ~np.isfinite(leaf)
    if not bad.any():
        return
    if name == "rest_positions":
        vertex = np.flatnonzero(bad.any(axis=1))[0]
        around = np.flatnonzero((np.asarray(cloth.rest_faces) == vertex).any(axis=0))
        place = f"panel vertex {vertex}"
        place += f", {triangle_place(int(around[0]), panels)}" if len(around) else ""
        raise InputError("a rest position is not finite", where=f"rest_positions, {place}")
    index = int(np.argwhere(bad)[0][0]) if leaf.ndim else 0
    raise InputError(
        "a number is not finite", where=f"parameters {_element(name, index, leaf, cloth, panels)}"
    )


def _check_shape(name: str, leaf: np.ndarray, cloth: Cloth) -> None:
    count = cloth.hinges.shape[1] if name in HINGE_LEAVES else cloth.faces.shape[1]
    expected = [()] if name in _SCALARS or name.endswith(".stiffness") else [(), (count,)]
    if leaf.shape not in expected:
        elements = "hinge" if name in HINGE_LEAVES else "triangle"
        raise InputError(
            f"it has shape {leaf.shape}, expected {' or '.join(map(str, expected))}",
            where=f"parameters {name}",
            mend="give one number"
            + ("" if len(expected) == 1 else f", or one per {elements} (see energy.spread)"),
        )


def _check_range(
    name: str,
    leaf: np.ndarray,
    bounds: tuple[float, bool, float],
    cloth: Cloth,
    panels: FacePanels | None,
) -> None:
    _check_shape(name, leaf, cloth)
    low, reached, high = bounds
    reached = reached and name not in _NEEDED.get(cloth.membrane, ())
    good = ((leaf >= low) if reached else (leaf > low)) & (leaf < high)
    if np.all(good):
        return
    index = int(np.flatnonzero(~np.atleast_1d(good))[0])
    value = float(np.atleast_1d(leaf)[index])
    wanted = f"{'at least' if reached else 'more than'} {low:g}"
    wanted += "" if np.isinf(high) else f" and less than {high:g}"
    raise InputError(
        f"it is {value:g}",
        where=f"parameters {_element(name, index, leaf, cloth, panels)}",
        mend=f"it must be {wanted}",
    )


def _check_rest(
    rest: Float[np.ndarray, "p 2"], faces: Int[np.ndarray, "f 3"], panels: FacePanels | None
) -> None:
    corners = rest[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    longest = np.max(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=2), axis=1)
    flat = np.flatnonzero(~(np.abs(doubled) > _FLAT * longest))
    if len(flat):
        raise InputError(
            f"the rest triangle has no area ({len(flat)} such triangles)",
            where=triangle_place(int(flat[0]), panels),
            mend="move its corners apart in the pattern, or mesh the panel anew",
        )
    signs = np.sign(doubled)
    if len(signs) == 0 or np.all(signs == signs[0]):
        return
    # Mirrored panels turn the other way, each as a whole. Panels share no panel vertices.
    owner = connected_components(faces, len(rest))[faces[:, 0]]
    majority = np.sign(np.bincount(owner, weights=doubled))
    turned = np.flatnonzero(signs != majority[owner])
    if len(turned):
        raise InputError(
            f"the rest triangle is turned inside out ({len(turned)} such triangles)",
            where=triangle_place(int(turned[0]), panels),
            mend="its panel is folded over itself: move the pattern back, or mesh it anew",
        )
