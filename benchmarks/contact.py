"""Times of the contact building blocks beside ipctk's, on cloth lying closely above a body.

The ratios do not correct for differences of the jobs: ipctk also lists pairs within the body
(leaving them out takes a Python callback per pair), keeps all pairs of close boxes, and may use
several threads; its intersection test stops at the first hit.

    python benchmarks/contact.py [cloth vertices per side ...]
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import ipctk
import jax
import jax.numpy as jnp
import numpy as np

from dress_jax.contact.broad_phase import find_candidates, make_broad_phase, make_collision_mesh
from dress_jax.contact.candidates import gather, make_candidates
from dress_jax.contact.ccd import step_bound
from dress_jax.geometry.distance import edge_edge_squared, vertex_face_squared
from dress_jax.geometry.intersection import count_intersections

BODY_SIDE = 110
RADIUS = 1e-3
REPEATS = 7


def hill(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A square of one metre, raised in its middle."""
    s = np.linspace(0.0, 1.0, side)
    x, z = (a.ravel() for a in np.meshgrid(s, s, indexing="ij"))
    height = 0.3 * np.exp(-8.0 * ((x - 0.5) ** 2 + (z - 0.5) ** 2))
    i = np.arange(side * side).reshape(side, side)
    lower = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    return np.stack([x, height, z], axis=1), np.concatenate([lower, upper])


def milliseconds(function: Callable[[], Any]) -> float:
    """Median time after one call to warm up."""
    jax.block_until_ready(function())
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def measure(side: int) -> list[tuple[str, float, float | None]]:
    """Rows (name, milliseconds, milliseconds of ipctk) for one size of the cloth."""
    rng = np.random.default_rng(0)
    cloth, cloth_faces = hill(side)
    body, body_faces = hill(BODY_SIDE)
    cloth += np.array([0.0, 0.004, 0.0]) + 5e-4 * rng.normal(size=cloth.shape)
    start = np.concatenate([cloth, body])
    end = start.copy()
    end[: len(cloth)] += 1e-3 * rng.normal(size=cloth.shape)

    mesh = make_collision_mesh(cloth_faces, len(cloth), body_faces, len(body))
    state = make_broad_phase(mesh, start)
    pairs = find_candidates(state, start, end, RADIUS)
    candidates = make_candidates(*pairs)
    x, dx = jnp.asarray(start), jnp.asarray(end - start)
    print(
        f"{len(cloth)} cloth + {len(body)} body vertices: {len(pairs[0])} vertex-face and "
        f"{len(pairs[1])} edge-edge candidates"
    )

    # Distances of many pairs, so that the kernels and not the call overhead are measured.
    wide = find_candidates(state, start, start, 0.012)
    many = make_candidates(*wide)
    kernels = []
    for squared, indices, count in (
        (vertex_face_squared, many.vertex_face, many.vertex_face_count),
        (edge_edge_squared, many.edge_edge, many.edge_edge_count),
    ):
        kernel = jax.jit(squared)
        points = jax.jit(gather)(x, indices, count)
        kernels.append(milliseconds(lambda k=kernel, p=points: k(p)))

    def peer_candidates():
        found = ipctk.Candidates()
        found.build(peer, start, end, RADIUS)
        return found

    edges = np.concatenate([mesh.cloth_edges, mesh.body_edges])
    faces = np.concatenate([mesh.cloth_faces, mesh.body_faces])
    peer = ipctk.CollisionMesh(start, edges, faces)
    n = len(cloth)
    found = peer_candidates()
    return [
        (
            "broad phase",
            milliseconds(lambda: find_candidates(state, start, end, RADIUS, body_moved=False)),
            milliseconds(peer_candidates),
        ),
        (f"{len(wide[0])} vertex-face distances", kernels[0], None),
        (f"{len(wide[1])} edge-edge distances", kernels[1], None),
        (
            "CCD step bound",
            milliseconds(lambda: step_bound(x, dx, candidates, min_distance=0.0)),
            milliseconds(
                lambda: found.compute_collision_free_stepsize(
                    peer, start, end, 0.0, ipctk.AdditiveCCD()
                )
            ),
        ),
        (
            "exact intersection count",
            milliseconds(
                lambda: count_intersections(start[:n], cloth_faces, body, body_faces).self
            ),
            milliseconds(lambda: ipctk.has_intersections(peer, start)),
        ),
    ]


def main() -> None:
    """Print a table for each size."""
    jax.config.update("jax_enable_x64", True)
    for side in [int(a) for a in sys.argv[1:]] or [50, 100]:
        rows = measure(side)
        print(f"{'':32s} {'ms':>9s} {'ipctk ms':>9s} {'ratio':>7s}")
        for name, mine, peer in rows:
            ratio = f"{peer:9.1f} {peer / mine:6.1f}x" if peer is not None else ""
            print(f"{name:32s} {mine:9.2f} {ratio}")
        print()


if __name__ == "__main__":
    main()
