"""The shape of a body model that has given tape measures."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.body.measurements import measure
from dress_jax.body.model import BodyModel, forward
from dress_jax.body.skeleton import joint_index
from dress_jax.core.errors import InputError

MEASURES = ("height", "bust", "waist", "hips")
# Of a coefficient, for differences: where girths have a kink, a wider look finds a way on.
_STEPS = (0.05, 0.3, 1.0, 0.1)
_ROUNDS = 20
_LONGEST_STEP = 1.0  # of all coefficients together, in standard deviations
_TOLERANCE = 2e-3  # far below what a tape on a living body can tell [m]
_FARTHEST = 6.0  # norm of a shape that can still be called a body


def shape_with(model: BodyModel, wanted: Mapping[str, float]) -> Float[np.ndarray, " b"]:
    """The shape closest to the mean that has the wanted measures.

    Least-norm Newton steps on the measures of `body.measurements.measure`, whose derivatives are
    differences: a girth is the largest or smallest of those at a few levels, so it has kinks.

    Args:
        model: a rigged body whose coefficients are in standard deviations.
        wanted: some of `MEASURES` [m].

    Returns:
        Coefficients with measures within 2 mm of the wanted ones.

    Raises:
        InputError: an unknown measure, a number that no body has, or no such shape; the message
            says how close it came.
    """
    unknown = sorted(set(wanted) - set(MEASURES))
    if unknown or not wanted:
        raise InputError(
            f"unknown measures {unknown}" if unknown else "there are no measures",
            where="body measurements",
            mend=f"give some of {', '.join(MEASURES)} in metres",
        )
    for name, value in wanted.items():
        if not 0.3 <= value <= 2.6:
            raise InputError(
                f"a {name} of {value} m", where="body measurements", mend="give metres, as 0.98"
            )
    target = np.array([wanted[name] for name in wanted])
    shape = np.zeros(model.shapedirs.shape[2])
    found, look = _measures(model, shape, wanted), 0
    for _ in range(_ROUNDS):
        miss = target - found
        if np.max(np.abs(miss)) <= _TOLERANCE:
            return shape
        rates = _rates(model, shape, wanted, _STEPS[look])
        # The least-norm shape that has the measures to first order, not the least-norm step.
        moved = np.linalg.pinv(rates) @ (rates @ shape + miss) - shape
        moved *= min(1.0, _LONGEST_STEP / np.linalg.norm(moved))
        better = None
        for trial in (shape + part * moved for part in 0.5 ** np.arange(5.0)):
            there = _measures(model, trial, wanted)
            if np.linalg.norm(target - there) < np.linalg.norm(miss):
                better = trial, there
                break
        if better is None:
            look += 1
            if look == len(_STEPS):
                break
            continue
        (shape, found), look = better, 0
        if np.linalg.norm(shape) > _FARTHEST:
            break
    reached = ", ".join(f"{name} {value:.4f}" for name, value in zip(wanted, found, strict=True))
    raise InputError(
        f"no shape of this body has these measures; the closest one has {reached} m",
        where="body measurements",
        mend="check the numbers against each other, or leave some of them out",
    )


def _rates(
    model: BodyModel, shape: np.ndarray, names: Mapping[str, float], step: float
) -> Float[np.ndarray, "m b"]:
    """Derivatives of the measures in the coefficients, by central differences."""
    columns = []
    for own in step * np.eye(len(shape)):
        high, low = (_measures(model, shape + sign * own, names) for sign in (1.0, -1.0))
        columns.append((high - low) / (2.0 * step))
    return np.stack(columns, axis=1)


def _measures(model: BodyModel, shape: np.ndarray, names: Mapping[str, float]) -> np.ndarray:
    real = model.template.dtype
    rest = jnp.zeros((len(model.parents), 3), real)
    state = forward(model, rest, jnp.asarray(shape, real), jnp.zeros(3, real))
    half_width = float(state.joints[joint_index("left_shoulder"), 0])
    tape = measure(np.asarray(state.vertices), np.asarray(model.faces), half_width=half_width)
    return np.array([getattr(tape, name) for name in names])
