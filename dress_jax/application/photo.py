"""A plain photograph of a dressed person, to its matte, landmarks and clothes labels (S6.1)."""

import dataclasses
from pathlib import Path

import numpy as np

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.labels import ClothesLabel
from dress_jax.core.errors import InputError
from dress_jax.io.capture.fields import within
from dress_jax.io.capture.photographs import read_photograph
from dress_jax.io.networks import load_landmark_network, load_matting_network
from dress_jax.vision.body_landmarks import find_landmarks
from dress_jax.vision.clothes import ClothesReport, parse_clothes
from dress_jax.vision.matting import find_matte

MATTE_SOURCE = "U^2-Net p, embedded"
LANDMARK_SOURCE = "BlazePose, embedded"
_CLEAR = 250


@dataclasses.dataclass(frozen=True, eq=False)
class PhotoReport:
    """How far the parts of a photograph's bundle can be trusted.

    Args:
        presence: the landmark network's probability that there is a person.
        clothes: see `vision.clothes.ClothesReport`.
    """

    presence: float
    clothes: ClothesReport


def observe_photo(
    path: str | Path, *, matte: str | Path | None = None
) -> tuple[Bundle, PhotoReport]:
    """Image, matte, landmarks and labels of one person, by the embedded networks alone.

    Args:
        path: PNG, JPEG or another picture; its alpha channel is the matte where it has a
            transparent pixel.
        matte: a matte of the same size, unless the picture has its own or the network shall find
            one.

    Raises:
        InputError: a file is missing or no picture, the picture is too small, nobody stands out of
            it, or shoulders and hips are not to be seen.
    """
    photograph = read_photograph(path, matte=matte)
    image, given = photograph.image, photograph.matte
    if image is None:  # a photograph always has one
        raise InputError("holds no image", where=str(path))
    sources = dict(photograph.sources)
    with within(path):
        if given is None or (matte is None and int(given.min()) > _CLEAR):
            given = find_matte(image, load_matting_network())
            sources["matte"] = MATTE_SOURCE
        person = find_landmarks(image, given, load_landmark_network())
        labels, clothes = parse_clothes(image, given, person.landmarks)
    sources |= {"landmarks": LANDMARK_SOURCE, "labels": label_source(clothes)}
    bundle = dataclasses.replace(
        photograph, matte=given, landmarks=person.landmarks, labels=labels, sources=sources
    )
    return bundle, PhotoReport(presence=person.presence, clothes=clothes)


def read_photo(path: str | Path, *, matte: str | Path | None = None) -> Bundle:
    """The bundle of `observe_photo`."""
    return observe_photo(path, matte=matte)[0]


def label_source(report: ClothesReport) -> str:
    """Where the labels are from, and what is to be known before they are trusted."""
    kind = "one piece" if report.one_piece else "top and bottom"
    notes = [f"{kind}, contrast {report.waist_contrast:.1f} at the waist"]
    if not report.skin_pixels:
        notes.append("no skin found")
    if report.cut_off:
        notes.append("the person is cut off")
    return f"coarse parser ({'; '.join(notes)})"


def label_rows(bundle: Bundle) -> dict[str, str]:
    """Share of the person's pixels by label [percent], of a bundle with labels."""
    if bundle.labels is None:
        return {}
    person = int((bundle.labels != ClothesLabel.BACKGROUND).sum())
    counts = np.bincount(bundle.labels.ravel(), minlength=len(ClothesLabel))
    return {
        kind.name.lower(): f"{100.0 * counts[kind] / max(person, 1):.1f} %"
        for kind in ClothesLabel
        if kind is not ClothesLabel.BACKGROUND and counts[kind]
    }
