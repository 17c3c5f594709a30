"""What is known of a dressed person before the fit: one bundle, and conversions into it.

`bundle` holds the container; the other modules convert what tools write (labels, landmarks, body
parameters, camera conventions) without touching a file. Readers of files are in `io.capture`.
"""

from dress_jax.capture.body import BodyEstimate, BodyFamily
from dress_jax.capture.bundle import PARTS, Bundle, merge_bundles
from dress_jax.capture.labels import CLOTHES, ClothesLabel
from dress_jax.capture.landmarks import Landmarks
from dress_jax.capture.surfaces import Surface
from dress_jax.capture.views import View

__all__ = [
    "CLOTHES",
    "PARTS",
    "BodyEstimate",
    "BodyFamily",
    "Bundle",
    "ClothesLabel",
    "Landmarks",
    "Surface",
    "View",
    "merge_bundles",
]
