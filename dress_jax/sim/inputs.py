"""Everything continuous that one implicit step depends on."""

from jaxtyping import Array, Float

from dress_jax.core.pytree import pytree
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.elastic import TimeStep


@pytree
class StepInputs:
    """What a step is a differentiable function of.

    Attributes:
        step: state at the start of the time step, intersection-free, and 1/h; where 1/h is zero,
            inertia is left out.
        parameters: `body_vertices` is the body at the end of the step.
        body_start: the body at the start of the step, for friction [m], (b, 3).
    """

    step: TimeStep
    parameters: Parameters
    body_start: Float[Array, "b 3"]
