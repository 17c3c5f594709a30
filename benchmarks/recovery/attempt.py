"""One recovery in a process of its own: `python -m benchmarks.recovery.attempt`."""

import argparse
import dataclasses
import json
import resource
import time
import traceback
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.recovery.cases import STARTS, STIFFNESS, VIEWS, Case, Start  # noqa: E402
from benchmarks.recovery.truth import held_out, make_targets, make_truth, wearer  # noqa: E402
from benchmarks.recovery.variants import VARIANTS  # noqa: E402
from dress_jax.application.drape import DrapeOptions  # noqa: E402
from dress_jax.application.fit import (  # noqa: E402
    FitResult,
    Fitted,
    fit_pattern,
    fit_report,
    scheduled,
)
from dress_jax.application.fit_files import save_fit  # noqa: E402
from dress_jax.application.fit_knowledge import NORMAL_95  # noqa: E402
from dress_jax.application.targets import read_targets  # noqa: E402
from dress_jax.core.errors import InputError  # noqa: E402
from dress_jax.core.pytree import replace  # noqa: E402
from dress_jax.io.patterns import load_pattern  # noqa: E402
from dress_jax.optimisation import Uncertainty, evaluate  # noqa: E402
from dress_jax.optimisation.draping import settle  # noqa: E402
from dress_jax.optimisation.gauss_newton.trial import guided  # noqa: E402
from dress_jax.pattern import (  # noqa: E402
    Pattern,
    edge_lengths,
    edge_table,
    pattern_parameters,
    scaled,
    with_parameters,
)
from dress_jax.pattern.validation import validate  # noqa: E402
from dress_jax.solver import NewtonOptions  # noqa: E402


def recover(case: Case, data: Path, out: Path, options: argparse.Namespace) -> dict:
    """One row of the table."""
    name = f"{case.pattern}_specification.json"
    truth_pattern = load_pattern(data / "patterns" / "garmentcode" / name)
    body = wearer(case.body, data)
    draping = DrapeOptions(
        edge_length=options.edge_length,
        newton=NewtonOptions(tolerance=1e-5, iteration_limit=300),
    )
    folder = out / "truth" / f"{case.pattern}@{case.body}"
    truth = make_truth(folder, truth_pattern, body, draping)
    views = read_targets(make_targets(folder, truth, VIEWS[case.view]))
    fitting = scheduled(options.iterations, initial_stiffness=STIFFNESS)
    fitting = VARIANTS[case.variant](fitting)
    place = out / "fits" / case.name
    place.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    result = fit_pattern(
        wrong(truth_pattern, STARTS[case.start]),
        body,
        views,
        place,
        drape_options=draping,
        fit_options=fitting,
        truth=truth_pattern,
    )
    seconds = time.perf_counter() - began
    report = fit_report(result)
    save_fit(place, result, report)
    unseen = held_out(truth)
    outside = [
        evaluate(dataclasses.replace(problem, observation=unseen), state).iou
        for problem, state in ((result.first, result.begin), (result.problem, result.end))
    ]
    truth_here = drape_of_truth(result, truth_pattern)
    best = evaluate(
        dataclasses.replace(result.problem, observation=unseen),
        truth_here,
        true_mesh=(truth.garment.vertices, truth.garment.faces),
    )
    history = result.course.history
    # Initial stiffnesses are factors on the truth's, so fitted ones should be 1.
    stretching, bending = np.exp(np.asarray(result.end.unknowns.log_stiffness)) - 1.0
    return {
        "vertices": len(truth.garment.vertices),
        "iou": [result.before.iou, result.after.iou],
        "held_out": outside,
        "chamfer_cm": [result.before.chamfer, result.after.chamfer],
        "true_held_out": best.iou,
        "true_chamfer_cm": best.chamfer,
        "median_error": [result.before.median_length_error, result.after.median_length_error],
        "largest_error": [result.before.largest_length_error, result.after.largest_length_error],
        "bending_error": float(bending),
        "stretching_error": float(stretching),
        "valid": valid(result.pattern),
        "covered": covered(result.known, truth_pattern),
        "iterations": len(history),
        "rejected": sum(record["outcome"] != "accepted" for record in history),
        "remeshed": len(result.course.remeshed),
        "crossings": max(
            [record["intersections"] for record in history if record["outcome"] == "accepted"]
            + [sum(report["intersections"].values())]
        ),
        "converged": bool(result.report.converged),
        "seconds": seconds,
        "fit_seconds": sum(record["seconds"].get("total", 0.0) for record in history),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def drape_of_truth(result: FitResult, truth: Pattern) -> Fitted:
    """The true pattern and fabric on the mesh of a fit, draped from the fit's folds as a fit does.

    It says how far a fit can be asked to come: folds are as fine as the mesh, and another mesh of
    the same pattern lays them otherwise.
    """
    unknowns = replace(
        result.end.unknowns,
        pattern=pattern_parameters(truth),
        log_stiffness=jnp.zeros_like(result.end.unknowns.log_stiffness),
    )
    begin = np.asarray(guided(result.problem, unknowns, result.end.positions).positions)
    return Fitted(unknowns, settle(result.problem, unknowns, begin))


def wrong(truth: Pattern, start: Start) -> Pattern:
    """The pattern that a fit begins with; corners that are sewn together move on their own."""
    pattern = scaled(truth, {"*": (start.width, start.length)})
    if not start.noise:
        return pattern
    parameters, random = pattern_parameters(pattern), np.random.default_rng(0)
    way = start.noise * random.normal(size=parameters.vertices.shape)
    return with_parameters(pattern, replace(parameters, vertices=parameters.vertices + way))


def valid(pattern: Pattern) -> bool:
    """Whether all panels are simple closed loops."""
    try:
        validate(pattern)
    except InputError:
        return False
    return True


def covered(known: Uncertainty | None, truth: Pattern) -> float | None:
    """The share of true edge lengths that lie within their 95 % intervals."""
    if known is None:
        return None
    lengths = np.asarray(edge_lengths(pattern_parameters(truth), edge_table(truth)))
    return float(np.mean(np.abs(known.lengths - lengths) <= NORMAL_95 * known.length_deviation))


def main() -> None:
    """Run one case and write its row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", nargs=5, metavar=("PATTERN", "BODY", "START", "VIEW", "VARIANT"))
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--edge-length", type=float, required=True)
    parser.add_argument("--iterations", type=int, required=True)
    options = parser.parse_args()
    case = Case(*options.case)
    row: dict = {"name": case.name, **dataclasses.asdict(case)}
    try:
        row |= recover(case, options.data, options.out, options)
    except InputError as error:
        row["error"] = str(error)
    except Exception as error:
        traceback.print_exc()
        row["error"] = f"CRASH {type(error).__name__}: {error}"
    path = options.out / "rows" / f"{case.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(row, indent=1))


if __name__ == "__main__":
    main()
