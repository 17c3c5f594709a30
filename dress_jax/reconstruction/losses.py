"""The losses of a body reconstruction (S7.4, S7.6, S7.7, S7.10).

    L = L_RGB + L_Mask + lambda_1 L_Land + lambda_2 |theta - theta_0|_1 + lambda_3 |beta - beta_0|_1

where there is an estimate (theta_0, beta_0); without one, the human prior takes the place of the
last two terms. |.|_1 is the mean absolute error, as the paper has it. Landmarks and regularizers
are sums of squares of residuals, so that Levenberg-Marquardt and Adam lower the same function.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.loss.image import region_mean_error
from dress_jax.reconstruction.landmarks import LandmarkMap, landmark_points
from dress_jax.reconstruction.parameters import BodyParameters
from dress_jax.reconstruction.prior import prior_residuals
from dress_jax.reconstruction.views import BodyViews
from dress_jax.render.attributes import find_visibility, render_attributes
from dress_jax.render.cameras import Camera, project

POSE_SMOOTHING, SHAPE_SMOOTHING = 0.01, 0.05
"""Round the corner of |d|, [rad] and [standard deviations]: less than pictures tell."""


@pytree
class Strengths:
    """The weights of `options.Weights` as arrays, so that no weight compiles anew."""

    rgb: Float[Array, ""]
    mask: Float[Array, ""]
    landmark: Float[Array, ""]
    pose: Float[Array, ""]
    shape: Float[Array, ""]
    prior: Float[Array, ""]


@pytree
class PaintedBody:
    """A mesh with colours, as the image losses see it.

    Attributes:
        positions: vertices [m], (n, 3).
        colors: RGB, (n, 3).
        faces: triangles, (f, 3).
        adjacency: twin half-edges (`render.mesh.build_adjacency`), (f, 3).
    """

    positions: Float[Array, "n 3"]
    colors: Float[Array, "n 3"]
    faces: Int[Array, "f 3"]
    adjacency: Int[Array, "f 3"]


def landmark_residuals(
    mapping: LandmarkMap, views: BodyViews, parameters: BodyParameters
) -> Float[Array, "v k 2"]:
    """w_i (Proj(J; Omega_i) - J_i) [image heights], over the root of |Omega| k (S7.4).

    Their squares add up to the mean over views and landmarks of the squared distance. A landmark of
    no confidence contributes zero whatever it holds.
    """
    points = landmark_points(mapping, parameters)
    column, row, _ = jax.vmap(lambda camera: project(camera, points))(views.cameras)
    weight = (views.confidence * mapping.trust[None, :]).astype(points.dtype)
    count = weight.shape[0] * weight.shape[1]
    share = weight / (views.cameras.height * count**0.5)
    x = share * (column - views.landmarks[:, :, 0].astype(points.dtype))
    y = share * (row - views.landmarks[:, :, 1].astype(points.dtype))
    seen = weight > 0.0
    return jnp.where(seen[:, :, None], jnp.stack([x, y], axis=2), 0.0)


def landmark_loss(
    mapping: LandmarkMap, views: BodyViews, parameters: BodyParameters
) -> Float[Array, ""]:
    """L_Land [image heights squared] (S7.4)."""
    return jnp.sum(landmark_residuals(mapping, views, parameters) ** 2)


def absolute_residuals(difference: Float[Array, "..."], smoothing: float) -> Float[Array, "..."]:
    """Numbers whose squares add up to the mean absolute value, its corner rounded by `smoothing`.

    r = d / sqrt(h + e) with h = sqrt(d^2 + e^2), since r^2 = h - e; smooth also at zero.
    """
    rounded = jnp.sqrt(difference**2 + smoothing**2)
    return difference / jnp.sqrt((rounded + smoothing) * difference.size)


def regularizer_residuals(
    parameters: BodyParameters, estimate: BodyParameters | None, strengths: Strengths
) -> Float[Array, " r"]:
    """Weighted residuals of the last two terms of S7.10, or of the prior without an estimate.

    The global rotation is no part of theta here: it is R.
    """
    if estimate is None:
        residuals = prior_residuals(parameters.pose, parameters.shape)
        return jnp.sqrt(strengths.prior.astype(residuals.dtype)) * residuals
    dtype = parameters.pose.dtype
    pose = absolute_residuals(parameters.pose[1:] - estimate.pose[1:], POSE_SMOOTHING).reshape(-1)
    shape = absolute_residuals(parameters.shape - estimate.shape, SHAPE_SMOOTHING)
    return jnp.concatenate(
        [
            jnp.sqrt(strengths.pose.astype(dtype)) * pose,
            jnp.sqrt(strengths.shape.astype(dtype)) * shape,
        ]
    )


def draw(
    camera: Camera, body: PaintedBody, background: Float[Array, "3"]
) -> tuple[Float[Array, "h w"], Float[Array, "h w 3"], Int[Array, ""]]:
    """M and I of a body (S7.11): antialiased coverage and colours, and unfinished contours."""
    visibility = find_visibility(camera, body.positions, body.faces, body.adjacency)
    ones = jnp.ones((body.positions.shape[0], 1), jnp.float32)
    image = render_attributes(
        camera,
        body.positions,
        body.faces,
        jnp.concatenate([ones, body.colors.astype(jnp.float32)], axis=1),
        body.adjacency,
        background=jnp.concatenate([jnp.zeros(1, jnp.float32), background]),
        visibility=visibility,
    )
    return image[..., 0], image[..., 1:], visibility.silhouettes.unfinished


def image_terms(
    body: PaintedBody, view: BodyViews
) -> tuple[Float[Array, ""], Float[Array, ""], Int[Array, ""]]:
    """L_RGB and L_Mask of one view, on the complement of the hidden region (S7.6, S7.7).

    The mean runs over the pixels of that region, as in `loss.image`. Without colours L_RGB is zero.

    Args:
        body: the mesh.
        view: `BodyViews` without the leading axis.

    Returns:
        The two terms, and contours that could not be followed.
    """
    mask, color, unfinished = draw(view.cameras, body, view.background)
    assert view.mask is not None and view.visible is not None
    silhouette = region_mean_error(mask[..., None], view.mask[..., None], view.visible)
    if view.color is None:
        return jnp.zeros_like(silhouette), silhouette, unfinished
    return region_mean_error(color, view.color, view.visible), silhouette, unfinished
