"""One interface of the broad phases: trees on the host, and trees on the device.

Both find the same pairs, in the same order. Those that compiled code then works on stay where they
were found.
"""

from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.contact.broad_phase import CollisionMesh, find_candidates, make_broad_phase
from dress_jax.contact.candidates import Candidates, candidate_capacity, make_candidates
from dress_jax.contact.device_search import columns, search
from dress_jax.contact.device_trees import fit, plant
from dress_jax.contact.potential import PairKind
from dress_jax.core.buckets import bucket_size
from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64

Points = Float[np.ndarray, "n 3"] | Float[Array, "n 3"]
Rows = tuple[Int[np.ndarray, "m 4"], Int[np.ndarray, "k 4"]]

# Pairs that a search on the device works on at a time, at most: a graphics processor wants more of
# them than a processor with a cache. A small mesh has no use for many: one for so many leaves.
_CPU_CHUNK, _DEVICE_CHUNK, _SMALLEST_CHUNK = 1 << 15, 1 << 17, 1 << 10
_LEAVES_PER_LANE = 4
_VERTEX_GROWTH = 1.2  # of the bucket of vertices: garments of similar size share programs
_FIRST_CAPACITY = candidate_capacity(100_000)


class PairFinder(Protocol):
    """Finds the pairs of a mesh that can come close; made by `make_pair_finder`.

    Attributes:
        name: by which it is chosen.
        on_device: whether the pairs it finds are on the device, and better stay there.
        mesh: the primitives.
    """

    @property
    def name(self) -> str:
        """By which it is chosen."""
        ...

    @property
    def on_device(self) -> bool:
        """Whether the pairs it finds are on the device, and better stay there."""
        ...

    @property
    def mesh(self) -> CollisionMesh:
        """The primitives."""
        ...

    def find(
        self,
        start: Points,
        end: Points,
        radius: float | Float[np.ndarray, " n"],
        *,
        body_moved: bool = True,
        body_offset: int | None = None,
        scales: Float[np.ndarray, " s"] | None = None,
    ) -> Candidates:
        """Every pair that can come within its radius in a linear motion, padded.

        Args:
            start, end, radius: see `broad_phase.find_candidates`, as for errors.
            body_moved: False where the body is where it was in the previous call; its boxes may
                then be kept.
            body_offset: number of the body's first vertex in the result. Default: as in the mesh.
            scales: factors of the lengths of contact at the vertices, numbered as in the result.
        """
        ...

    def rows(
        self,
        start: Points,
        end: Points,
        radius: float | Float[np.ndarray, " n"],
        *,
        body_moved: bool = True,
    ) -> Rows:
        """The same on the host, as `broad_phase.find_candidates` returns them."""
        ...


class TreeFinder:
    """Box trees on the host."""

    name, on_device = "trees", False

    def __init__(self, mesh: CollisionMesh, positions: Float[np.ndarray, "n 3"]):
        self.mesh = mesh
        self._trees = make_broad_phase(mesh, positions)

    def find(
        self, start, end, radius, *, body_moved=True, body_offset=None, scales=None
    ) -> Candidates:
        """See `PairFinder.find`."""
        n = self.mesh.n_cloth
        shift = 0 if body_offset is None else body_offset - n
        rows = self.rows(start, end, radius, body_moved=body_moved)
        return make_candidates(*(np.where(r < n, r, r + shift) for r in rows), scales=scales)

    def rows(self, start, end, radius, *, body_moved=True) -> Rows:
        """See `PairFinder.rows`."""
        start, end = np.asarray(start), np.asarray(end)
        return find_candidates(self._trees, start, end, radius, body_moved=body_moved)


class DeviceFinder:
    """Box trees in compiled code, on whatever jax computes with.

    What comes to the host are two counts, and whether the input is sound. Where a count exceeds the
    capacity of its list, the list is thrown away and the search repeated with more room.
    """

    name, on_device = "device", True

    def __init__(
        self,
        mesh: CollisionMesh,
        positions: Float[np.ndarray, "n 3"],
        *,
        chunk: int | None = None,
        capacity: int = _FIRST_CAPACITY,
    ):
        """Build the trees.

        Args:
            mesh: the primitives.
            positions: typical positions [m], shape (n, 3).
            chunk: number of pairs that are worked on at a time. Default: by backend and mesh.
            capacity: number of pairs of a family that the first search has room for.
        """
        require_float64("DeviceFinder")
        self.mesh = mesh
        self._size = bucket_size(mesh.n, growth=_VERTEX_GROWTH)
        self._forest = plant(mesh, np.asarray(positions, np.float64))
        self._welds = jnp.asarray(self._filled(mesh.weld_ids))
        if chunk is None:
            largest = _CPU_CHUNK if jax.default_backend() == "cpu" else _DEVICE_CHUNK
            leaves = self._forest.counts[0]
            chunk = min(max(bucket_size(leaves // _LEAVES_PER_LANE), _SMALLEST_CHUNK), largest)
        self._chunk = chunk
        self.capacities = dict.fromkeys(PairKind, capacity)

    def find(
        self, start, end, radius, *, body_moved=True, body_offset=None, scales=None
    ) -> Candidates:
        """See `PairFinder.find`; all boxes are fitted anew."""
        found = self._search(start, end, radius)
        first_body = jnp.asarray(self.mesh.n_cloth, jnp.int32)
        offset = first_body if body_offset is None else jnp.asarray(body_offset, jnp.int32)
        factors = None if scales is None else jnp.asarray(scales)
        (vertex_face, vertex_face_scales), (edge_edge, edge_edge_scales) = (
            columns(
                self._forest,
                keys,
                count,
                first_body,
                offset,
                factors,
                kind=kind,
                capacity=candidate_capacity(number),
            )
            for kind, (keys, count, number) in found.items()
        )
        return Candidates(
            vertex_face=vertex_face,
            edge_edge=edge_edge,
            vertex_face_count=found[PairKind.VERTEX_FACE][1].astype(jnp.int32),
            edge_edge_count=found[PairKind.EDGE_EDGE][1].astype(jnp.int32),
            vertex_face_scales=vertex_face_scales,
            edge_edge_scales=edge_edge_scales,
        )

    def rows(self, start, end, radius, *, body_moved=True) -> Rows:
        """See `PairFinder.rows`."""
        found = self.find(start, end, radius)
        vertex_face, edge_edge = np.asarray(found.vertex_face), np.asarray(found.edge_edge)
        return (
            vertex_face[:, : int(found.vertex_face_count)].T,
            edge_edge[:, : int(found.edge_edge_count)].T,
        )

    def _filled(self, values):
        """Values at the vertices, with zeros up to the bucket; where they are."""
        wide = [(0, self._size - self.mesh.n), *[(0, 0)] * (values.ndim - 1)]
        return jnp.pad(values, wide) if isinstance(values, jax.Array) else np.pad(values, wide)

    def _points(self, points: Points, name: str) -> Float[Array, "p 3"]:
        if points.shape != (self.mesh.n, 3):
            raise InputError(f"shape {points.shape}, expected ({self.mesh.n}, 3)", where=name)
        return jnp.asarray(self._filled(points), jnp.float64)

    def _search(self, start, end, radius) -> dict[PairKind, tuple[Array, Array, int]]:
        """Keys of all pairs of each family, and their number on the device and on the host."""
        x, y = self._points(start, "start"), self._points(end, "end")
        radii = np.broadcast_to(np.asarray(radius, np.float64), self.mesh.n)
        radii = jnp.asarray(self._filled(radii))
        boxes, sound = fit(self._forest, x, y, radii)

        def searched(kind: PairKind) -> tuple[Array, Array]:
            return search(
                self._forest,
                boxes,
                x,
                y,
                radii,
                self._welds,
                kind=kind,
                chunk=self._chunk,
                capacity=self.capacities[kind],
            )

        # Both searches are on their way before the first number is waited for.
        found = {kind: searched(kind) for kind in PairKind}
        flags, *numbers = jax.device_get([sound, *(count for _, count in found.values())])
        if not flags[2]:
            raise InputError(f"radius is {radius}", mend="give distances of at least 0")
        for is_finite, name in zip(flags[:2], ("start", "end"), strict=True):
            if not is_finite:
                raise InputError("positions that are not finite", where=name)
        for kind, number in zip(PairKind, numbers, strict=True):
            if number > self.capacities[kind]:
                self.capacities[kind] = candidate_capacity(int(number))
                found[kind] = searched(kind)
        return {
            kind: (*found[kind], int(number))
            for kind, number in zip(PairKind, numbers, strict=True)
        }


_FINDERS = {"trees": TreeFinder, "device": DeviceFinder}


def make_pair_finder(
    name: str, mesh: CollisionMesh, positions: Float[np.ndarray, "n 3"]
) -> PairFinder:
    """The broad phase of a name.

    Args:
        name: "trees", "device", or "auto": trees where jax computes on the processor, where they
            are several times faster, and device everywhere else.
        mesh: the primitives.
        positions: typical positions [m], shape (n, 3); they shape the trees, not the results.

    Raises:
        InputError: there is no broad phase of this name.
    """
    if name == "auto":
        name = "trees" if jax.default_backend() == "cpu" else "device"
    if name not in _FINDERS:
        raise InputError(
            f"there is no broad phase {name!r}",
            where="broad_phase",
            mend=f"choose one of auto, {', '.join(_FINDERS)}",
        )
    return _FINDERS[name](mesh, positions)
