"""What a body fit looks at, from a bundle or from a folder with a file of landmarks (S7.4-S7.9)."""

from pathlib import Path

import numpy as np

from dress_jax.capture.bundle import Bundle
from dress_jax.core.errors import InputError
from dress_jax.io.capture.bundles import is_bundle, load_bundle
from dress_jax.io.person import load_person
from dress_jax.reconstruction import BodyViews, make_body_views
from dress_jax.render.cameras import cameras_from_dict, stack_cameras


def body_views(bundle: Bundle) -> BodyViews:
    """The views of a bundle as a body fit looks at them (S7.4-S7.9).

    Landmarks, mattes and colours, these before white; clothes, hair and accessories hide the body.
    Pictures take part where every view has them.

    Raises:
        InputError: no view has landmarks.
    """
    views = [view for view in bundle.views if view.landmarks is not None]
    if not views:
        raise InputError(
            "no view has landmarks, so there is nothing to fit a body to",
            where="views",
            mend="give views with colours, or the body by options (--body, --body-pose)",
        )
    marks = [view.landmarks for view in views if view.landmarks is not None]
    mattes = [view.matte for view in views if view.matte is not None]
    colors = [view.rgb for view in views if view.rgb is not None]
    mask = color = occluded = None
    if len(mattes) == len(views):
        mask = np.stack(mattes).astype(np.float32) / 255.0
        hidden = []
        for view in views:
            covers = [p for p in (view.mask, view.hidden) if p is not None]
            empty = np.zeros(mask.shape[1:], np.uint8)
            hidden.append(np.maximum.reduce([empty, *covers]).astype(np.float32) / 255.0)
        occluded = np.stack(hidden)
        if len(colors) == len(views):
            seen = np.stack(colors).astype(np.float32) / 255.0
            color = seen * mask[..., None] + (1.0 - mask[..., None])
    return make_body_views(
        stack_cameras([view.camera for view in views]),
        np.stack([m.points for m in marks]),
        # Some networks' scores reach beyond 1.
        np.minimum(np.stack([m.confidence for m in marks]), 1.0),
        mask=mask,
        color=color,
        occluded=occluded,
    )


def read_body_views(path: str | Path, landmarks: str | Path | None = None) -> BodyViews:
    """Views of a bundle that holds landmarks, or of a target folder with a file of them.

    Args:
        path: a bundle of either form, or a folder (`io.person.load_person`).
        landmarks: the file, for a folder.

    Raises:
        InputError: files that are missing or do not fit each other.
    """
    if is_bundle(path):
        if landmarks is not None:
            raise InputError(
                "a bundle has landmarks of its own", where=str(landmarks), mend="leave them out"
            )
        return body_views(load_bundle(path))
    if landmarks is None:
        raise InputError(
            "is no bundle, and comes without landmarks",
            where=str(path),
            mend="give a file of them with --landmarks",
        )
    person = load_person(path, landmarks)
    cameras = stack_cameras(cameras_from_dict({"cameras": list(person.targets.cameras)}))
    return make_body_views(
        cameras,
        person.landmarks,
        person.confidence,
        landmark_ids=person.landmark_ids,
        mask=person.targets.mask,
        color=person.targets.rgb,
        occluded=person.occluded,
    )
