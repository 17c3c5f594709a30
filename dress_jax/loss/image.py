"""Image losses: mask, colour and normal, each on its own region (S10, S21.12).

All three are mean absolute errors over the pixels of a region, then the mean over views. The
regions differ: the mask counts everywhere but on hair and accessories (the complement of M^alpha),
colours and normals only on the garment (M^beta). A view whose region is empty contributes zero.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Num

from dress_jax.core.errors import InputError

MASK_WEIGHT = 1.0
"""S10.1: the dominant term."""

COLOR_WEIGHT = 0.1
"""S10.7."""

NORMAL_WEIGHT = 0.1
"""S10.8."""


def region_mean_error(
    rendered: Float[Array, "*v h w c"],
    target: Float[Array, "*v h w c"],
    region: Num[Array, "*v h w"],
) -> Float[Array, ""]:
    """Mean over views of the mean absolute error over a region's pixels and channels.

    Args:
        rendered: images, shape (h, w, c), or (v, h, w, c) for v views.
        target: images of the same shape.
        region: weight of every pixel, 0 or 1 for a plain region, shape (h, w) or (v, h, w).

    Returns:
        Loss, shape (); zero for views without a pixel in the region.

    Raises:
        InputError: the shapes disagree.
    """
    if rendered.shape != target.shape or rendered.shape[:-1] != region.shape:
        raise InputError(
            f"images {rendered.shape}, targets {target.shape} and region {region.shape} disagree",
            where="image loss",
            mend="images are (..., h, w, channels), regions (..., h, w)",
        )
    weight = region.astype(rendered.dtype)
    error = jnp.mean(jnp.abs(rendered - target.astype(rendered.dtype)), axis=-1)
    area = jnp.sum(weight, axis=(-2, -1))
    total = jnp.sum(weight * error, axis=(-2, -1))
    return jnp.mean(jnp.where(area > 0, total / jnp.where(area > 0, area, 1.0), 0.0))


def mask_loss(
    rendered: Float[Array, "*v h w c"],
    target: Float[Array, "*v h w c"],
    valid: Num[Array, "*v h w"],
) -> Float[Array, ""]:
    """Coloured garment masks against coloured target masks (S10.1).

    Args:
        rendered: component colours drawn with the body in black, shape (..., h, w, c) (S10.2).
        target: target masks in the same colours, zero off the garment.
        valid: the complement of M^alpha (hair, accessories), shape (..., h, w) (S10.4).
    """
    return region_mean_error(rendered, target, valid)


def color_loss(
    rendered: Float[Array, "*v h w 3"],
    target: Float[Array, "*v h w 3"],
    garment: Num[Array, "*v h w"],
) -> Float[Array, ""]:
    """Rendered vertex colours against images, on the garment region M^beta (S10.7).

    Args:
        rendered: RGB in [0, 1], shape (..., h, w, 3).
        target: RGB in [0, 1].
        garment: M^beta of the target, shape (..., h, w).
    """
    return region_mean_error(rendered, target, garment)


def normal_loss(
    rendered: Float[Array, "*v h w 3"],
    target: Float[Array, "*v h w 3"],
    garment: Num[Array, "*v h w"],
) -> Float[Array, ""]:
    """Rendered against generated normals, on the garment region M^beta (S10.8).

    Both are compared as the images (n + 1) / 2 that generators write, so that the weight relates to
    values in [0, 1]: half the mean absolute difference of the vectors.

    Args:
        rendered: world-frame unit normals towards the camera, shape (..., h, w, 3) (S22.18).
        target: normals in the same frame, see `decode_normals`.
        garment: M^beta of the target, shape (..., h, w).
    """
    return 0.5 * region_mean_error(rendered, target, garment)


def image_loss(
    *,
    mask: tuple[Array, Array, Array],
    color: tuple[Array, Array, Array] | None = None,
    normal: tuple[Array, Array, Array] | None = None,
    mask_weight: float = MASK_WEIGHT,
    color_weight: float = COLOR_WEIGHT,
    normal_weight: float = NORMAL_WEIGHT,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """The weighted sum of the image losses.

    Args:
        mask, color, normal: (rendered, target, region) of each term; None leaves a term out.
        mask_weight, color_weight, normal_weight: weights; the defaults are the paper's.

    Returns:
        The sum, and each term before weighting under "mask", "color" and "normal".
    """
    terms = {"mask": mask_loss(*mask)}
    total = mask_weight * terms["mask"]
    if color is not None:
        terms["color"] = color_loss(*color)
        total = total + color_weight * terms["color"]
    if normal is not None:
        terms["normal"] = normal_loss(*normal)
        total = total + normal_weight * terms["normal"]
    return total, terms


def encode_normals(normals: Float[Array, "*v 3"]) -> Float[Array, "*v 3"]:
    """Normals as an image in [0, 1]: (n + 1) / 2."""
    return 0.5 * (normals + 1.0)


def decode_normals(image: Float[Array, "*v 3"]) -> Float[Array, "*v 3"]:
    """Unit normals from an image (n + 1) / 2; pixels that encode no direction become zero."""
    vector = 2.0 * image - 1.0
    squared = jnp.sum(vector * vector, axis=-1, keepdims=True)
    some = squared > 1e-12
    return jnp.where(some, vector / jnp.sqrt(jnp.where(some, squared, 1.0)), 0.0)
