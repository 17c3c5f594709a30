"""Where a fit begins: the pattern of the input, or a template chosen by the labels (S4, S6).

How far clothes reach is read off the body beneath them: it is drawn in the front view in the
colours of its own coordinates in the dressing pose, so that a hem has a height on the leg and a
sleeve a length along the arm, whatever the pose of the picture.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from dress_jax.application.wearer import Wearer
from dress_jax.capture.frames import view_azimuth
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.pattern import Pattern, pattern_parameters, with_parameters
from dress_jax.pattern.mirror import find_mirror
from dress_jax.pattern.symmetry import make_symmetry, validated
from dress_jax.pattern.templates import (
    Measurements,
    outfit,
    sleeveless_dress,
    straight_skirt,
    t_shirt,
    trousers,
)
from dress_jax.render.images import check_image, render
from dress_jax.render.mesh import make_render_mesh

SMPL_ORIGIN = 0.66
"""Height of the origin of SMPL's canonical frame above the soles, in statures: patterns of
NeuralTailor, SewFactory and SewFormer are placed in it (soles at y = -1.12 m)."""

_BELOW = -0.05  # no garment reaches further below the floor [m]
_BIN = 0.02  # of the coverage along arm and leg [m]
_COVERED = 0.5
_ON_BODY = 0.99
_LEAST_PIXELS = 4  # of a bin that says anything
_LEAST_GAP = 30  # pixels between the legs that tell a skirt from trousers
_WIDE_GAP = 0.5  # of the legs beside it
_SKIRT = 0.8  # of such gaps is covered
_SHORTEST_SLEEVE, _SHORTEST_LEG, _LOWEST_HEM = 0.05, 0.08, 0.05

_render = jax.jit(render)


@dataclasses.dataclass(frozen=True)
class Coverage:
    """How far a garment reaches on the body in its dressing pose [m].

    Attributes:
        hem_height: lowest place on trunk and legs that is covered, above the floor.
        sleeve_reach: farthest covered place on the arms, from the middle plane; 0 without sleeves.
        between_legs: part of wide gaps between the legs that is covered; None where none is seen.
    """

    hem_height: float
    sleeve_reach: float
    between_legs: float | None


def front_view(views: tuple[View, ...]) -> View:
    """The view that sees most of the front.

    Raises:
        InputError: there is no view.
    """
    if not views:
        raise InputError("there are no views", where="views")
    return min(views, key=lambda view: abs((view_azimuth(view.camera) + 180) % 360 - 180))


def find_coverage(
    view: View, mask: np.ndarray, wearer: Wearer, measurements: Measurements
) -> Coverage:
    """How far the clothes under a mask reach.

    Args:
        view: whose camera is in the wearer's frame.
        mask: coverage of its pixels by the garment, 0 to 255, shape (h, w).
        wearer: in the pose of the view.
        measurements: of its body.

    Raises:
        InputError: the mask covers nothing of the body's trunk and legs.
    """
    mesh = make_render_mesh(
        jnp.asarray(wearer.vertices), wearer.faces, attributes=jnp.asarray(wearer.start)
    )
    image = check_image(_render(view.camera, mesh, None))
    place, body = np.asarray(image.attributes), np.asarray(image.mask) >= _ON_BODY
    worn, across, height = mask >= 128, place[..., 0], place[..., 1]
    m = measurements
    armpit = m.shoulder_tip_height - m.armhole_depth
    arms = body & (np.abs(across) > 0.5 * m.shoulder_width + 0.02) & (height > armpit - 0.08)
    lower = body & ~arms & (height < armpit)
    reach = _reach(np.abs(across[arms]), worn[arms], 0.5 * m.shoulder_width + 0.02)
    # Along the trunk and down the legs, from where the garment is for sure.
    if not (lower & worn).any():
        raise InputError(
            "covers nothing of trunk and legs",
            where=f"view '{view.name}', mask",
            mend="look at the masks and at the body, or give a start pattern with --pattern",
        )
    begin = float(np.quantile(height[lower & worn], 0.9))
    drop = _reach(begin - height[lower], worn[lower], 0.0)
    return Coverage(
        hem_height=begin - drop,
        sleeve_reach=reach if reach > 0.5 * m.shoulder_width + 0.02 else 0.0,
        between_legs=_between_legs(body & (height < m.crotch_height), across, worn, body),
    )


def template_for(
    view: View, wearer: Wearer, measurements: Measurements
) -> tuple[Pattern, tuple[str, ...]]:
    """A pattern of our own that covers what the front view shows, made to measure.

    Top: shirt with sleeves as long as seen. Bottom: trousers, or a skirt where the gap between the
    legs is covered. Dress: with or without sleeves. Widths are those of the body with some ease.

    Args:
        view: with a mask per kind of clothes, its camera in the wearer's frame.
        wearer: in the pose of the view.
        measurements: of its body.

    Returns:
        The pattern, and what was chosen, a sentence each.

    Raises:
        InputError: the view does not tell kinds of clothes, or they cover nothing of the body.
    """
    known = [kind for kind in ("top", "bottom", "dress") if kind in view.parts]
    if not known:
        raise InputError(
            "does not say what the clothes are",
            where=f"view '{view.name}'",
            mend="give a start pattern with --pattern, or label maps",
        )
    garments, notes = [], []
    for kind in known:
        coverage = find_coverage(view, view.parts[kind], wearer, measurements)
        if kind == "top":
            made = _shirt(measurements, coverage)
        elif kind == "bottom":
            made = _bottom(measurements, coverage)
        else:
            made = _dress(measurements, coverage)
        garments.append(made)
        sleeves = coverage.sleeve_reach - 0.5 * measurements.shoulder_width
        reach = f", sleeves {100 * sleeves:.0f} cm" if coverage.sleeve_reach else ""
        notes.append(
            f"The {kind} begins as our template '{made.source}': hem at "
            f"{100 * coverage.hem_height:.0f} cm above the floor{reach}."
        )
    return (garments[0] if len(garments) == 1 else outfit(*garments)), tuple(notes)


def on_the_floor(pattern: Pattern, stature: float) -> tuple[Pattern, str]:
    """The pattern placed around a body with its soles at y = 0.

    Patterns of SMPL's world are placed around its origin, near the breastbone, and would be below
    the floor.

    Args:
        pattern: as its file places it.
        stature: of the body [m].

    Returns:
        The pattern, and a sentence where it was moved.
    """
    lowest = min(
        float((panel.vertices @ panel.rotation[1, :2] + panel.translation[1]).min())
        for panel in pattern.panels
    )
    if lowest >= _BELOW:
        return pattern, ""
    up = np.array([0.0, SMPL_ORIGIN * stature, 0.0])
    panels = tuple(dataclasses.replace(p, translation=p.translation + up) for p in pattern.panels)
    note = f"The pattern is placed in SMPL's frame, and was moved up by {up[1]:.2f} m."
    return dataclasses.replace(pattern, panels=panels), note


def symmetric(pattern: Pattern) -> tuple[Pattern, str]:
    """The pattern with panels that mirror each other made exactly so (S4.3 to S4.7)."""
    mirror = find_mirror(pattern)
    symmetry = make_symmetry(pattern, mirror)
    if symmetry is None:
        return pattern, "No two panels mirror each other; nothing was symmetrized."
    raw = pattern_parameters(pattern)
    made = validated(raw, symmetry)
    moved = float(np.max(np.abs(np.asarray(made.vertices) - np.asarray(raw.vertices))))
    note = (
        f"{len(mirror.pairs)} panels or pairs of panels are symmetric; corners were moved by up to "
        f"{1e3 * moved:.2g} mm for it."
    )
    return with_parameters(pattern, made), note


def _reach(
    distance: Float[np.ndarray, " n"], covered: Bool[np.ndarray, " n"], begin: float
) -> float:
    """The end of the covered run of bins that begins at a distance; bins unseen count as before."""
    if not len(distance) or float(distance.max()) <= begin:
        return begin
    edges = np.arange(begin, float(distance.max()) + _BIN, _BIN)
    place = np.digitize(distance, edges) - 1
    end = begin
    for number in range(len(edges)):
        own = covered[place == number]
        if len(own) < _LEAST_PIXELS:
            continue
        if own.mean() < _COVERED:
            break
        end = float(edges[number] + _BIN)
    return end


def _between_legs(
    legs: np.ndarray, across: np.ndarray, worn: np.ndarray, body: np.ndarray
) -> float | None:
    """Part of the pixels between the two legs that the garment covers, in rows that it reaches.

    Wide trousers fill a narrow gap, so that only gaps half as wide as the legs beside them count.
    """
    total = covered = 0
    for row in np.flatnonzero(legs.any(axis=1)):
        columns = np.flatnonzero(legs[row])
        left, right = columns[across[row, columns] > 0.0], columns[across[row, columns] < 0.0]
        if not (len(left) and len(right)) or not worn[row, columns].mean() > _COVERED:
            continue
        low, high = sorted((left, right), key=lambda side: float(side.mean()))
        gap = np.arange(low.max() + 1, high.min())
        if len(gap) < _WIDE_GAP * 0.5 * (np.ptp(low) + np.ptp(high) + 2):
            continue
        gap = gap[~body[row, gap]]
        total, covered = total + len(gap), covered + int(worn[row, gap].sum())
    return None if total < _LEAST_GAP else covered / total


def _shirt(m: Measurements, coverage: Coverage) -> Pattern:
    below = m.hips_height - coverage.hem_height
    if not coverage.sleeve_reach:
        low = m.knee_height - coverage.hem_height
        return sleeveless_dress(m, ease=0.12, flare=1.12, length_below_knee=low)
    sleeve = max(coverage.sleeve_reach - 0.28 * m.chest, _SHORTEST_SLEEVE)
    return t_shirt(m, length_below_hips=below, sleeve_length=sleeve, cuff=_cuff(m, sleeve))


def _dress(m: Measurements, coverage: Coverage) -> Pattern:
    low = m.knee_height - max(coverage.hem_height, _LOWEST_HEM)
    sleeve = coverage.sleeve_reach - 0.28 * m.chest
    if sleeve < _SHORTEST_SLEEVE:
        return sleeveless_dress(m, length_below_knee=low)
    below = m.hips_height - max(coverage.hem_height, _LOWEST_HEM)
    return t_shirt(
        m, flare=1.2, length_below_hips=below, sleeve_length=sleeve, cuff=_cuff(m, sleeve)
    )


def _bottom(m: Measurements, coverage: Coverage) -> Pattern:
    hem = max(coverage.hem_height, _LOWEST_HEM)
    if coverage.between_legs is not None and coverage.between_legs > _SKIRT:
        shortest = m.hips_height - _SHORTEST_LEG
        return straight_skirt(m, flare=1.15, length_below_knee=m.knee_height - min(hem, shortest))
    shortest = m.crotch_height - 0.02 - _SHORTEST_LEG
    return trousers(m, hem_height=min(hem, shortest))


def _cuff(m: Measurements, sleeve: float, *, ease: float = 0.12, whole: float = 0.45) -> float:
    """Girth of a sleeve's end: from the upper arm to a loose wrist along the arm [m]."""
    share = min(sleeve / whole, 1.0)
    return (m.upper_arm + share * (1.5 * m.wrist - m.upper_arm)) * (1.0 + ease)
