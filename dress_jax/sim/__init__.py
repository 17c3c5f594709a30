"""The differentiable cloth simulator and how a garment gets onto a body."""

from dress_jax.energy.cloth import Cloth, Parameters, make_cloth
from dress_jax.sim.simulator import Simulator, make_simulation, make_simulator
from dress_jax.sim.solve import Drape, State, static_solve, step

__all__ = [
    "Cloth",
    "Drape",
    "Parameters",
    "Simulator",
    "State",
    "make_cloth",
    "make_simulation",
    "make_simulator",
    "static_solve",
    "step",
]
