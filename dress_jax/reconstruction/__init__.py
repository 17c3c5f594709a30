"""The body of a person in several pictures: scale, rotation, place, pose and shape (S7)."""

from dress_jax.reconstruction.landmarks import LandmarkMap, landmark_map
from dress_jax.reconstruction.options import Free, ReconstructionOptions
from dress_jax.reconstruction.parameters import BodyParameters, body_in_world
from dress_jax.reconstruction.reconstruct import Reconstruction, reconstruct
from dress_jax.reconstruction.views import BodyViews, make_body_views

__all__ = [
    "BodyParameters",
    "BodyViews",
    "Free",
    "LandmarkMap",
    "Reconstruction",
    "ReconstructionOptions",
    "body_in_world",
    "landmark_map",
    "make_body_views",
    "reconstruct",
]
