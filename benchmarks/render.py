"""Times of rendering a 22,000-triangle scene: forward, and forward with gradient, per view.

    python benchmarks/render.py [--sizes 256 512] [--views 8] [--json times.json]

Seven channels (mask, colour, normal) against constant targets, gradient with respect to the
garment's vertices. Best and median of several runs; load on the machine shows up in the median.
"""

import argparse
import json
import statistics
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from dress_jax.core.pytree import replace
from dress_jax.render.attributes import find_visibility
from dress_jax.render.cameras import stack_cameras
from dress_jax.render.images import render
from dress_jax.render.mesh import RenderMesh, join_meshes, make_render_mesh
from dress_jax.render.rings import frame_body, magicman_cameras
from dress_jax.render.views import mean_over_views


def tube(around: int, along: int, radius, low: float, high: float) -> RenderMesh:
    """An upright tube; `radius` gives metres from angle and height in [0, 1]."""
    angle, level = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0.0, 1.0, along))
    r = radius(angle, level)
    points = np.stack([r * np.sin(angle), low + (high - low) * level, r * np.cos(angle)], axis=-1)
    here = np.arange(around)
    after = (here + 1) % around
    faces = []
    for row in range(along - 1):
        a, b = row * around + here, row * around + after
        c, d = a + around, b + around
        faces += [np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]
    return make_render_mesh(
        points.reshape(-1, 3).astype(np.float32),
        np.concatenate(faces),
        colors=np.random.default_rng(0).random((around * along, 3)).astype(np.float32),
    )


def scene() -> tuple[RenderMesh, RenderMesh]:
    """A wrinkled open dress over a body-sized capsule: about 10,000 and 12,000 triangles."""
    dress = tube(
        72,
        70,
        lambda a, v: (
            0.17
            + 0.25 * (1 - v) ** 1.5
            + 0.02 * np.sin(9 * a + 3 * v) * (1 - v)
            + 0.004 * np.sin(31 * a + 40 * v)
        ),
        0.45,
        1.4,
    )
    body = tube(
        78, 78, lambda a, v: 0.14 * np.sqrt(np.maximum(1 - (2 * v - 1) ** 8, 1e-4)), 0.0, 1.7
    )
    return dress, body


def loss(operands, camera):
    image = render(camera, *operands)
    return sum(jnp.mean(jnp.abs(a - 0.3)) for a in (image.mask, image.color, image.normal))


def timed(function, *arguments, runs: int) -> dict[str, float]:
    start = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    first = time.perf_counter() - start
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return {"first_s": first, "best_s": min(times), "median_s": statistics.median(times)}


def measure(size: int, views: int, runs: int) -> dict[str, dict[str, float]]:
    """Times of one image size."""
    garment, body = scene()
    center, half_extent = frame_body(np.asarray(body.positions))
    cameras = magicman_cameras(views, center=center, half_extent=half_extent, size=size)
    stack = stack_cameras(cameras)

    def slope(positions, garment, body, cameras):
        def mean(positions):
            return mean_over_views(loss, (replace(garment, positions=positions), body), cameras)

        return jax.value_and_grad(mean)(positions)

    def one(positions, garment, body, camera):
        return jax.value_and_grad(lambda p: loss((replace(garment, positions=p), body), camera))(
            positions
        )

    def visibility(camera, garment, body):
        return find_visibility(camera, *join_meshes(garment, body))

    camera, positions = cameras[min(1, views - 1)], garment.positions
    return {
        "visibility, 1 view": timed(jax.jit(visibility), camera, garment, body, runs=runs),
        "forward, 1 view": timed(jax.jit(render), camera, garment, body, runs=runs),
        "forward + backward, 1 view": timed(
            jax.jit(one), positions, garment, body, camera, runs=runs
        ),
        f"forward + backward, {views} views": timed(
            jax.jit(slope), positions, garment, body, stack, runs=runs
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[256, 512])
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    report = {"device": jax.devices()[0].platform, "jax": jax.__version__, "sizes": {}}
    print(f"{'image':>6} {'':32} {'best':>9} {'median':>9} {'first':>8}")
    for size in options.sizes:
        rows = measure(size, options.views, options.runs)
        report["sizes"][str(size)] = rows
        for name, row in rows.items():
            print(
                f"{size:6d} {name:32} {1e3 * row['best_s']:7.1f}ms {1e3 * row['median_s']:7.1f}ms "
                f"{row['first_s']:7.1f}s"
            )
    text = json.dumps(report, indent=1)
    if options.json is None:
        print(text)
    else:
        options.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
