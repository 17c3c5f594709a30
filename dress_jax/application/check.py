"""Recount what a result claims, from its files and by other code than the solver's."""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from dress_jax.geometry.intersection import count_intersections, minimum_distance
from dress_jax.geometry.topology import boundary_loops
from dress_jax.io.meshes import GarmentMesh, read_garment_obj
from dress_jax.io.obj import read_obj
from dress_jax.io.results import DrapedState, read_result
from dress_jax.pattern.model import Pattern


@dataclasses.dataclass(frozen=True)
class Recount:
    """One mesh recounted.

    Attributes:
        source: the file.
        vertices, faces: their numbers.
        self_intersections, body_intersections: pairs of an edge and a face, decided exactly.
        min_distance: of all pairs that share no vertex, body included [m].
        seams: stitches of the pattern.
        open_seams: stitches with a pair of panel vertices that are not one vertex.
        seam_gap: largest distance of such a pair [m].
        boundary_loops: free edges of the sewn garment, as closed loops.
    """

    source: str
    vertices: int
    faces: int
    self_intersections: int
    body_intersections: int
    min_distance: float
    seams: int
    open_seams: int
    seam_gap: float
    boundary_loops: int

    @property
    def intersection_free(self) -> bool:
        """Nothing meets anything."""
        return self.self_intersections == 0 and self.body_intersections == 0

    @property
    def good(self) -> bool:
        """Free of intersections, and sewn."""
        return self.intersection_free and self.open_seams == 0


def check_result(folder: str | Path) -> list[Recount]:
    """Recount a result folder: the exact state, and the meshes as they were written.

    Args:
        folder: written by `save_drape` or a fit.

    Raises:
        InputError: a file is missing or damaged.
    """
    folder = Path(folder)
    state, pattern = read_result(folder)
    body = read_obj(folder / "body.obj")
    written = read_garment_obj(folder / "garment.obj")
    return [
        recount("drape.h5", state, pattern, state.garment, state.weld_map),
        recount(
            "garment.obj",
            dataclasses.replace(state, body_vertices=body.vertices, body_faces=body.faces),
            pattern,
            written,
            weld_of_corners(written),
        ),
    ]


def recount(
    source: str,
    state: DrapedState,
    pattern: Pattern,
    garment: GarmentMesh,
    weld_map: Int[np.ndarray, " p"],
) -> Recount:
    """Recount one mesh.

    Args:
        source: its name.
        state: holds the body and the pairs that are to be sewn.
        pattern: holds the stitches.
        garment: the mesh.
        weld_map: vertex of each panel vertex, shape (p,).
    """
    body = (state.body_vertices, state.body_faces) if len(state.body_faces) else (None, None)
    crossings = count_intersections(garment.vertices, garment.faces, *body)
    gaps, apart = _pairs(state, garment.vertices, weld_map)
    stitch = np.repeat(np.arange(len(state.seam_offset) - 1), np.diff(state.seam_offset))
    missing = max(len(pattern.stitches) - (len(state.seam_offset) - 1), 0)
    return Recount(
        source=source,
        vertices=len(garment.vertices),
        faces=len(garment.faces),
        self_intersections=crossings.self,
        body_intersections=crossings.body,
        min_distance=minimum_distance(garment.vertices, garment.faces, *body),
        seams=len(pattern.stitches),
        open_seams=len(np.unique(stitch[apart])) + missing,
        seam_gap=float(np.max(gaps, initial=0.0)),
        boundary_loops=len(boundary_loops(garment.faces)),
    )


def weld_of_corners(garment: GarmentMesh) -> Int[np.ndarray, " p"]:
    """The vertex of each texture coordinate, as the faces of a mesh file pair them; -1 for none."""
    weld_map = np.full(len(garment.rest_positions), -1, np.int64)
    weld_map[garment.rest_faces.ravel()] = garment.faces.ravel()
    return weld_map


def _pairs(
    state: DrapedState, vertices: Float[np.ndarray, "n 3"], weld_map: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gap of every sewn pair [m], and whether its two sides are different vertices."""
    sides = weld_map[state.seam_vertices]
    gaps = np.linalg.norm(vertices[sides[:, 0]] - vertices[sides[:, 1]], axis=1)
    return gaps, sides[:, 0] != sides[:, 1]
