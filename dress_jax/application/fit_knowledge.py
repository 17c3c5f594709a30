"""What a fit's observations tell and what they leave open, as numbers and as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.io.knowledge_figure import OpenDirection, write_knowledge_figure
from dress_jax.optimisation import FitProblem, Uncertainty
from dress_jax.optimisation.gauss_newton.vector import from_vector
from dress_jax.optimisation.problem import validated_pattern
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern import Pattern, with_parameters

NORMAL_95 = 1.96
"""Half of an interval that holds 95 % of a normal distribution, in standard deviations."""

_SHARE = 0.3  # of a direction's largest change, from which an edge is named
_SHOWN, _EXAGGERATED = 3, 3.0  # directions in the picture, and how much larger they are drawn


def knowledge_report(problem: FitProblem, pattern: Pattern, found: Uncertainty) -> dict[str, Any]:
    """The intervals and open directions, ready for `report.json`.

    `told` is the share of what was unknown that the observations tell.

    Args:
        problem: what was fitted.
        pattern: the fitted pattern.
        found: from `find_uncertainty`.
    """
    places = edge_places(pattern)
    half = NORMAL_95 * found.length_deviation
    edges = [
        {
            "panel": panel,
            "edge": edge,
            "length_cm": 100.0 * length,
            "interval_95_cm": [100.0 * (length - way), 100.0 * (length + way)],
            "told": told,
        }
        for (panel, edge), length, way, told in zip(
            places, found.lengths, half, found.length_told, strict=True
        )
    ]
    table = problem.tables.fabric
    fabric = {}
    numbers = (found.fabric, found.fabric_deviation, found.fabric_told)
    for name, kind, value, deviation, told in zip(table.names, table.kinds, *numbers, strict=True):
        ends = [value - NORMAL_95 * deviation, value + NORMAL_95 * deviation]
        fabric[name] = {
            "value": np.exp(value) if kind.is_factor else value,
            "interval_95": np.exp(ends).tolist() if kind.is_factor else ends,
            "told": told,
        }
    return {
        "edges": edges,
        "fabric": fabric,
        "open_directions": [
            {
                "deviation_cm": 100.0 * float(np.linalg.norm(direction)),
                "edges": [
                    {"panel": panel, "edge": edge, "change_cm": 100.0 * change}
                    for (panel, edge), change in zip(places, direction, strict=True)
                    if abs(change) >= _SHARE * np.abs(direction).max()
                ],
            }
            for direction in found.directions
        ],
        "remaining_differences": {
            kind.value: {"deviation": found.noise[kind], "independent": found.independent[kind]}
            for kind in found.noise
        },
    }


def write_knowledge(
    path: str | Path, problem: FitProblem, pattern: Pattern, unknowns: Unknowns, found: Uncertainty
) -> None:
    """The same as a picture: edges by the width of their intervals, and the open directions.

    Args:
        path: the PNG file.
        problem: what was fitted.
        pattern: the fitted pattern.
        unknowns: of the fit.
        found: from `find_uncertainty`.
    """
    deviations = 100.0 * NORMAL_95 * found.length_deviation / found.lengths
    by_panel, first = {}, 0
    for panel in pattern.panels:
        by_panel[panel.name] = deviations[first : first + len(panel.edges)]
        first += len(panel.edges)
    directions = []
    for way, lengths in zip(found.ways[:_SHOWN], found.directions, strict=False):
        change = from_vector(way, unknowns).pattern
        moved = [
            with_parameters(
                problem.pattern,
                validated_pattern(
                    problem,
                    type(change)(
                        vertices=unknowns.pattern.vertices + sign * change.vertices,
                        controls=unknowns.pattern.controls + sign * change.controls,
                    ),
                ),
            )
            for sign in (_EXAGGERATED, -_EXAGGERATED)
        ]
        directions.append(OpenDirection(100.0 * float(np.linalg.norm(lengths)), *moved))
    report = knowledge_report(problem, pattern, found)["fabric"]
    fabric = {name: (own["value"], *own["interval_95"]) for name, own in report.items()}
    write_knowledge_figure(path, pattern, by_panel, fabric, directions)


def edge_places(pattern: Pattern) -> list[tuple[str, int]]:
    """Panel and number of every edge, in the pattern's order."""
    return [(p.name, number) for p in pattern.panels for number in range(len(p.edges))]
