"""What a reconstruction looks at: landmarks, silhouettes and colours of views (S7.4-S7.9)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree
from dress_jax.reconstruction.landmarks import COCO_WHOLEBODY, TABLE
from dress_jax.render.cameras import Camera

WHITE = (1.0, 1.0, 1.0)
_WHERE = "views of a body"


@pytree
class BodyViews:
    """Views of a person from v cameras, k landmarks each.

    Attributes:
        cameras: a stack of v cameras.
        landmarks: column and row of each landmark [px], pixel centres at whole numbers, (v, k, 2).
        confidence: of the detector, in [0, 1]; zero where there is none, (v, k).
        mask: part of each pixel that the person covers, (v, h, w), or None.
        color: RGB in [0, 1], (v, h, w, 3), or None.
        visible: 1 where the body is not hidden, the complement of M^o (S7.9), (v, h, w), or None.
        background: RGB behind the person, (3,).
    """

    cameras: Camera
    landmarks: Float[Array, "v k 2"]
    confidence: Float[Array, "v k"]
    mask: Float[Array, "v h w"] | None
    color: Float[Array, "v h w 3"] | None
    visible: Float[Array, "v h w"] | None
    background: Float[Array, "3"]

    @property
    def count(self) -> int:
        """Number of views."""
        return self.landmarks.shape[0]


def make_body_views(
    cameras: Camera,
    landmarks: Num[np.ndarray, "v m 2"],
    confidence: Num[np.ndarray, "v m"],
    *,
    landmark_ids: Int[np.ndarray, " m"] | None = None,
    mask: Num[np.ndarray, "v h w"] | None = None,
    color: Num[np.ndarray, "v h w 3"] | None = None,
    occluded: Num[np.ndarray, "v h w"] | None = None,
    background: Num[np.ndarray, "3"] | tuple[float, float, float] = WHITE,
) -> BodyViews:
    """Views from arrays, checked once on the host.

    Args:
        cameras: a stack of v cameras.
        landmarks: positions [px]; those whose confidence is zero may hold anything.
        confidence: in [0, 1].
        landmark_ids: number in COCO-WholeBody of each landmark; 0, 1, ... when None, so that the 17
            of COCO and all 133 need none. Landmarks outside `landmarks.TABLE` are not used.
        mask: coverage by the person; None for a reconstruction by landmarks alone.
        color: RGB in [0, 1]; None leaves the colours out.
        occluded: where clothes, shoes, hair or things hide the body (M^o); nowhere when None.
        background: RGB behind the person in `color`.

    Raises:
        InputError: shapes that do not fit, numbers that are not finite, or no landmark seen.
    """
    points, trust = np.asarray(landmarks, np.float64), np.asarray(confidence, np.float64)
    if points.ndim != 3 or points.shape[2] != 2 or trust.shape != points.shape[:2]:
        raise InputError(
            f"landmarks {points.shape} and confidence {trust.shape} are not (v, m, 2) and (v, m)",
            where=_WHERE,
        )
    views = points.shape[0]
    if cameras.rotation.ndim != 3 or cameras.rotation.shape[0] != views:
        given = cameras.rotation.shape[0] if cameras.rotation.ndim == 3 else 1
        raise InputError(
            f"{given} cameras for landmarks of {views} views",
            where=_WHERE,
            mend="stack one camera per view",
        )
    points, trust = _in_table_order(points, trust, landmark_ids)
    size = (views, cameras.height, cameras.width)
    if mask is None and color is not None:
        raise InputError("there are colours but no masks", where=_WHERE, mend="give masks too")
    images = {
        "mask": (mask, size),
        "color": (color, (*size, 3)),
        "occluded": (occluded, size),
        "background": (background, (3,)),
    }
    for name, (array, shape) in images.items():
        if array is None:
            continue
        if np.shape(array) != shape:
            raise InputError(f"{name} has shape {np.shape(array)}, not {shape}", where=_WHERE)
        if not np.all(np.isfinite(array)) or np.min(array) < -1e-5 or np.max(array) > 1.0 + 1e-5:
            raise InputError(
                f"{name} holds a number that is not finite or not in [0, 1]", where=_WHERE
            )
    visible = None
    if mask is not None:
        hidden = np.zeros(size) if occluded is None else np.asarray(occluded, np.float64)
        visible = jnp.asarray(1.0 - hidden, jnp.float32)
    return BodyViews(
        cameras=cameras,
        landmarks=jnp.asarray(points),
        confidence=jnp.asarray(trust),
        mask=None if mask is None else jnp.asarray(mask, jnp.float32),
        color=None if color is None else jnp.asarray(color, jnp.float32),
        visible=visible,
        background=jnp.asarray(background, jnp.float32),
    )


def _in_table_order(
    points: np.ndarray, confidence: np.ndarray, ids: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks and confidences of the table's rows; absent ones get confidence zero."""
    count = points.shape[1]
    numbers = np.arange(count) if ids is None else np.asarray(ids)
    if numbers.shape != (count,) or len(np.unique(numbers)) != count:
        raise InputError(
            f"landmark_ids of shape {numbers.shape} do not name {count} different landmarks",
            where=_WHERE,
        )
    if count and (numbers.min() < 0 or numbers.max() >= COCO_WHOLEBODY):
        raise InputError(
            f"landmark numbers run from {numbers.min()} to {numbers.max()}",
            where=_WHERE,
            mend=f"number them as COCO-WholeBody does, 0 to {COCO_WHOLEBODY - 1}",
        )
    if not np.all(np.isfinite(confidence)) or np.any((confidence < 0.0) | (confidence > 1.0)):
        raise InputError(
            "a confidence is not finite or not in [0, 1]",
            where=_WHERE,
            mend="clip the detector's scores, and set missing ones to zero",
        )
    missing = ~np.all(np.isfinite(points), axis=2)
    if np.any(missing & (confidence > 0.0)):
        view, column = np.argwhere(missing & (confidence > 0.0))[0]
        raise InputError(
            f"landmark {numbers[column]} of view {view} is not finite",
            where=_WHERE,
            mend="set the confidence of landmarks that were not found to zero",
        )
    views = len(points)
    ordered, trust = np.zeros((views, len(TABLE), 2)), np.zeros((views, len(TABLE)))
    row = {target.index: k for k, target in enumerate(TABLE)}
    for column, number in enumerate(numbers):
        if int(number) in row:
            k = row[int(number)]
            trust[:, k] = confidence[:, column]
            ordered[:, k] = np.where(missing[:, column, None], 0.0, points[:, column])
    if not np.any(trust > 0.0):
        raise InputError(
            "no landmark is seen in any view", where=_WHERE, mend="check the confidences"
        )
    return ordered, trust
