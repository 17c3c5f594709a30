"""A garment that cannot be put on again: the fit goes on, and its record can be kept."""

import dataclasses
from types import SimpleNamespace

import pytest

from dress_jax.application import fit_run
from dress_jax.application.fit_session import Course, load_course
from dress_jax.core.errors import InputError
from dress_jax.optimisation import FitInfo, StepOutcome


@pytest.mark.parametrize("fault", ["drape", "dressing"])
def test_a_failed_attempt_is_recorded_and_borne(problem, state, tmp_path, monkeypatch, fault):
    def put_on(*_):
        if fault == "dressing":
            raise InputError("the body cannot grow")
        return SimpleNamespace(garment=SimpleNamespace(vertices=None)), "initial pattern"

    inputs = SimpleNamespace(
        mesh=lambda _: problem.discretization, put_on=put_on, problem=lambda *_: problem
    )
    # What a drape that failed reports: numbers that were not computed are NaN.
    failed = None, FitInfo(3, StepOutcome.SOLVE_FAILED)
    monkeypatch.setattr(fit_run, "carry_over", lambda *_, **__: failed)
    run = fit_run._Run(
        inputs, tmp_path, lambda *_, **__: None, state, problem, state, None, Course()
    )
    assert not run.begin_again(unless_worse=False)
    assert run.problem is problem and run.state is state
    kept = load_course(tmp_path)
    assert dataclasses.asdict(kept) == dataclasses.asdict(run.course)
    (record,) = kept.remeshed
    expected = StepOutcome.SOLVE_FAILED.value if fault == "drape" else "the body cannot grow."
    assert record["outcome"] == expected
    assert kept.mesh == 0 and kept.borne > 1.0
