"""What a bundle lacks for a reconstruction, found in its pictures by embedded tools (S6.1-S6.3).

A photograph becomes a view with an assumed camera. Views get fewer pixels, a matte, landmarks, and
masks of the clothes, each only where it is missing; what was there stays.
"""

import dataclasses
import enum

import numpy as np

from dress_jax.application.bundle_targets import draw_masks
from dress_jax.application.photo import LANDMARK_SOURCE, MATTE_SOURCE
from dress_jax.application.progress import Progress, silent
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.labels import CLOTHES
from dress_jax.capture.reduction import reduced_view, reduction_factor
from dress_jax.capture.views import View, matte_from_white, with_labels
from dress_jax.core.errors import InputError
from dress_jax.io.networks import load_landmark_network, load_matting_network
from dress_jax.render.cameras import perspective_camera
from dress_jax.vision.body_landmarks import find_landmarks
from dress_jax.vision.clothes import parse_clothes
from dress_jax.vision.matting import find_matte

PHOTO_FOCAL = 1.5
"""Focal length that is assumed for a photograph, in its longer side: a lens of 54 mm on a film of
36 mm, between a phone's portrait lens and its main one."""
PHOTO_VIEW = "000"

_WHITE_BORDER = 0.98  # part of the border's pixels that are white where the background is
_WHITE = 247


class MaskSource(enum.Enum):
    """Where masks of the clothes come from."""

    GIVEN = "given"
    SCAN = "scan"
    PARSER = "parser"


@dataclasses.dataclass(frozen=True)
class Completed:
    """A bundle with everything that could be found.

    Attributes:
        bundle: it.
        single_view: whether its only view is a photograph with an assumed camera.
        notes: what was found or assumed, a sentence each.
    """

    bundle: Bundle
    single_view: bool
    notes: tuple[str, ...]


def complete_bundle(
    bundle: Bundle,
    *,
    masks: MaskSource | None = None,
    longest_side: int = 512,
    landmarks: bool = True,
    progress: Progress = silent,
) -> Completed:
    """Add what is missing.

    Args:
        bundle: views, or a photograph with labels.
        masks: where masks come from; None takes those that are there, else those of the labelled
            scan, else the parser's.
        longest_side: of the views, which are reduced by a whole factor [px].
        landmarks: whether a body will be fitted, which needs landmarks in the views.
        progress: told about every view.

    Raises:
        InputError: there is neither a view nor a photograph, or what was asked for is not there.
    """
    notes: list[str] = []
    single = not bundle.views
    if single:
        bundle = dataclasses.replace(bundle, views=(photo_view(bundle),))
        notes.append(
            f"One photograph: its camera is assumed to stand level, with a focal length of "
            f"{PHOTO_FOCAL} times the longer side."
        )
    factor = reduction_factor(bundle.views, longest_side)
    if factor > 1:
        bundle = dataclasses.replace(
            bundle, views=tuple(reduced_view(view, factor) for view in bundle.views)
        )
        size = bundle.views[0].camera
        notes.append(f"Views were reduced {factor}-fold, to {size.width} x {size.height} px.")
    chosen = _mask_source(bundle) if masks is None else masks
    if landmarks or chosen is MaskSource.PARSER:
        bundle = _with_mattes(bundle, notes)
        bundle = _with_landmarks(bundle, notes, progress)
    if chosen is MaskSource.SCAN:
        bundle = draw_masks(bundle, progress=progress)
        notes.append("Masks of the clothes were drawn from the scan, not found in the pictures.")
    elif chosen is MaskSource.PARSER:
        bundle = _parsed(bundle, notes, progress)
    missing = [view.name for view in bundle.views if view.mask is None]
    if missing:
        raise InputError(
            f"has no mask of the clothes, like {len(missing) - 1} more",
            where=f"view '{missing[0]}'",
            mend="let the embedded parser find them (--masks parser), or add label maps",
        )
    return Completed(bundle, single, tuple(notes))


def photo_view(bundle: Bundle) -> View:
    """The photograph as a view: its camera looks level along -z, from the world's origin.

    Nothing in a photograph tells the camera. Where it stands is no loss, since the body is looked
    for; the focal length only bends the perspective.

    Raises:
        InputError: there is no photograph, or no labels with it.
    """
    if bundle.image is None or bundle.labels is None:
        raise InputError(
            "has neither views nor a photograph with labels",
            where="bundle",
            mend="add views, or read the photograph with --source photo",
        )
    height, width = bundle.image.shape[:2]
    view = View(
        name=PHOTO_VIEW,
        camera=perspective_camera(
            rotation=np.eye(3),
            position=np.zeros(3),
            focal=PHOTO_FOCAL * max(height, width),
            height=height,
            width=width,
        ),
        rgb=bundle.image,
        matte=bundle.matte,
        landmarks=bundle.landmarks,
    )
    return with_labels(view, bundle.labels)


def _mask_source(bundle: Bundle) -> MaskSource:
    if all(view.mask is not None for view in bundle.views):
        return MaskSource.GIVEN
    scan = bundle.scan
    if scan is not None and scan.labels is not None and len(scan.faces):
        return MaskSource.SCAN
    return MaskSource.PARSER


def _with_mattes(bundle: Bundle, notes: list[str]) -> Bundle:
    views, found = [], 0
    for view in bundle.views:
        if view.matte is None and view.rgb is not None:
            if _on_white(view.rgb):
                matte = matte_from_white(view.rgb)
            else:
                matte = find_matte(view.rgb, load_matting_network())
            view, found = dataclasses.replace(view, matte=matte), found + 1
        views.append(view)
    if found:
        notes.append(f"Mattes of {found} views: what is not white, or {MATTE_SOURCE}.")
    return dataclasses.replace(bundle, views=tuple(views))


def _with_landmarks(bundle: Bundle, notes: list[str], progress: Progress) -> Bundle:
    wanted = [v for v in bundle.views if v.landmarks is None and v.rgb is not None]
    if not wanted:
        return bundle
    network, views, nobody, done = load_landmark_network(), [], [], 0
    for view in bundle.views:
        if view.landmarks is None and view.rgb is not None and view.matte is not None:
            try:
                found = find_landmarks(view.rgb, view.matte, network)
                view = dataclasses.replace(view, landmarks=found.landmarks)
            except InputError:
                nobody.append(view.name)
            done += 1
            progress("landmarks", done, len(wanted))
        views.append(view)
    notes.append(f"Landmarks of {len(wanted) - len(nobody)} views: {LANDMARK_SOURCE}.")
    if nobody:
        notes.append(f"Views in which the landmark network saw nobody: {', '.join(nobody)}.")
    return dataclasses.replace(bundle, views=tuple(views))


def _parsed(bundle: Bundle, notes: list[str], progress: Progress) -> Bundle:
    """Labels by the coarse parser; whether it is one garment or two, the views decide together."""
    seen = [
        (view.rgb, view.matte, view.landmarks)
        for view in bundle.views
        if view.rgb is not None and view.matte is not None and view.landmarks is not None
    ]
    if len(seen) < len(bundle.views):
        raise InputError(
            "the parser needs colours and landmarks in every view",
            where="views",
            mend="add label maps of your own (bundle --source labels)",
        )
    first = [parse_clothes(rgb, matte, marks)[1].one_piece for rgb, matte, marks in seen]
    one_piece = 2 * sum(first) >= len(first)
    views = []
    for number, (view, (rgb, matte, marks)) in enumerate(zip(bundle.views, seen, strict=True)):
        labels, _ = parse_clothes(rgb, matte, marks, one_piece=one_piece)
        bare = dataclasses.replace(view, mask=None, parts={}, hidden=None)
        if not np.isin(labels, CLOTHES).any():
            raise InputError(
                "the parser finds no clothes", where=f"view '{view.name}'", mend="give label maps"
            )
        views.append(with_labels(bare, labels))
        progress("clothes", number + 1, len(seen))
    notes.append(
        f"Masks of the clothes: coarse parser, {'one piece' if one_piece else 'top and bottom'} "
        f"({sum(first)} of {len(first)} views on their own say one piece)."
    )
    return dataclasses.replace(bundle, views=tuple(views))


def _on_white(rgb: np.ndarray) -> bool:
    border = np.concatenate([rgb[0], rgb[-1], rgb[:, 0], rgb[:, -1]])
    return bool((border.min(axis=-1) >= _WHITE).mean() >= _WHITE_BORDER)
