"""Getting dressed: panels around a thin body, sewing, welding, and the body growing back (S8)."""

from dress_jax.sim.dressing.dress import DressedGarment, DressingOptions, dress
from dress_jax.sim.dressing.repair import Repair, repair_start

__all__ = ["DressedGarment", "DressingOptions", "Repair", "dress", "repair_start"]
