"""Says where on a garment something is wrong, for messages."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.contact.potential import squared_distances, stencils
from dress_jax.geometry.intersection import edge_face_intersections
from dress_jax.geometry.topology import unique_edges
from dress_jax.sim.objective import StepObjective
from dress_jax.sim.simulator import Simulator

_FEW = 4  # panels that a message names before it counts the others


def place(
    simulator: Simulator, vertices: Int[np.ndarray, " k"], point: Float[np.ndarray, "3"]
) -> str:
    """Where some vertices of the cloth are: their panels, as far as named, and a point.

    Args:
        vertices: of the cloth.
        point: [m].
    """
    x, y, z = (f"{coordinate:.3f}" for coordinate in point)
    spot = f"near ({x}, {y}, {z}) m"
    panels = simulator.panels
    if panels is None or not len(vertices):
        return spot
    touched = np.isin(np.asarray(simulator.cloth.faces).T, vertices).any(axis=1)
    names = sorted({panels.names[panel] for panel in np.unique(panels.face_panel[touched])})
    more = f" and {len(names) - _FEW} others" if len(names) > _FEW else ""
    return f"panels {names[:_FEW]}{more}, {spot}"


def place_of_intersections(
    simulator: Simulator, positions: Float[np.ndarray, "n 3"], body: Float[np.ndarray, "b 3"]
) -> str:
    """The panels that intersect themselves, each other or the body, and where the first ones do."""
    n = len(positions)
    everything = np.concatenate([positions, body])
    faces = np.asarray(simulator.cloth.faces).T
    body_faces = simulator.body_faces + n
    weld = np.arange(len(everything))
    if simulator.weld_map is not None:
        weld[:n] = simulator.weld_map
        weld[n:] += int(simulator.weld_map.max()) + 1
    crossing = []
    for edges, triangles in (
        (unique_edges(faces), faces),
        (unique_edges(faces), body_faces),
        (unique_edges(body_faces), faces),
    ):
        pairs = edge_face_intersections(everything, edges, triangles, weld_ids=weld)
        crossing.append(np.concatenate([edges[pairs[:, 0]], triangles[pairs[:, 1]]], axis=1))
    found = np.concatenate(crossing)
    return place(simulator, np.unique(found[found < n]), everything[found[0]].mean(axis=0))


def place_of_closest_pair(objective: StepObjective, positions: Float[np.ndarray, "n 3"]) -> str:
    """The panels and the middle of the pair whose distance over its scale is the smallest."""
    everything = jnp.asarray(objective.together(positions))
    smallest, closest = np.inf, np.zeros(0, np.int64)
    for pairs in objective.pairs(positions):
        points, used = stencils(everything, pairs)
        squared = squared_distances(points, pairs.kind) / pairs.scales**2
        scaled = np.where(np.asarray(used), np.asarray(squared), np.inf)
        if scaled.min() < smallest:
            smallest = scaled.min()
            closest = np.asarray(pairs.indices)[:, int(np.argmin(scaled))]
    own = closest[closest < len(positions)]
    return place(objective.simulator, own, np.asarray(everything)[own].mean(axis=0))
