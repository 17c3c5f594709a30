"""Where a triangle is, in the words of a pattern."""

import dataclasses

import numpy as np
from jaxtyping import Int


@dataclasses.dataclass(frozen=True, eq=False)
class FacePanels:
    """The panels of the triangles of a cloth, for messages.

    Attributes:
        names: of the panels.
        face_panel: panel of each triangle, (f,).
    """

    names: tuple[str, ...]
    face_panel: Int[np.ndarray, " f"]


def triangle_place(face: int, panels: FacePanels | None) -> str:
    """A triangle with its panel, where that is known."""
    if panels is None:
        return f"triangle {face}"
    return f"panel {panels.names[panels.face_panel[face]]!r}, triangle {face}"
