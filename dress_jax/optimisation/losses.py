"""All loss terms of a drape, and their derivatives: images view by view, then regularizers."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.core.pytree import pytree, replace
from dress_jax.loss.area_ratio import area_ratio
from dress_jax.loss.comfort import comfort
from dress_jax.loss.corners import boundary_corner, discretization_consistency, small_angle
from dress_jax.loss.image import color_loss, mask_loss, normal_loss
from dress_jax.loss.laplacian import laplacian
from dress_jax.loss.seam_curvature import seam_curvature
from dress_jax.loss.seam_length import seam_length
from dress_jax.optimisation.observation import Observation
from dress_jax.optimisation.problem import Tables
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.render.images import render
from dress_jax.render.views import mean_over_views

_SEAM_SMOOTHING = 1e-3  # [m]; what a tailor would not notice
_CURVATURE_SMOOTHING = 1e-3  # [chord lengths]; likewise


@pytree
class Garment:
    """What the losses look at, or a gradient in it.

    Attributes:
        positions: the drape [m], (n, 3).
        rest_positions: panel vertices [m], (p, 2).
        pattern: the pattern's validated parameters.
        colors: vertex colours, (n, 3).
    """

    positions: Float[Array, "n 3"]
    rest_positions: Float[Array, "p 2"]
    pattern: PatternParameters
    colors: Float[Array, "n 3"]


class Assessment(NamedTuple):
    """Value and derivative of the loss.

    Attributes:
        loss: the weighted sum, ().
        terms: every term before weighting, by name.
        iou: of the masks in the views looked at, ().
        unfinished: contours that could not be followed (`render.images.check_image`), ().
        gradient: of the loss; None where only the value was asked for.
    """

    loss: Float[Array, ""]
    terms: dict[str, Float[Array, ""]]
    iou: Float[Array, ""]
    unfinished: Float[Array, ""]
    gradient: Garment | None


def _comfort(garment: Garment, tables: Tables) -> Float[Array, ""]:
    cloth = tables.cloth
    return comfort(
        garment.positions, garment.rest_positions, cloth.faces, cloth.rest_faces, cloth.gathers
    )


def _area_ratio(garment: Garment, tables: Tables) -> Float[Array, ""]:
    return area_ratio(
        garment.rest_positions,
        tables.rest_faces,
        tables.face_panel,
        tables.component,
        tables.reference_areas,
    )


def _seam_length(garment: Garment, tables: Tables) -> Float[Array, ""]:
    return seam_length(
        garment.pattern,
        tables.edges,
        tables.stitch_edges,
        ratio=tables.seam_ratios,
        smoothing=_SEAM_SMOOTHING,
    )


def _seam_curvature(garment: Garment, tables: Tables) -> Float[Array, ""]:
    return seam_curvature(
        garment.pattern,
        tables.reference,
        tables.edges,
        tables.stitch_edges,
        smoothing=_CURVATURE_SMOOTHING,
    )


def _laplacian(garment: Garment, tables: Tables) -> Float[Array, ""]:
    cloth = tables.cloth
    return laplacian(
        garment.positions, garment.rest_positions, cloth.faces, cloth.rest_faces, tables.interior
    )


def _small_angle(garment: Garment, tables: Tables) -> Float[Array, ""]:
    return small_angle(garment.rest_positions, tables.corners, tables.corner_signs)


def _discretization(garment: Garment, tables: Tables) -> Float[Array, ""]:
    return discretization_consistency(
        garment.pattern, garment.rest_positions, tables.edges, tables.corners
    )


def _boundary_corner(garment: Garment, tables: Tables) -> Float[Array, ""]:
    return boundary_corner(garment.pattern, tables.edges, tables.corners)


IMAGE_TERMS = ("mask", "color", "normal")

REGULARIZERS: Mapping[str, Callable[[Garment, Tables], Float[Array, ""]]] = MappingProxyType(
    {
        "comfort": _comfort,
        "laplacian": _laplacian,
        "area_ratio": _area_ratio,
        "small_angle": _small_angle,
        "discretization": _discretization,
        "boundary_corner": _boundary_corner,
        "seam_length": _seam_length,
        "seam_curvature": _seam_curvature,
    }
)
"""Terms without images. A new one is a function here and a weight in `options.PAPER_WEIGHTS`."""


def _view_terms(
    positions: Array, colors: Array, tables: Tables, view: Observation
) -> dict[str, Float[Array, ""]]:
    """One view's image terms, and what is only counted."""
    garment = replace(tables.garment, positions=positions, colors=colors)
    image = render(view.cameras, garment, jax.lax.stop_gradient(tables.occluder))
    terms = {"unfinished": image.unfinished.astype(jnp.float32)}
    drawn, wanted = image.mask > 0.5, view.mask > 0.5
    valid = view.valid > 0.0
    terms["common"] = jnp.sum((drawn & wanted & valid).astype(jnp.float32))
    terms["joint"] = jnp.sum(((drawn | wanted) & valid).astype(jnp.float32))
    parts = image.attributes if view.parts.shape[-1] > 1 else image.mask[..., None]
    terms["mask"] = mask_loss(parts, view.parts, view.valid)
    terms["color"] = color_loss(image.color, view.color, view.garment)
    terms["normal"] = normal_loss(image.normal, view.normal, view.garment)
    return terms


def _view_loss(operands: Any, view: Observation) -> Float[Array, ""]:
    """Weighted sum of one view's terms.

    `weights` also has entries for what is only counted; they are zero, and as for every term the
    derivative in its weight is the term itself. So one sweep over the views yields all of them.
    """
    positions, colors, weights, tables = operands
    terms = _view_terms(positions, colors, tables, view)
    total = jnp.zeros((), jnp.float32)
    for name, weight in weights.items():
        total = total + weight * terms[name]
    return total


def image_assessment(
    garment: Garment, weights: Mapping[str, Array], tables: Tables, views: Observation
) -> tuple[Float[Array, ""], dict[str, Array], tuple[Array, Array]]:
    """Weighted image loss, its terms, and its gradients in positions and colours."""
    counted = {name: jnp.zeros((), jnp.float32) for name in ("unfinished", "common", "joint")}
    own = {name: jnp.asarray(w, jnp.float32) for name, w in weights.items() if name in IMAGE_TERMS}

    def total(positions, colors, weights):
        return mean_over_views(_view_loss, (positions, colors, weights, tables), views)

    value, slopes = jax.value_and_grad(total, argnums=(0, 1, 2))(
        garment.positions, garment.colors, own | counted
    )
    return value, slopes[2], slopes[:2]


@jax.jit
def assess(
    garment: Garment, weights: Mapping[str, Array], tables: Tables, views: Observation
) -> Assessment:
    """The loss of a draped garment and its gradient.

    Args:
        garment: the drape and its pattern.
        weights: weight of every term that is computed, by name.
        tables: constants of the problem.
        views: the views to look at.
    """
    image, terms, (by_position, by_color) = image_assessment(garment, weights, tables, views)

    def regularize(garment: Garment) -> tuple[Array, dict[str, Array]]:
        own = {name: f(garment, tables) for name, f in REGULARIZERS.items() if name in weights}
        total = jnp.zeros(())
        for name, value in own.items():
            total = total + weights[name] * value
        return total, own

    (regular, regular_terms), gradient = jax.value_and_grad(regularize, has_aux=True)(garment)
    iou, unfinished = _counts(terms, views)
    return Assessment(
        loss=image + regular,
        terms=terms | regular_terms,
        iou=iou,
        unfinished=unfinished,
        gradient=replace(
            gradient,
            positions=gradient.positions + by_position,
            colors=gradient.colors + by_color,
        ),
    )


@jax.jit
def assess_value(
    garment: Garment, weights: Mapping[str, Array], tables: Tables, views: Observation
) -> Assessment:
    """`assess` without its gradient."""

    def every_term(view: Observation) -> dict[str, Array]:
        return _view_terms(garment.positions, garment.colors, tables, view)

    terms = {name: jnp.mean(values) for name, values in jax.lax.map(every_term, views).items()}
    iou, unfinished = _counts(terms, views)
    terms |= {name: f(garment, tables) for name, f in REGULARIZERS.items()}
    terms = {name: terms[name] for name in weights}
    loss = jnp.zeros(())
    for name, value in terms.items():
        loss = loss + weights[name] * value
    return Assessment(loss=loss, terms=terms, iou=iou, unfinished=unfinished, gradient=None)


def _counts(terms: dict[str, Array], views: Observation) -> tuple[Array, Array]:
    """IoU and unfinished contours, taken out of the terms' means over the views."""
    joint, common = terms.pop("joint"), terms.pop("common")
    iou = jnp.where(joint > 0.0, common / jnp.where(joint > 0.0, joint, 1.0), 1.0)
    return iou, terms.pop("unfinished") * views.mask.shape[0]
