"""Discretize a pattern: sample, triangulate, weld (host; checklist S5.1 to S5.6)."""

import math

import numpy as np
from jaxtyping import Int

from dress_jax.core.errors import InputError
from dress_jax.geometry.harmonic import harmonic_coordinates
from dress_jax.geometry.polygons import signed_area
from dress_jax.geometry.triangulation import TriangulationError, triangulate
from dress_jax.pattern.discretization import Discretization
from dress_jax.pattern.model import Pattern
from dress_jax.pattern.orientation import consistent_signs
from dress_jax.pattern.parameters import edge_table
from dress_jax.pattern.sampling import (
    edge_count_minimum,
    panel_samples,
    resolve_crossings,
    stitched_edges,
)
from dress_jax.pattern.validation import place, validate
from dress_jax.pattern.welding import PanelMesh, faulty_segments, split_faulty_edges, weld

_MAX_ATTEMPTS = 5


def discretize(pattern: Pattern, edge_length: float) -> Discretization:
    """Mesh every panel and sew the meshes.

    Both sides of a seam get the same samples (the longer edge decides), uniform in arc length; a
    curve turns at most 30 degrees per segment. The outline is kept exactly.

    Args:
        pattern: the pattern; it is validated first.
        edge_length: wanted length of mesh edges [m].

    Returns:
        The frozen discretization.

    Raises:
        InputError: a bad edge length, an invalid pattern, a panel that cannot be triangulated, or
            seams that weld a mesh edge into a point or into more than two triangles. The message
            names panel, edge or stitch.
    """
    if not math.isfinite(edge_length) or edge_length <= 0.0:
        raise InputError(
            f"the edge length is {edge_length!r}",
            where=pattern.source,
            mend="give a positive length in metres",
        )
    validate(pattern)
    stitched = stitched_edges(pattern)
    flips = np.array([stitch.reversed for stitch in pattern.stitches], dtype=bool)
    counts = resolve_crossings(pattern, edge_count_minimum(pattern, edge_length), stitched)
    for _ in range(_MAX_ATTEMPTS):
        faulty, label = _check_outlines(counts, pattern, stitched, flips)
        if not faulty.any():
            break
        counts = resolve_crossings(pattern, counts + faulty, stitched)
    else:
        raise _weld_error(pattern, int(np.argmax(faulty)))
    return _assemble(pattern, edge_length, counts, stitched, flips, label)


def _outline_layout(
    counts: Int[np.ndarray, "E"], pattern: Pattern
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Number outline vertices over all panels.

    Returns:
        First outline vertex of each panel and their total, shape (panels + 1,); for every edge its
        outline vertices from start to end.
    """
    offsets, samples, number, base = [0], [], 0, 0
    for panel in pattern.panels:
        own = counts[number : number + len(panel.edges)].tolist()
        total, start = sum(own), 0
        for count in own:
            samples.append(base + (start + np.arange(count + 1)) % total)
            start += count
        number += len(panel.edges)
        base += total
        offsets.append(base)
    return np.array(offsets), samples


def _seam_pairs(
    samples: list[np.ndarray], stitched: np.ndarray, flips: np.ndarray
) -> list[np.ndarray]:
    """For every stitch its pairs of vertices, shape (segments + 1, 2)."""
    pairs = []
    for (first, second), flipped in zip(stitched, flips, strict=True):
        other = samples[second][::-1] if flipped else samples[second]
        pairs.append(np.stack([samples[first], other], axis=1))
    return pairs


def _check_outlines(
    counts: np.ndarray, pattern: Pattern, stitched: np.ndarray, flips: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edges that need another sample because of how the seams weld, and the outline's weld map.

    Returns:
        Mask of faulty edges, shape (E,); welded vertex of each outline vertex, shape (B,).
    """
    offsets, samples = _outline_layout(counts, pattern)
    pairs = _seam_pairs(samples, stitched, flips)
    joined = np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])
    label = weld(joined, int(offsets[-1]))
    first_segment = np.cumsum([0, *counts]).tolist()
    ends = np.concatenate([np.stack([s[:-1], s[1:]], axis=1) for s in samples])
    owner = np.repeat(np.arange(len(counts)), counts)
    twin = np.full(len(ends), -1)
    for (first, second), flipped in zip(stitched.tolist(), flips, strict=True):
        own = np.arange(first_segment[first], first_segment[first + 1])
        other = np.arange(first_segment[second], first_segment[second + 1])
        other = other[::-1] if flipped else other
        twin[own], twin[other] = other, own
    faulty = np.zeros(len(counts), dtype=bool)
    faulty[owner[faulty_segments(ends, twin, label)]] = True
    return faulty, label


def _weld_error(pattern: Pattern, edge: int) -> InputError:
    table = edge_table(pattern)
    panel = int(table.panel[edge])
    local = edge - int(np.argmax(table.panel == panel))
    return InputError(
        "sewing folds this edge onto itself or onto an edge that it is not stitched to",
        where=place(pattern.source, pattern.panels[panel].name, local),
        mend="check the stitches at its two ends; one of them joins the wrong edges or directions",
    )


def _mesh_panels(
    pattern: Pattern, edge_length: float, counts: np.ndarray
) -> tuple[list[PanelMesh], list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Triangulate all panels.

    Returns:
        Meshes; curve parameters and edge numbers of the outline, per panel; signed areas [m^2].
    """
    meshes, parameters, owners, areas, base = [], [], [], [], 0
    for panel in pattern.panels:
        own = counts[base : base + len(panel.edges)]
        outline, t, owner = panel_samples(panel, own)
        try:
            points, faces = triangulate(outline, edge_length)
        except TriangulationError as error:
            x, y = 100.0 * error.point
            raise InputError(
                f"the panel cannot be triangulated near ({x:.2f}, {y:.2f}) cm: {error}",
                where=place(pattern.source, panel.name),
                mend="look for nearly touching edges there, or use a smaller edge length",
            ) from error
        meshes.append(PanelMesh(points, faces, len(outline)))
        parameters.append(t)
        owners.append(owner + base)
        areas.append(signed_area(outline))
        base += len(panel.edges)
    return meshes, parameters, owners, np.array(areas)


def _assemble(
    pattern: Pattern,
    edge_length: float,
    counts: np.ndarray,
    stitched: np.ndarray,
    flips: np.ndarray,
    label: np.ndarray,
) -> Discretization:
    meshes, parameters, owners, areas = _mesh_panels(pattern, edge_length, counts)
    table = edge_table(pattern)
    sewn = table.panel[stitched]
    follows = consistent_signs(np.abs(areas), sewn, flips)
    orientation = np.where(areas > 0.0, 1, -1) * follows
    outline_offset, samples = _outline_layout(counts, pattern)
    meshes = split_faulty_edges(meshes, np.split(label, outline_offset[1:-1]))
    sizes = np.array([len(mesh.points) for mesh in meshes])
    panel_offset = np.concatenate([[0], np.cumsum(sizes)])
    # Outline numbers to panel-vertex numbers.
    panel_of_outline = np.repeat(np.arange(len(meshes)), np.diff(outline_offset))
    to_vertex = (
        np.arange(outline_offset[-1]) + (panel_offset[:-1] - outline_offset[:-1])[panel_of_outline]
    )
    samples = [to_vertex[own] for own in samples]
    pairs = [own[own[:, 0] != own[:, 1]] for own in _seam_pairs(samples, stitched, flips)]
    seam_vertices = np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])
    weld_map = weld(seam_vertices, int(panel_offset[-1]))
    rest_faces = np.concatenate(
        [
            (mesh.faces if turn > 0 else mesh.faces[:, ::-1]) + base
            for mesh, turn, base in zip(meshes, orientation, panel_offset, strict=False)
        ]
    )
    return Discretization(
        edges=table,
        sample_edge=np.concatenate(owners).astype(np.int32),
        sample_t=np.concatenate(parameters),
        harmonic=tuple(
            harmonic_coordinates(mesh.points, mesh.faces, mesh.boundary_count) for mesh in meshes
        ),
        rest_faces=rest_faces.astype(np.int32),
        face_panel=np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes]).astype(
            np.int32
        ),
        panel_of_vertex=np.repeat(np.arange(len(meshes)), sizes).astype(np.int32),
        panel_offset=panel_offset.astype(np.int32),
        seam_vertices=seam_vertices.astype(np.int32),
        seam_offset=np.cumsum([0] + [len(own) for own in pairs]).astype(np.int32),
        stitch_edges=stitched.astype(np.int32),
        weld_map=weld_map.astype(np.int32),
        faces=weld_map[rest_faces].astype(np.int32),
        edge_samples=np.concatenate(samples).astype(np.int32),
        edge_sample_offset=np.cumsum([0] + [len(own) for own in samples]).astype(np.int32),
        edge_offset=np.cumsum([0] + [len(p.edges) for p in pattern.panels]).astype(np.int32),
        orientation=orientation.astype(np.int32),
        seam_consistent=(follows[sewn[:, 0]] == follows[sewn[:, 1]]) == flips,
        rotation=np.stack([panel.rotation for panel in pattern.panels]),
        translation=np.stack([panel.translation for panel in pattern.panels]),
        meshed_positions=np.concatenate([mesh.points for mesh in meshes]),
        vertex_count=int(weld_map.max()) + 1,
        edge_length=float(edge_length),
        panel_names=tuple(panel.name for panel in pattern.panels),
    )
