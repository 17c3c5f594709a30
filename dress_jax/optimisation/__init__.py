"""Fitting a pattern to images: `make_problem`, `init`, `step`, `fit` (S9)."""

from dress_jax.optimisation.evaluation import Evaluation as Evaluation
from dress_jax.optimisation.evaluation import evaluate as evaluate
from dress_jax.optimisation.evaluation import length_errors as length_errors
from dress_jax.optimisation.gauss_newton.method import GaussNewtonState as GaussNewtonState
from dress_jax.optimisation.gauss_newton.options import GaussNewtonOptions as GaussNewtonOptions
from dress_jax.optimisation.loop import AnyState as AnyState
from dress_jax.optimisation.loop import blank_state as blank_state
from dress_jax.optimisation.loop import finished as finished
from dress_jax.optimisation.loop import fit as fit
from dress_jax.optimisation.loop import init as init
from dress_jax.optimisation.loop import step as step
from dress_jax.optimisation.observation import Observation as Observation
from dress_jax.optimisation.observation import make_observation as make_observation
from dress_jax.optimisation.observation import observe as observe
from dress_jax.optimisation.options import PAPER_WEIGHTS as PAPER_WEIGHTS
from dress_jax.optimisation.options import FitMethod as FitMethod
from dress_jax.optimisation.options import FitOptions as FitOptions
from dress_jax.optimisation.options import LearningRates as LearningRates
from dress_jax.optimisation.problem import FitProblem as FitProblem
from dress_jax.optimisation.problem import fitted_pattern as fitted_pattern
from dress_jax.optimisation.problem import make_problem as make_problem
from dress_jax.optimisation.report import FitInfo as FitInfo
from dress_jax.optimisation.report import StepOutcome as StepOutcome
from dress_jax.optimisation.state import FitState as FitState
from dress_jax.optimisation.state import Unknowns as Unknowns
