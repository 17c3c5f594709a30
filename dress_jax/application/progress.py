"""How a workflow tells how far it is."""

from typing import Protocol

from dress_jax.solver import NewtonProgress


class Progress(Protocol):
    """Called after every piece of work that takes time."""

    def __call__(self, stage: str, done: int, total: int, *, loss: float | None = None) -> None:
        """Report.

        Args:
            stage: what is being done; a new name begins a new stage.
            done: pieces that are finished.
            total: pieces at most; a solver may need fewer.
            loss: what goes down, where there is something.
        """
        ...


def silent(stage: str, done: int, total: int, *, loss: float | None = None) -> None:
    """Reports nothing."""


def fraction(progress: Progress, stage: str, done: float) -> None:
    """Report a fraction in per cent."""
    progress(stage, round(100.0 * done), 100)


def newton(progress: Progress, stage: str, limit: int):
    """A listener for Newton's method; the energy [J] is what goes down."""

    def listen(report: NewtonProgress) -> None:
        progress(stage, report.iteration, limit, loss=report.energy)

    return listen
