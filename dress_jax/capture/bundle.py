"""One observation bundle: everything that precedes a fit, in one frame and one set of units.

Whatever finds masks, landmarks, bodies or further views fills a bundle, and a fit reads it. Our
world is metres, +y up, +z to the front, +x the wearer's left (docs/design.md); pixel centres lie at
whole numbers. Checklist S6.1 to S6.4, S7.1, S10.3.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import UInt8

from dress_jax.capture.body import BodyEstimate
from dress_jax.capture.checks import picture, same_size
from dress_jax.capture.labels import ClothesLabel
from dress_jax.capture.landmarks import USUAL_THRESHOLD, Landmarks
from dress_jax.capture.surfaces import Surface
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.pattern.model import Pattern

PARTS = (
    "image",
    "matte",
    "labels",
    "landmarks",
    "body",
    "body_mesh",
    "scan",
    "views",
    "pattern",
)
"""Names of the parts, in the order in which they are shown."""


@dataclasses.dataclass(frozen=True, eq=False)
class Bundle:
    """What is known of one dressed person. Any part may be absent, but not all of them.

    Args:
        image: the photograph, RGB, shape (h, w, 3).
        matte: coverage of its pixels by the person, 0 to 255, shape (h, w).
        labels: `ClothesLabel` of its pixels, shape (h, w).
        landmarks: of the person in it.
        body: pose and shape of an SMPL-X body.
        body_mesh: the body as a mesh, from tools that write no parameters.
        scan: the dressed person or the garment, with labels where they are known.
        views: pictures from cameras around the person, with distinct names.
        pattern: where a fit may begin.
        sources: which tool or data set each part came from, by the part's name.

    Raises:
        InputError: nothing is there, a part is malformed, parts do not fit each other, or a
            source is named for a part that is absent. The message names the part.
    """

    image: UInt8[np.ndarray, "h w 3"] | None = None
    matte: UInt8[np.ndarray, "h w"] | None = None
    labels: UInt8[np.ndarray, "h w"] | None = None
    landmarks: Landmarks | None = None
    body: BodyEstimate | None = None
    body_mesh: Surface | None = None
    scan: Surface | None = None
    views: tuple[View, ...] = ()
    pattern: Pattern | None = None
    sources: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(self.views))
        if not self.present:
            raise InputError("holds nothing", where="bundle", mend="give one part at least")
        _check_types(self)
        _check_pictures(self)
        _check_views(self.views)
        for part in self.sources:
            if part not in self.present:
                raise InputError(
                    f"a source is named for '{part}', which is absent",
                    where="bundle, sources",
                    mend=f"the parts here are {', '.join(self.present)}",
                )

    @property
    def present(self) -> tuple[str, ...]:
        """Names of the parts that are there."""
        absent = {part for part in PARTS if getattr(self, part) is None}
        if not self.views:
            absent.add("views")
        return tuple(part for part in PARTS if part not in absent)


def merge_bundles(base: Bundle, addition: Bundle, *, replace: bool = False) -> Bundle:
    """One bundle with the parts of two, which must be of the same person in the same frame.

    Args:
        base: the earlier one.
        addition: what is added.
        replace: whether parts of `addition` may take the place of those in `base`.

    Raises:
        InputError: a part is in both, or the parts do not fit each other.
    """
    double = [part for part in addition.present if part in base.present]
    if double and not replace:
        raise InputError(
            f"there is {', '.join(double)} already",
            where="bundle",
            mend="replace it on purpose, or start another bundle",
        )
    changes = {part: getattr(addition, part) for part in addition.present}
    kept = {part: source for part, source in base.sources.items() if part not in changes}
    return dataclasses.replace(base, **changes, sources={**kept, **addition.sources})


def _check_types(bundle: Bundle) -> None:
    for part, kind in (
        ("landmarks", Landmarks),
        ("body", BodyEstimate),
        ("body_mesh", Surface),
        ("scan", Surface),
        ("pattern", Pattern),
    ):
        value = getattr(bundle, part)
        if value is not None and not isinstance(value, kind):
            raise InputError(f"is a {type(value).__name__}, not a {kind.__name__}", where=part)


def _check_pictures(bundle: Bundle) -> None:
    first: tuple[str, tuple[int, int]] | None = None
    for part, channels in (("image", 3), ("matte", 0), ("labels", 0)):
        array = getattr(bundle, part)
        if array is None:
            continue
        array = picture(part, array, channels=channels)
        if first is None:
            first = part, array.shape[:2]
        same_size(part, array, first[1], f"the {first[0]}")
    if bundle.labels is not None and bundle.labels.max() >= len(ClothesLabel):
        raise InputError(
            f"{bundle.labels.max()} is no label",
            where="labels",
            mend="translate ids with `capture.labels.convert_labels`",
        )
    if bundle.landmarks is not None and first is not None:
        _check_landmarks(bundle.landmarks, first)


def _check_landmarks(landmarks: Landmarks, picture: tuple[str, tuple[int, int]]) -> None:
    """Single landmarks may lie outside of the picture; all of them are another picture's."""
    name, (height, width) = picture
    found = landmarks.points[landmarks.confidence >= USUAL_THRESHOLD]
    inside = (found >= -0.5).all(axis=1) & (found <= [width - 0.5, height - 0.5]).all(axis=1)
    if len(found) and not inside.any():
        raise InputError(
            f"none lies in the {name} of {width}x{height} pixels",
            where="landmarks",
            mend="give those of this picture, in its own pixels",
        )


def _check_views(views: Sequence[View]) -> None:
    names = [view.name for view in views]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two are named '{name}'", where="views", mend="name them apart")
