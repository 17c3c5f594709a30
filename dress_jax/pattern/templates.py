"""Patterns drafted in code from body measurements, placed around a standing body.

World frame: +y up, +z front, +x the wearer's left, feet at y = 0. Front panels stand in the plane
z = +gap, back panels in z = -gap, turned about the vertical axis so that both loops run
counter-clockwise seen from outside.
"""

import dataclasses
import math

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree, static
from dress_jax.geometry.rotations import rotation_matrix
from dress_jax.pattern.model import Edge, Panel, Pattern, Side, Stitch, line, quadratic


@pytree
class Measurements:
    """Body measurements [m]; the defaults fit a person of about 1.68 m.

    Args:
        chest, waist, hips: girths.
        neck_width: between the shoulder points at the neck.
        shoulder_width: between the shoulder tips.
        shoulder_height, shoulder_tip_height, waist_height, hips_height, crotch_height,
            knee_height: above the floor; `shoulder_height` at the neck.
        armhole_depth: from the shoulder tip straight down to the bottom of an armhole.
        upper_arm, wrist, thigh, ankle: girths.
        leg_distance: of the ankles from the middle plane.
    """

    chest: float = static(default=0.92)
    waist: float = static(default=0.76)
    hips: float = static(default=0.98)
    neck_width: float = static(default=0.15)
    shoulder_width: float = static(default=0.38)
    shoulder_height: float = static(default=1.41)
    shoulder_tip_height: float = static(default=1.37)
    waist_height: float = static(default=1.04)
    hips_height: float = static(default=0.86)
    crotch_height: float = static(default=0.76)
    knee_height: float = static(default=0.47)
    armhole_depth: float = static(default=0.18)
    upper_arm: float = static(default=0.30)
    wrist: float = static(default=0.17)
    thigh: float = static(default=0.57)
    ankle: float = static(default=0.24)
    leg_distance: float = static(default=0.10)


DEFAULT = Measurements()


def _positive(**numbers: float) -> None:
    for name, value in numbers.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value!r}", mend="give a positive number")


def _bodice(
    name: str,
    measurements: Measurements,
    *,
    hem_height: float,
    hem_width: float,
    ease: float,
    neck_depth: float,
    gap: float,
    back: bool,
) -> Panel:
    """A torso panel from shoulders to hem; its origin is at the neck's height on the middle line.

    Edges: 0 hem, 1 right-hand side, 2 right-hand armhole, 3 right-hand shoulder, 4 neckline,
    5 left-hand shoulder, 6 left-hand armhole, 7 left-hand side, as seen from outside.
    """
    m = measurements
    top = m.shoulder_height
    half_chest = 0.25 * m.chest * (1.0 + ease)
    half_neck, half_shoulder, half_hem = 0.5 * m.neck_width, 0.5 * m.shoulder_width, 0.5 * hem_width
    tip = m.shoulder_tip_height - top
    armpit = tip - m.armhole_depth
    hem = hem_height - top
    vertices = np.array(
        [
            (-half_hem, hem),
            (half_hem, hem),
            (half_chest, armpit),
            (half_shoulder, tip),
            (half_neck, 0.0),
            (-half_neck, 0.0),
            (-half_shoulder, tip),
            (-half_chest, armpit),
        ]
    )
    # The neckline's control makes its lowest point neck_depth below the shoulder points.
    neckline = quadratic(4, 5, (0.5, 2.0 * neck_depth / m.neck_width), label="collar")
    edges: tuple[Edge, ...] = (
        quadratic(0, 1, (0.5, -0.04), label="hem"),
        line(1, 2),
        quadratic(2, 3, (0.42, 0.20), label="armhole"),
        line(3, 4),
        neckline,
        line(5, 6),
        quadratic(6, 7, (0.58, 0.20), label="armhole"),
        line(7, 0),
    )
    turn = 180.0 if back else 0.0
    return Panel(
        name=name,
        vertices=vertices,
        edges=edges,
        rotation=rotation_matrix(np.array([0.0, turn, 0.0])),
        translation=np.array([0.0, top, -gap if back else gap]),
        label="body",
    )


def _bodice_seams(front: str, back: str) -> list[Stitch]:
    """Side and shoulder seams; the back's left hand is the front's right hand."""
    pairs = ((1, 7), (7, 1), (3, 5), (5, 3))
    return [Stitch(Side(front, i), Side(back, j)) for i, j in pairs]


def sleeveless_dress(
    measurements: Measurements = DEFAULT,
    *,
    ease: float = 0.08,
    flare: float = 1.25,
    length_below_knee: float = 0.0,
    gap: float = 0.20,
) -> Pattern:
    """A knee-length A-line dress without sleeves: two panels, side and shoulder seams.

    Args:
        measurements: the body's.
        ease: extra width at the chest, as a fraction of the girth.
        flare: hem girth over hip girth.
        length_below_knee: how far the hem lies below the knee [m]; negative for a shorter dress.
        gap: distance of the panels' planes from z = 0 [m].

    Raises:
        InputError: a measurement or option that is not a positive number.
    """
    _positive(flare=flare, gap=gap, one_plus_ease=1.0 + ease)
    hem_width = 0.5 * measurements.hips * flare
    hem_height = measurements.knee_height - length_below_knee
    _positive(hem_height=hem_height)
    common = {"hem_height": hem_height, "hem_width": hem_width, "ease": ease, "gap": gap}
    front = _bodice("front", measurements, neck_depth=0.09, back=False, **common)
    back = _bodice("back", measurements, neck_depth=0.03, back=True, **common)
    return Pattern(
        panels=(front, back),
        stitches=tuple(_bodice_seams("front", "back")),
        source="sleeveless_dress",
    )


def straight_skirt(
    measurements: Measurements = DEFAULT,
    *,
    ease: float = 0.04,
    flare: float = 1.0,
    length_below_knee: float = 0.0,
    gap: float = 0.20,
) -> Pattern:
    """A skirt from waist to knee: two panels and two side seams curved over the hips.

    Args:
        measurements: the body's.
        ease: extra width at waist and hips, as a fraction of the girth.
        flare: girth of the hem over that of the skirt at the hips.
        length_below_knee: how far the hem lies below the knee [m]; negative for a shorter skirt.
        gap: distance of the panels' planes from z = 0 [m].

    Raises:
        InputError: an option that is not a positive number.
    """
    _positive(gap=gap, one_plus_ease=1.0 + ease, flare=flare)
    m = measurements
    half_waist, half_hips = 0.25 * m.waist * (1.0 + ease), 0.25 * m.hips * (1.0 + ease)
    hips = m.hips_height - m.waist_height
    hem = m.knee_height - length_below_knee - m.waist_height
    _positive(hip_drop=-hips, length_below_hips=hips - hem, height_of_hem=hem + m.waist_height)
    vertices = np.array(
        [
            (-half_hips * flare, hem),
            (half_hips * flare, hem),
            (half_hips, hips),
            (half_waist, 0.0),
            (-half_waist, 0.0),
            (-half_hips, hips),
        ]
    )
    edges = (
        line(0, 1, label="hem"),
        line(1, 2),
        quadratic(2, 3, (0.5, -0.06)),
        line(3, 4, label="waist"),
        quadratic(4, 5, (0.5, -0.06)),
        line(5, 0),
    )
    panels = tuple(
        Panel(
            name=name,
            vertices=vertices.copy(),
            edges=edges,
            rotation=rotation_matrix(np.array([0.0, turn, 0.0])),
            translation=np.array([0.0, m.waist_height, z]),
            label="leg",
        )
        for name, turn, z in (("skirt_front", 0.0, gap), ("skirt_back", 180.0, -gap))
    )
    pairs = ((1, 5), (2, 4), (4, 2), (5, 1))
    stitches = tuple(Stitch(Side("skirt_front", i), Side("skirt_back", j)) for i, j in pairs)
    return Pattern(panels=panels, stitches=stitches, source="straight_skirt")


def t_shirt(
    measurements: Measurements = DEFAULT,
    *,
    ease: float = 0.12,
    flare: float = 1.0,
    length_below_hips: float = 0.0,
    sleeve_length: float = 0.20,
    cuff: float | None = None,
    arm_angle: float = 0.0,
    gap: float = 0.20,
) -> Pattern:
    """A hip-length T-shirt: front, back and two sleeves of a front and a back piece each.

    Args:
        measurements: the body's.
        ease: extra width at chest and upper arm, as a fraction of the girth.
        flare: girth of the hem over the larger one of chest and hips, ease included in both.
        length_below_hips: how far the hem lies below the hips [m]; negative for a shorter shirt.
        sleeve_length: from the armpit along the arm [m].
        cuff: girth at the end of the sleeves [m]; that of the upper arm with its ease when None.
        arm_angle: how far the arms hang below the horizontal [degrees]; the sleeves' placement
            follows.
        gap: distance of the panels' planes from z = 0 [m].

    Raises:
        InputError: an option that is not a positive number.
    """
    _positive(gap=gap, one_plus_ease=1.0 + ease, sleeve_length=sleeve_length, flare=flare)
    m = measurements
    hem_width = 0.5 * max(m.hips, m.chest) * (1.0 + ease) * flare
    hem_height = m.hips_height - length_below_hips
    _positive(hem_height=hem_height, cuff=1.0 if cuff is None else cuff)
    common = {"hem_height": hem_height, "hem_width": hem_width, "ease": ease, "gap": gap}
    front = _bodice("front", m, neck_depth=0.09, back=False, **common)
    back = _bodice("back", m, neck_depth=0.03, back=True, **common)
    panels, stitches = [front, back], _bodice_seams("front", "back")
    half_cuff = 0.5 * (m.upper_arm * (1.0 + ease) if cuff is None else cuff)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # The wearer's left is right-hand on the front and left-hand on the back, seen from outside.
        front_right_hand = sign > 0.0
        for body, turned, right_hand in (
            (front, 0.0, front_right_hand),
            (back, 180.0, not front_right_hand),
        ):
            name = f"{side}_sleeve_{body.name}"
            vertices, edges, cap = _sleeve_outline(body, sleeve_length, half_cuff, right_hand)
            shoulder = np.array([sign * (body.vertices[3, 0] + 0.08), m.shoulder_tip_height])
            panels.append(
                Panel(
                    name=name,
                    vertices=vertices,
                    edges=edges,
                    rotation=rotation_matrix(np.array([0.0, turned, -sign * arm_angle])),
                    translation=np.append(shoulder, -gap if turned else gap),
                    label="arm",
                )
            )
            stitches.append(Stitch(Side(body.name, 2 if right_hand else 6), Side(name, cap)))
        for edge in (2, 0):  # over the arm and under it
            pieces = (f"{side}_sleeve_front", f"{side}_sleeve_back")
            stitches.append(Stitch(Side(pieces[0], edge), Side(pieces[1], edge)))
    return Pattern(panels=tuple(panels), stitches=tuple(stitches), source="t_shirt")


def _sleeve_outline(
    bodice: Panel, length: float, cuff: float, right_hand: bool
) -> tuple[np.ndarray, tuple[Edge, ...], int]:
    """Half a sleeve whose cap is its armhole's own curve; the origin is the shoulder tip.

    Returns:
        Corners [m], edges (0 under the arm, 2 over it) and the index of the cap.
    """
    armpit, tip = bodice.vertices[2] - bodice.vertices[3], np.zeros(2)
    end = armpit[0] + length
    x, y = bodice.edges[2].controls[0]
    if right_hand:
        vertices = np.array([armpit, (end, -cuff), (end, 0.0), tip])
        cap = quadratic(3, 0, (1.0 - x, -y))  # the armhole's curve run backwards
        return vertices, (line(0, 1), line(1, 2, label="cuff"), line(2, 3), cap), 3
    mirror = np.array([-1.0, 1.0])
    vertices = np.array([(end, -cuff), armpit, tip, (end, 0.0)]) * mirror
    cap = quadratic(1, 2, (x, -y))  # mirrored
    return vertices, (line(0, 1), cap, line(2, 3), line(3, 0, label="cuff")), 1


def trousers(
    measurements: Measurements = DEFAULT,
    *,
    ease: float = 0.08,
    hem_height: float = 0.10,
    hem: float | None = None,
    rise_ease: float = 0.02,
    gap: float = 0.20,
) -> Pattern:
    """Plain trousers: a front and a back piece for each leg, alike, as those of pyjamas.

    Args:
        measurements: the body's.
        ease: extra width at waist and hips, as a fraction of the girth.
        hem_height: of the hems above the floor [m].
        hem: girth of a trouser leg at its end [m]; None tapers from the thigh to half as much again
            as the ankle.
        rise_ease: how far the crotch seam lies below the crotch [m].
        gap: distance of the panels' planes from z = 0 [m].

    Raises:
        InputError: a measurement or option that is not a positive number, or legs that end above
            the crotch.
    """
    m = measurements
    crotch = m.crotch_height - rise_ease - m.waist_height
    end, hips = hem_height - m.waist_height, m.hips_height - m.waist_height
    _positive(
        gap=gap,
        one_plus_ease=1.0 + ease,
        hem_height=hem_height,
        rise=hips - crotch,
        length_of_legs=crotch - end,
        hip_drop=-hips,
    )
    half_waist, half_hips = 0.25 * m.waist * (1.0 + ease), 0.25 * m.hips * (1.0 + ease)
    # The crotch pieces of front and back together are about a sixth of the hips.
    fork = m.hips / 12.0
    share = (crotch - end) / (m.crotch_height - rise_ease)
    tapered = m.thigh * (1.0 + ease) + share * (1.5 * m.ankle - m.thigh * (1.0 + ease))
    half_hem = 0.5 * (tapered if hem is None else hem)
    _positive(hem=half_hem)
    inner = max(m.leg_distance - 0.5 * half_hem, -fork)
    outline = np.array(
        [
            (inner, end),
            (inner + half_hem, end),
            (half_hips, hips),
            (half_waist, 0.0),
            (0.0, 0.0),
            (0.0, 0.5 * (crotch + hips)),
            (-fork, crotch),
        ]
    )
    edges = (
        line(0, 1, label="hem"),
        line(1, 2),
        quadratic(2, 3, (0.5, -0.06)),
        line(3, 4, label="waist"),
        line(4, 5),
        quadratic(5, 6, (0.5, 0.28)),
        line(6, 0),
    )
    # The legs stand beside each other: their forks reach over the middle.
    aside = fork + 0.02
    panels = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for face, turn in (("front", 0.0), ("back", 180.0)):
            mirrored = (sign < 0.0) != (face == "back")
            panels.append(
                Panel(
                    name=f"{side}_{face}",
                    vertices=outline[::-1] * (-1.0, 1.0) if mirrored else outline.copy(),
                    edges=tuple(_mirrored_edges(edges)) if mirrored else edges,
                    rotation=rotation_matrix(np.array([0.0, turn, 0.0])),
                    translation=np.array(
                        [sign * aside, m.waist_height, -gap if face == "back" else gap]
                    ),
                    label="leg",
                )
            )
    count = len(edges)

    def side_of(name: str, face: str, edge: int) -> Side:
        mirrored = (name == "right") != (face == "back")
        return Side(f"{name}_{face}", _mirrored_edge(edge, count) if mirrored else edge)

    stitches = [
        Stitch(side_of(name, "front", edge), side_of(name, "back", edge))
        for name in ("left", "right")
        for edge in (1, 2, 6)  # side seam, over the hips, inside of the leg
    ]
    stitches += [
        Stitch(side_of("left", face, edge), side_of("right", face, edge))
        for face in ("front", "back")
        for edge in (4, 5)  # centre and crotch
    ]
    return Pattern(panels=tuple(panels), stitches=tuple(stitches), source="trousers")


def _mirrored_edge(edge: int, count: int) -> int:
    """Place of an edge in the loop that `_mirrored_edges` makes."""
    return (count - 2 - edge) % count


def _mirrored_edges(edges: tuple[Edge, ...]) -> list[Edge]:
    """The edges of the outline whose corners are reversed and mirrored, so that it turns the same
    way: edge e from corner e to e + 1 becomes one from n - 2 - e to n - 1 - e, run backwards."""
    count, made = len(edges), {}
    for number, edge in enumerate(edges):
        place = _mirrored_edge(number, count)
        ends = place, (place + 1) % count
        controls = edge.controls[::-1]
        # Backwards, x is counted from the other end; mirrored and turned around, y stays.
        made[place] = Edge(edge.kind, *ends, controls * (-1.0, 1.0) + (1.0, 0.0), edge.label)
    return [made[place] for place in range(count)]


def outfit(*patterns: Pattern) -> Pattern:
    """Several garments as one pattern; panels are named by garment where names would repeat.

    Args:
        patterns: in any order; dressing puts on the lowest first.
    """
    names = [panel.name for pattern in patterns for panel in pattern.panels]
    double = len(set(names)) < len(names)
    panels, stitches = [], []
    for pattern in patterns:
        prefix = f"{pattern.source}_" if double else ""
        panels += [dataclasses.replace(p, name=prefix + p.name) for p in pattern.panels]
        stitches += [
            dataclasses.replace(
                s,
                first=dataclasses.replace(s.first, panel=prefix + s.first.panel),
                second=dataclasses.replace(s.second, panel=prefix + s.second.panel),
            )
            for s in pattern.stitches
        ]
    source = " and ".join(pattern.source for pattern in patterns)
    return Pattern(panels=tuple(panels), stitches=tuple(stitches), source=source)
