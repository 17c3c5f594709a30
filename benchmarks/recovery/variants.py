"""Fits with a part left out or changed: what the ablation table compares."""

import dataclasses
from collections.abc import Callable, Mapping

from dress_jax.optimisation import PAPER_WEIGHTS, FitMethod, FitOptions

Variant = Callable[[FitOptions], FitOptions]


def _with(**changes: object) -> Variant:
    """A variant with other options of the Gauss-Newton method."""
    return lambda options: dataclasses.replace(
        options, gauss_newton=dataclasses.replace(options.gauss_newton, **changes)
    )


def _adam(options: FitOptions) -> FitOptions:
    return dataclasses.replace(options, method=FitMethod.ADAM, stage_one=options.iterations // 3)


def _without(term: str) -> Variant:
    def changed(options: FitOptions) -> FitOptions:
        weights = {name: w for name, w in options.weights.items() if name != term}
        return dataclasses.replace(options, weights=weights)

    return changed


def _stronger(term: str, factor: float) -> Variant:
    def changed(options: FitOptions) -> FitOptions:
        return dataclasses.replace(
            options, weights={**options.weights, term: factor * options.weights[term]}
        )

    return changed


def _then(first: Variant, second: Variant) -> Variant:
    return lambda options: second(first(options))


def _asymmetric(options: FitOptions) -> FitOptions:
    return dataclasses.replace(options, symmetrize=False)


WHOLE = "whole"

GAUSS_NEWTON: Mapping[str, Variant] = {
    WHOLE: lambda options: options,
    "no-normals": _without("normal"),
    "no-guidance": _with(guidance=0),
    "one-round": _with(guidance=1),
    "no-recentering": _with(recenterings=0),
    "no-symmetry": _asymmetric,
    "weak-shape": _with(shape_scale=2.5, size_scale=6.0),
    "weak-seams": _with(seam_scale=0.2),
}
"""Of the default method; without outlines it has no data, so they stay."""

ADAM: Mapping[str, Variant] = {
    "adam": _adam,
    **{f"adam-no-{term.replace('_', '-')}": _then(_adam, _without(term)) for term in PAPER_WEIGHTS},
    "adam-no-symmetry": _then(_adam, _asymmetric),
    "adam-one-stage": _then(_adam, lambda options: dataclasses.replace(options, stage_one=0)),
    "adam-laplacian-10": _then(_adam, _stronger("laplacian", 10.0)),
    "adam-laplacian-100": _then(_adam, _stronger("laplacian", 100.0)),
}
"""Of the paper's, one for every term of its loss (S18)."""

VARIANTS: Mapping[str, Variant] = {**GAUSS_NEWTON, **ADAM}
