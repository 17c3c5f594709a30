"""What a fit works on, made from what its folder keeps (S9)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from dress_jax.application.drape import DrapeOptions
from dress_jax.application.targets import TargetViews
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.panels import FacePanels
from dress_jax.io.results import DrapedState
from dress_jax.optimisation import FitOptions, FitProblem, make_problem
from dress_jax.pattern import Discretization, Pattern
from dress_jax.pattern.rules import Rule
from dress_jax.sim import make_simulation

_GREY = 0.5


def usable(options: FitOptions, views: TargetViews) -> FitOptions:
    """Without the terms for which the targets hold no pictures."""
    absent = {
        "mask": not views.has_mask,
        "color": not views.has_color,
        "normal": not views.has_normal,
    }
    weights = {name: w for name, w in options.weights.items() if not absent.get(name, False)}
    return dataclasses.replace(options, weights=weights)


def fit_problem(
    pattern: Pattern,
    discretization: Discretization,
    start: DrapedState,
    views: TargetViews,
    drape_options: DrapeOptions,
    fit_options: FitOptions,
    rules: Sequence[Rule] = (),
) -> FitProblem:
    """The problem, from the inputs and what `start.h5` holds, so that a resumed one is equal."""
    garment = start.garment
    cloth = make_cloth(
        garment.faces,
        garment.rest_faces,
        rest_positions=garment.rest_positions,
        vertex_count=len(garment.vertices),
        pins=start.pins,
        membrane=drape_options.dressing.membrane,
    )
    simulator, parameters = make_simulation(
        cloth,
        garment.vertices,
        garment.rest_positions,
        fabric=drape_options.fabrics(discretization.panel_names),
        panels=FacePanels(discretization.panel_names, np.asarray(discretization.face_panel)),
        body_vertices=start.body_vertices,
        body_faces=start.body_faces,
        pin_targets=start.pin_targets,
        settings=drape_options.contact,
        newton=drape_options.newton,
        linear_solver=drape_options.dressing.linear_solver,
        broad_phase=drape_options.dressing.broad_phase,
    )
    return make_problem(
        pattern,
        discretization,
        simulator,
        parameters,
        views.observation,
        options=fit_options,
        colors=np.tile(_mean_color(views), (len(garment.vertices), 1)),
        scan=views.scan,
        landmarks=views.landmarks,
        rules=rules,
    )


def _mean_color(views: TargetViews) -> Float[np.ndarray, "3"]:
    """The garment's mean colour in the views; grey where there are no colours."""
    if not views.has_color:
        return np.full(3, _GREY)
    inside = np.asarray(views.observation.garment) > 0.5
    if not inside.any():
        return np.full(3, _GREY)
    return np.asarray(views.observation.color, np.float64)[inside].mean(axis=0)
