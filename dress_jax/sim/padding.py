"""Shape buckets of a simulation: garments of similar size share their compiled programs.

Compiled programs see arrays of a few sizes only. What fills them up are a flat square of two
triangles at rest, and copies of its first triangle: no energy, and no place in the matrix, so that
their weight moves nothing. Everything else (the Newton loop, the broad phase, the matrix, what goes
in and out of a solve) has the true sizes.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.buckets import bucket_size
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Cloth, Parameters, make_cloth
from dress_jax.energy.elastic import TimeStep

# Capacities grow in small steps: every program pays for what is padded.
_GROWTH = 1.2
_SMALLEST_FACES, _SMALLEST_BODY, _SMALLEST_LIST = 128, 256, 64
# Of a garment's mesh relative to its triangles. With all of them tied to one number, garments share
# all of their programs or none.
_VERTEX_SHARE, _PANEL_VERTEX_SHARE, _HINGE_SHARE = 0.6, 0.65, 1.5

_SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
_SQUARE_FACES = np.array([[0, 1, 2], [1, 3, 2]])

# What the first axis of a leaf of `Parameters` counts, where it has one that is padded.
_COUNTED = {
    "rest_positions": "panel_vertices",
    "density": "faces",
    "stretching_stiffness": "faces",
    "bending_stiffness": "hinges",
    "pin_targets": "pins",
    "body_vertices": "body_vertices",
}


@dataclasses.dataclass(frozen=True)
class Sizes:
    """Lengths of the arrays of a simulation."""

    vertices: int
    panel_vertices: int
    faces: int
    hinges: int
    pins: int
    stitches: int
    body_vertices: int


@dataclasses.dataclass(frozen=True, eq=False)
class Padding:
    """Between arrays of true and of padded sizes; made by `make_padding`.

    Attributes:
        cloth: the cloth, padded.
        true, padded: the sizes. The vertices of the body follow those of the cloth.
    """

    cloth: Cloth
    true: Sizes
    padded: Sizes

    def positions(self, x: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n_padded 3"]:
        """Positions of the cloth; the square is where it is at rest [m]."""
        padded = _filled(x, self.padded.vertices)
        n = self.true.vertices
        padded[n : n + len(_SQUARE)] = _SQUARE
        return padded

    def vectors(self, v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n_padded 3"]:
        """Displacements, velocities or forces of the cloth; zero where padded."""
        return _filled(v, self.padded.vertices)

    def body(self, x: Float[np.ndarray, "b *c"]) -> Float[np.ndarray, "b_padded *c"]:
        """Something of the vertices of the body, zero where padded."""
        return _filled(x, self.padded.body_vertices)

    def step(self, step: TimeStep) -> TimeStep:
        """The state at the start of a time step."""
        return TimeStep(
            jnp.asarray(self.positions(np.asarray(step.start))),
            jnp.asarray(self.vectors(np.asarray(step.velocity))),
            step.inverse_step,
        )

    def indices(self, rows: np.ndarray) -> np.ndarray:
        """Vertices of cloth and body, numbered as in padded arrays."""
        n = self.true.vertices
        return np.where(rows < n, rows, rows + (self.padded.vertices - n))

    def parameters(self, parameters: Parameters) -> Parameters:
        """Parameters of the padded cloth."""
        changes = {}
        for name, counted in _COUNTED.items():
            leaf = np.asarray(getattr(parameters, name))
            if leaf.ndim:
                changes[name] = jnp.asarray(self._padded_leaf(leaf, name, counted))
        return replace(parameters, **changes)

    def directions(
        self, name: str, directions: Float[Array, "k *leaf"]
    ) -> Float[np.ndarray, "k *padded"]:
        """Changes of one leaf of the parameters, zero where padded."""
        directions = np.asarray(directions)
        if name not in _COUNTED or directions.ndim == 1:
            return directions
        size = getattr(self.padded, _COUNTED[name])
        return np.stack([_filled(direction, size) for direction in directions])

    def cut(self, parameters: Parameters, like: Parameters) -> Parameters:
        """The true part of something with the structure of padded parameters.

        Args:
            like: parameters of true sizes.
        """
        changes = {
            name: getattr(parameters, name)[: len(getattr(like, name))]
            for name in _COUNTED
            if np.ndim(getattr(like, name))
        }
        return replace(parameters, **changes)

    def _padded_leaf(self, leaf: np.ndarray, name: str, counted: str) -> np.ndarray:
        size = getattr(self.padded, counted)
        count = getattr(self.true, counted)
        if len(leaf) != count:
            what = counted.replace("_", " ")
            raise InputError(f"{name} has {len(leaf)} rows, the simulation has {count} {what}")
        padded = _filled(leaf, size)
        if name == "rest_positions":
            padded[count : count + len(_SQUARE)] = _SQUARE[:, :2]
        elif leaf.ndim == 1:
            padded[count:] = 1.0  # stiffnesses and densities, positive
        return padded


def make_padding(cloth: Cloth, body_count: int) -> Padding:
    """Choose the bucket of a cloth and a body, and pad the cloth.

    Args:
        cloth: topology of the garment.
        body_count: number of vertices of the body.
    """
    rest_faces = np.asarray(cloth.rest_faces)
    true = Sizes(
        vertices=cloth.vertex_count,
        panel_vertices=int(rest_faces.max(initial=-1)) + 1,
        faces=rest_faces.shape[1],
        hinges=cloth.hinges.shape[1],
        pins=len(cloth.pins),
        stitches=cloth.stitches.shape[1],
        body_vertices=body_count,
    )
    square = make_cloth(_SQUARE_FACES)
    corners = len(_SQUARE)
    needed = max(
        true.faces + len(_SQUARE_FACES),
        (true.hinges + 1) / _HINGE_SHARE,
        (true.vertices + corners) / _VERTEX_SHARE,
        (true.panel_vertices + corners) / _PANEL_VERTEX_SHARE,
    )
    faces = bucket_size(int(np.ceil(needed)), smallest=_SMALLEST_FACES, growth=_GROWTH)
    padded = Sizes(
        vertices=int(_VERTEX_SHARE * faces),
        panel_vertices=int(_PANEL_VERTEX_SHARE * faces),
        faces=faces,
        hinges=int(_HINGE_SHARE * faces),
        pins=bucket_size(true.pins, smallest=_SMALLEST_LIST),
        stitches=bucket_size(true.stitches, smallest=_SMALLEST_LIST),
        body_vertices=bucket_size(body_count, smallest=_SMALLEST_BODY, growth=_GROWTH),
    )

    def extended(own: Array, others: Array, first: int, size: int) -> Array:
        """The cloth's columns, the square's, and the square's first as often as it takes."""
        own, others = np.asarray(own), np.asarray(others) + first
        missing = size - own.shape[-1] - others.shape[-1]
        repeated = np.repeat(others[..., :1], missing, axis=-1)
        return jnp.asarray(np.concatenate([own, others, repeated], axis=-1))

    first = true.vertices
    pins = np.full(padded.pins - true.pins, first, np.int32)
    stitches = np.full((2, padded.stitches - true.stitches), first, np.int32)
    return Padding(
        cloth=Cloth(
            faces=extended(cloth.faces, square.faces, first, faces),
            rest_faces=extended(cloth.rest_faces, square.rest_faces, true.panel_vertices, faces),
            hinges=extended(cloth.hinges, square.hinges, first, padded.hinges),
            hinge_faces=extended(cloth.hinge_faces, square.hinge_faces, true.faces, padded.hinges),
            hinge_corners=extended(cloth.hinge_corners, square.hinge_corners, 0, padded.hinges),
            pins=jnp.asarray(np.concatenate([np.asarray(cloth.pins), pins])),
            stitches=jnp.asarray(np.concatenate([np.asarray(cloth.stitches), stitches], axis=1)),
            vertex_count=padded.vertices,
            membrane=cloth.membrane,
        ),
        true=true,
        padded=padded,
    )


def _filled(rows: np.ndarray, size: int) -> np.ndarray:
    """Rows with zeros after them."""
    rows = np.asarray(rows)
    padded = np.zeros((size, *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return padded
