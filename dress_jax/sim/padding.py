"""Shape buckets of a simulation: garments of similar size share their compiled programs.

Compiled programs see arrays of a few sizes only. What fills them up are a flat square of two
triangles at rest, and copies of its first triangle: no energy, and no place in the matrix, so that
their weight moves nothing. Everything else (the Newton loop, the broad phase, the matrix, what goes
in and out of a solve) has the true sizes.
"""

import dataclasses
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.buckets import bucket_size
from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import Cloth, Parameters, make_cloth
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.gathers import Gathers
from dress_jax.sim.inputs import StepInputs

# Capacities grow in small steps: every program pays for what is padded.
_GROWTH = 1.2
_SMALLEST_FACES, _SMALLEST_BODY, _SMALLEST_LIST, _SMALLEST_GATHERS = 128, 256, 64, 512
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
    "poisson_ratio": "faces",
    "warp_stiffness": "faces",
    "weft_stiffness": "faces",
    "shear_stiffness": "faces",
    "grain_angle": "faces",
    "bending_anisotropy": "faces",
    "strain_limit.stretch": "faces",
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
    gathers: int
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
        return _filled(x, self.padded.vertices, _SQUARE)

    def vectors(self, v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n_padded 3"]:
        """Displacements, velocities or forces of the cloth; zero where padded."""
        return _filled(v, self.padded.vertices)

    def body(self, x: Float[np.ndarray, "b *c"]) -> Float[np.ndarray, "b_padded *c"]:
        """Something of the vertices of the body, zero where padded."""
        return _filled(x, self.padded.body_vertices)

    def inputs(self, inputs: StepInputs) -> StepInputs:
        """Everything that a step of the padded cloth depends on."""
        step = inputs.step
        return StepInputs(
            TimeStep(
                jnp.asarray(self.positions(np.asarray(step.start))),
                jnp.asarray(self.vectors(np.asarray(step.velocity))),
                jnp.asarray(step.inverse_step),
            ),
            self.parameters(inputs.parameters),
            jnp.asarray(self.body(np.asarray(inputs.body_start))),
        )

    def rates(self, rates: StepInputs) -> StepInputs:
        """Changes of what a step depends on, zero where padded."""
        step = rates.step
        parameters = _each_counted(
            lambda leaf, _, counted: jnp.asarray(
                _filled(leaf[: getattr(self.true, counted)], getattr(self.padded, counted))
            ),
            rates.parameters,
        )
        return StepInputs(
            TimeStep(
                jnp.asarray(self.vectors(np.asarray(step.start))),
                jnp.asarray(self.vectors(np.asarray(step.velocity))),
                jnp.asarray(step.inverse_step),
            ),
            parameters,
            jnp.asarray(self.body(np.asarray(rates.body_start))),
        )

    def indices(self, rows: np.ndarray) -> np.ndarray:
        """Vertices of cloth and body, numbered as in padded arrays."""
        n = self.true.vertices
        return np.where(rows < n, rows, rows + (self.padded.vertices - n))

    def together(self, values: Float[np.ndarray, " nb"]) -> Float[np.ndarray, " nb_padded"]:
        """Factors at the vertices of cloth and body, 1 where padded."""
        padded = np.ones(self.padded.vertices + self.padded.body_vertices)
        padded[self.indices(np.arange(len(values)))] = values
        return padded

    def parameters(self, parameters: Parameters) -> Parameters:
        """Parameters of the padded cloth."""
        return _each_counted(self._padded_leaf, parameters)

    def directions(
        self, name: str, directions: Float[Array, "k *leaf"]
    ) -> Float[np.ndarray, "k *padded"]:
        """Changes of one leaf of the parameters, zero where padded."""
        rows = np.asarray(directions)
        if name not in _COUNTED or rows.ndim == 1:
            return rows
        size, count = (getattr(sizes, _COUNTED[name]) for sizes in (self.padded, self.true))
        return np.stack([_filled(row[:count], size) for row in rows])

    def _padded_leaf(self, leaf: np.ndarray, name: str, counted: str) -> Array:
        size, count = getattr(self.padded, counted), getattr(self.true, counted)
        # Panel vertices behind the last one of a triangle belong to other garments.
        if len(leaf) < count or (len(leaf) > count and name != "rest_positions"):
            what = counted.replace("_", " ")
            raise InputError(f"{name} has {len(leaf)} rows, the simulation has {count} {what}")
        if name == "rest_positions":
            return jnp.asarray(_filled(leaf[:count], size, _SQUARE[:, :2]))
        # What elements are made of stays within its bounds; where pins and the body are does not
        # matter.
        more = np.full(size - count, leaf[-1]) if leaf.ndim == 1 and count else ()
        return jnp.asarray(_filled(leaf, size, more))


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
        gathers=len(cloth.gathers.faces),
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
        gathers=bucket_size(true.gathers, smallest=_SMALLEST_GATHERS),
        body_vertices=bucket_size(body_count, smallest=_SMALLEST_BODY, growth=_GROWTH),
    )

    def extended(own: Array, others: Array, first: int, size: int) -> Array:
        """The cloth's columns, the square's, and the square's first as often as it takes."""
        columns, more = np.asarray(own), np.asarray(others) + first
        missing = size - columns.shape[-1] - more.shape[-1]
        repeated = np.repeat(more[..., :1], missing, axis=-1)
        return jnp.asarray(np.concatenate([columns, more, repeated], axis=-1))

    first = true.vertices
    pins = np.full(padded.pins - true.pins, first, np.int32)
    stitches = np.full((2, padded.stitches - true.stitches), first, np.int32)
    # An edge of the square that is drawn up to its own length.
    missing = padded.gathers - true.gathers
    edge = np.repeat(np.array([[0], [1]]) + true.panel_vertices, missing, axis=1)
    own, other = (
        jnp.asarray(np.concatenate([np.asarray(ends), edge], axis=1), jnp.int32)
        for ends in (cloth.gathers.own, cloth.gathers.other)
    )
    owner = np.concatenate([np.asarray(cloth.gathers.faces), np.full(missing, true.faces)])
    gathers = Gathers(jnp.asarray(owner, jnp.int32), own, other)
    return Padding(
        cloth=Cloth(
            faces=extended(cloth.faces, square.faces, first, faces),
            rest_faces=extended(cloth.rest_faces, square.rest_faces, true.panel_vertices, faces),
            hinges=extended(cloth.hinges, square.hinges, first, padded.hinges),
            hinge_faces=extended(cloth.hinge_faces, square.hinge_faces, true.faces, padded.hinges),
            hinge_corners=extended(cloth.hinge_corners, square.hinge_corners, 0, padded.hinges),
            pins=jnp.asarray(np.concatenate([np.asarray(cloth.pins), pins])),
            stitches=jnp.asarray(np.concatenate([np.asarray(cloth.stitches), stitches], axis=1)),
            gathers=gathers,
            vertex_count=padded.vertices,
            membrane=cloth.membrane,
        ),
        true=true,
        padded=padded,
    )


def _each_counted(
    change: Callable[[np.ndarray, str, str], Array], parameters: Parameters
) -> Parameters:
    """Parameters, each leaf that counts something changed.

    Args:
        change: of its value, its name and what it counts.
    """

    def changed(path: tuple, leaf: Array) -> Array:
        name = ".".join(key.name for key in path)
        if name not in _COUNTED or not np.ndim(leaf):
            return leaf
        return change(np.asarray(leaf), name, _COUNTED[name])

    return jax.tree_util.tree_map_with_path(changed, parameters)


def _filled(rows: np.ndarray, size: int, after: Sequence | np.ndarray = ()) -> np.ndarray:
    """Rows, others after them, and zeros after those."""
    filled = np.zeros((size, *rows.shape[1:]), rows.dtype)
    filled[: len(rows)] = rows
    if len(after):
        filled[len(rows) : len(rows) + len(after)] = after
    return filled
