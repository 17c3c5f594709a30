"""The wearer moves from the dressing pose into another one (S8.6-S8.11)."""

import dataclasses
import enum
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from dress_jax.contact.barrier import ContactSettings
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Cloth, Gravity
from dress_jax.energy.fabric import Fabrics
from dress_jax.energy.panels import FacePanels
from dress_jax.sim.dressing.dress import DressedGarment, DressingOptions
from dress_jax.sim.dressing.motion import follow_body, settle
from dress_jax.sim.dressing.waist import shrunk_waist
from dress_jax.sim.simulator import make_simulation

_TIGHTENING_STEPS, _TIGHTENING_TIME = 4, 0.1  # of a shrunk waist, before the body moves [s]


class WaistHold(enum.Enum):
    """What keeps a garment up that does not hang from the shoulders while its wearer moves.

    Both are gone when the wearer has arrived: the drape has the true rest shape and the waist loop
    pinned where it is (S8.10, S9.10, S21.2).
    """

    PINS = "pins"
    """The waist loop rides on the body beneath it; the cloth weighs nothing on the way."""

    SHRINK = "shrink"
    """The rest shape near the waist is shrunk, so that friction holds it against its weight."""


def follow_pose(
    dressed: DressedGarment,
    rest_positions: Float[np.ndarray, "p 2"],
    body_vertices: Float[np.ndarray, "b 3"],
    body_faces: Int[np.ndarray, "k 3"],
    way: Float[np.ndarray, "frames b 3"],
    *,
    fabric: Fabrics,
    panels: FacePanels,
    hold: WaistHold = WaistHold.PINS,
    settings: ContactSettings | None = None,
    options: DressingOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> DressedGarment:
    """The garment after the body has moved; every state on the way is free of intersections.

    Args:
        dressed: the garment on the body as it is at first.
        rest_positions: panel coordinates [m].
        body_vertices, body_faces: the body at first [m].
        way: the body's shapes on its way, the last one included [m].
        fabric: of the whole garment, or one per panel.
        panels: of the triangles.
        hold: what keeps the waist in place.
        settings: lengths of the contact model.
        options: how the cloth follows the body.
        progress: called with the fraction of the way that is done.

    Returns:
        The garment, its pins where its waist has come to.

    Raises:
        InputError: the body cannot move on; the message names the panels.
    """
    options = DressingOptions() if options is None else options
    pinned = hold is WaistHold.PINS
    loop = np.asarray(dressed.cloth.pins)
    cloth, rest = dressed.cloth, np.asarray(rest_positions, np.float64)
    if not pinned:
        rest = shrunk_waist(rest, np.asarray(cloth.rest_faces).T, np.asarray(cloth.faces).T, loop)
        cloth = _without_pins(cloth)
    simulator, parameters = make_simulation(
        cloth,
        dressed.positions,
        rest,
        fabric=fabric,
        panels=panels,
        body_vertices=body_vertices,
        body_faces=body_faces,
        pin_targets=dressed.pin_targets if pinned else np.zeros((0, 3)),
        gravity=Gravity.NONE if pinned else Gravity.DOWN,
        friction=not pinned,
        settings=settings,
        linear_solver=options.linear_solver,
        broad_phase=options.broad_phase,
    )
    positions, body = dressed.positions, np.asarray(body_vertices)
    if not pinned:
        # Friction has something to hold only once the waist is tight.
        weightless = replace(parameters, gravity=jnp.zeros(3))
        positions = settle(
            simulator, weightless, positions, steps=_TIGHTENING_STEPS, time_step=_TIGHTENING_TIME
        )
    pins = dressed.pin_targets
    beneath = np.asarray(cKDTree(body).query(pins)[1], np.int64) if len(pins) else None
    for number, frame in enumerate(way):
        if progress is not None:
            progress(number / len(way))
        if beneath is not None:
            pins = pins + frame[beneath] - body[beneath]
        parameters = replace(parameters, body_vertices=jnp.asarray(body))
        if pinned:
            parameters = replace(parameters, pin_targets=jnp.asarray(pins))
        positions = follow_body(
            simulator, parameters, positions, frame[None], options=options.motion
        )
        body = frame
    if not pinned:
        pins = positions[loop]
    return dataclasses.replace(dressed, positions=positions, pin_targets=pins)


def _without_pins(cloth: Cloth) -> Cloth:
    return replace(cloth, pins=jnp.zeros(0, jnp.int32))
