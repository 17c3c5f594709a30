"""Scenes that try to make cloth pass through itself or a body, and a player that watches them."""

from .player import Outcome, play
from .scene import Scene
from .table import SCENES

__all__ = ["SCENES", "Outcome", "Scene", "play"]
