"""Small patterns around the default body."""

import jax.numpy as jnp
import numpy as np

from dress_jax.body.model import forward, named_shape
from dress_jax.body.poses import named_pose
from dress_jax.io.bodies import load_default_body
from dress_jax.pattern import (
    Pattern,
    discretize,
    parse_specification,
    pattern_parameters,
    placed_positions,
    rest_positions,
)

BACK = [0.0, 180.0, 0.0]


def person(pose: str = "a"):
    """The default body with its feet at y = 0: vertices [m] and faces."""
    model = load_default_body()
    shape = jnp.asarray(named_shape(model, "average"))
    state = forward(model, jnp.asarray(named_pose(pose)), shape, jnp.zeros(3))
    vertices = np.asarray(state.vertices)
    return vertices - [0.0, vertices[:, 1].min(), 0.0], np.asarray(model.faces)


def panel(corners, *, z, y=0.0, back=False):
    """A polygon [cm] in front of (or behind) the body; edges run counter-clockwise."""
    count = len(corners)
    return {
        "vertices": [list(corner) for corner in corners],
        "edges": [{"endpoints": [k, (k + 1) % count]} for k in range(count)],
        "translation": [0.0, y, z],
        "rotation": BACK if back else [0.0, 0.0, 0.0],
    }


def stitched(panels, seams):
    """A pattern; seams are (panel, edge, panel, edge)."""
    stitches = [[{"panel": a, "edge": i}, {"panel": b, "edge": j}] for a, i, b, j in seams]
    document = {
        "pattern": {"panels": panels, "stitches": stitches, "panel_order": list(panels)},
        "parameters": {},
        "parameter_order": [],
        "properties": {
            "curvature_coords": "relative",
            "units_in_meter": 100,
            "normalize_panel_translation": False,
        },
    }
    return parse_specification(document, source="test")


def tube(
    *, top: float, bottom: float, half_width: float, gap: float = 25.0, flare: float = 0.0
) -> Pattern:
    """Two panels sewn at the sides [cm]: a skirt, or a tube top; `flare` widens the hem."""
    return stitched(*tube_parts("tube", top, bottom, half_width, gap, flare))


def tube_parts(
    name: str, top: float, bottom: float, half_width: float, gap: float, flare: float = 0.0
):
    """Panels and seams of a tube."""
    hem = half_width + flare
    corners = [(-hem, bottom), (hem, bottom), (half_width, top), (-half_width, top)]
    panels = {
        f"{name}_front": panel(corners, z=gap),
        f"{name}_back": panel(corners, z=-gap, back=True),
    }
    seams = [
        (f"{name}_front", 1, f"{name}_back", 3),
        (f"{name}_front", 3, f"{name}_back", 1),
    ]
    return panels, seams


def arranged(pattern: Pattern, edge_length: float):
    """Discretization, rest positions and placed positions."""
    made = discretize(pattern, edge_length)
    rest = np.asarray(rest_positions(pattern_parameters(pattern), made))
    return made, rest, np.asarray(placed_positions(rest, made))
