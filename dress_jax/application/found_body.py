"""The body of a bundle: fitted to its views, or as a tool or options give it (S7).

Whatever it is, a folder keeps it: `body.obj`, and `wearer.json` with what the wearer is made from,
and how the bundle's world has to be shifted to be the wearer's, where it is dressed with its feet
at y = 0.
"""

import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.application.body_views import body_views
from dress_jax.application.progress import Progress, silent
from dress_jax.application.reconstruct_body import (
    BodyResult,
    body_report,
    reconstruct_body,
    save_body,
)
from dress_jax.application.tailor import template_measurements
from dress_jax.application.wearer import (
    DEFAULT_BODY,
    Wearer,
    find_wearer,
    fitted_wearer,
    pelvis_of,
    static_wearer,
)
from dress_jax.body.model import BodyModel
from dress_jax.capture.body import BodyEstimate, BodyFamily, world_pose
from dress_jax.capture.bundle import Bundle
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.io.bodies import body_from_argument, load_body_model, load_default_body
from dress_jax.io.documents import read_json, write_json
from dress_jax.io.meshes import write_body_obj
from dress_jax.io.person import SavedBody, read_body, write_body
from dress_jax.io.report import write_report
from dress_jax.pattern.templates import Measurements
from dress_jax.reconstruction import (
    BodyParameters,
    Free,
    ReconstructionOptions,
)
from dress_jax.reconstruction.options import Weights
from dress_jax.reconstruction.parameters import make_parameters, rest_pelvis

WEARER, BODY = "wearer.json", "body.npz"
# A detector errs in the same way in all views, by about a hundredth of the picture's height, so
# that its landmarks are worth 65 observations, however many views there are: 100 * 0.01^2 / 65. The
# weights of an estimate keep shapes as human (docs/pipeline.md: what smaller ones did).
_WEIGHTS = Weights(prior=1.5e-4, pose=1.5e-2, shape=2e-3)
_LANDMARK_STEPS = 300  # one view is a long valley: arms and legs go forward and back
_FITTED, _GIVEN, _MESH = "fitted", "given", "mesh"


@dataclasses.dataclass(frozen=True)
class BodyOptions:
    """Which body wears the garment.

    Attributes:
        body: "default", an SMPL-X `.npz` file, or a static mesh in metres.
        pose: a named pose or an `.npz` file: the body is then known, and nothing is fitted.
        shape: a named shape or measures of the default body; likewise.
        keep_estimate: take the bundle's estimate as it is; needs the SMPL-X file it is for.
        iterations: of the fine stage of the fit.
        height: of the person [m], for a single view, which cannot tell it; None for the body's own.
    """

    body: str = DEFAULT_BODY
    pose: str | None = None
    shape: str = "average"
    keep_estimate: bool = False
    iterations: int = 100
    height: float | None = None

    @property
    def known(self) -> bool:
        """Whether the options alone name a body in its pose."""
        rigged = self.body == DEFAULT_BODY or Path(self.body).suffix.lower() == ".npz"
        return self.pose is not None or self.shape != "average" or not rigged


def why_no_fit(bundle: Bundle, options: BodyOptions) -> str:
    """Why no body is fitted to the views; empty where one is."""
    if options.known:
        return "The body and its pose are given by options."
    if options.keep_estimate:
        return "The bundle's estimate of the body is taken as it is."
    if bundle.body_mesh is not None and options.body == DEFAULT_BODY:
        return "The bundle holds the body as a mesh, which is dressed in its own pose."
    return ""


def find_body(
    folder: str | Path,
    bundle: Bundle,
    *,
    options: BodyOptions | None = None,
    single_view: bool = False,
    progress: Progress = silent,
) -> tuple[bool, tuple[str, ...]]:
    """Find the body and keep it in a folder, for `load_wearer`.

    Args:
        folder: of the stage.
        bundle: complete (`application.completion`).
        options: see `BodyOptions`.
        single_view: the only view is a photograph with an assumed camera.
        progress: told about every step.

    Returns:
        Whether the fit is good (True where none was needed), and notes for the reader.

    Raises:
        InputError: there is nothing to fit to, or what was asked for does not fit the bundle.
    """
    folder = Path(folder)
    options = BodyOptions() if options is None else options
    if options.known:
        wearer = find_wearer(options.body, pose=options.pose, shape=options.shape)
        settings = {"body": options.body, "pose": options.pose, "shape": options.shape}
        return _keep(folder, wearer, {"kind": _GIVEN, **settings}, np.zeros(3))
    mesh = bundle.body_mesh
    if options.keep_estimate:
        model = _model(options.body)
        found = _estimate(bundle, model)
        return _keep_rigged(folder, model, options, found)
    if mesh is not None and options.body == DEFAULT_BODY:
        offset = np.array([0.0, -float(mesh.vertices[:, 1].min()), 0.0])
        wearer = static_wearer(mesh.vertices + offset, mesh.faces, body="mesh of the bundle")
        return _keep(folder, wearer, {"kind": _MESH}, offset)
    return _fit(folder, bundle, options, single_view, progress)


def load_wearer(folder: str | Path) -> tuple[Wearer, Float[np.ndarray, "3"]]:
    """The wearer that `find_body` kept, and how the bundle's world is shifted to be its [m].

    Raises:
        InputError: files are missing or damaged.
    """
    folder = Path(folder)
    document = read_json(folder / WEARER, what="a body that was found")
    try:
        kind, offset = document["kind"], np.asarray(document["offset_m"], float).reshape(3)
        if kind == _GIVEN:
            wearer = find_wearer(document["body"], pose=document["pose"], shape=document["shape"])
        elif kind == _MESH:
            wearer = find_wearer(folder / "body.obj")
        else:
            model, saved = _model(document["body"]), read_body(folder / BODY)
            wearer = fitted_wearer(
                model, saved.pose, saved.shape, scale=saved.scale, body=document["body"]
            )
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "is damaged", where=str(folder / WEARER), mend="find the body again"
        ) from error
    return wearer, offset


def measurements_of(folder: str | Path) -> Measurements:
    """Measurements of the body that `find_body` kept, for `pattern.templates`.

    Raises:
        InputError: the body is a mesh without joints, or has none of the usual sections.
    """
    folder = Path(folder)
    document = read_json(folder / WEARER, what="a body that was found")
    kind, body = document.get("kind"), str(document.get("body", DEFAULT_BODY))
    scale = 1.0
    if kind == _FITTED:
        saved = read_body(folder / BODY)
        model, shape, scale = _model(body), saved.shape, saved.scale
    else:
        loaded = None if kind == _MESH else body_from_argument(body, shape=document["shape"])
        if loaded is None or loaded.model is None or loaded.shape is None:
            raise InputError(
                "is a mesh without joints, which no template is made to measure for",
                where=str(folder / "body.obj"),
                mend="give a start pattern with --pattern",
            )
        model, shape = loaded.model, loaded.shape
    try:
        return template_measurements(model, shape, scale=scale)
    except ValueError as error:
        raise InputError(
            f"cannot be measured: {error}", where=str(folder), mend="give a start pattern"
        ) from error


def moved_bundle(bundle: Bundle, offset: Float[np.ndarray, "3"]) -> Bundle:
    """A bundle in a world that is shifted: cameras and surfaces, everything that a fit looks at."""
    views = tuple(
        dataclasses.replace(
            view, camera=replace(view.camera, position=view.camera.position + jnp.asarray(offset))
        )
        for view in bundle.views
    )
    scan = bundle.scan
    if scan is not None:
        scan = dataclasses.replace(scan, vertices=scan.vertices + offset)
    return dataclasses.replace(bundle, views=views, scan=scan)


def _fit(
    folder: Path, bundle: Bundle, options: BodyOptions, single_view: bool, progress: Progress
) -> tuple[bool, tuple[str, ...]]:
    model, notes, estimate = _model(options.body), [], None
    if bundle.body is not None and _matches(bundle.body, model):
        estimate = _estimate(bundle, model)
        notes.append("The fit begins with the bundle's estimate of the body, and stays near it.")
    elif bundle.body is not None:
        notes.append(
            f"The bundle's estimate is for {bundle.body.family.value}, the body is another one: it "
            "is fitted without the estimate."
        )
    if single_view:
        notes.append("Depth and size are not told apart by one view: the size is assumed.")
    scale = not single_view  # a farther, larger person looks the same
    result = reconstruct_body(
        body_views(bundle),
        body=options.body,
        estimate=estimate,
        options=ReconstructionOptions(
            fine_iterations=options.iterations,
            landmark_iterations=_LANDMARK_STEPS,
            weights=_WEIGHTS,
            free=Free(scale=scale),
            coarse=Free(scale=scale, pose=False, hands=False, shape=False),
        ),
        progress=progress,
    )
    parameters = result.found.parameters
    save_body(folder, result, body_report(result))
    if single_view and options.height is not None:
        parameters = _of_height(result, options.height, bundle)
        notes.append(f"The body was scaled to a height of {options.height:g} m.")
    if not result.good:
        notes.append("The body fit did not come to its end; see its report.")
    _, more = _keep_rigged(folder, model, options, parameters)
    return result.good, (*notes, *more)


def _of_height(result: BodyResult, height: float, bundle: Bundle) -> BodyParameters:
    """The body seen from the same eye, larger and farther, or smaller and nearer."""
    found = result.found.parameters
    standing = fitted_wearer(
        result.model, np.zeros((len(result.model.parents), 3)), np.asarray(found.shape)
    )
    wanted = height / float(np.ptp(standing.start[:, 1]))
    eye = jnp.asarray(bundle.views[0].camera.position, found.translation.dtype)
    return replace(
        found,
        log_scale=jnp.log(jnp.asarray(wanted, found.log_scale.dtype)),
        translation=eye + wanted / found.scale * (found.translation - eye),
    )


def _model(body: str) -> BodyModel:
    return load_default_body() if body == DEFAULT_BODY else load_body_model(body)


def _matches(estimate: BodyEstimate, model: BodyModel) -> bool:
    """Whether shape coefficients mean the same; the embedded body has shapes with names."""
    return estimate.family is BodyFamily.SMPLX and not model.shape_names


def _estimate(bundle: Bundle, model: BodyModel) -> BodyParameters:
    """The bundle's estimate on the model that it is for."""
    estimate = bundle.body
    if estimate is None:
        raise InputError(
            "there is no estimate of the body to keep", where="bundle", mend="leave --keep-body out"
        )
    if not _matches(estimate, model):
        raise InputError(
            f"is for {estimate.family.value}, and the body is another one",
            where="estimate of the body",
            mend="give the SMPL-X file with --body, or let the body be fitted",
        )
    pelvis = rest_pelvis(model, estimate.betas)
    pose, translation = world_pose(estimate, pelvis)
    return make_parameters(
        model,
        pose=pose,
        shape=estimate.betas,
        scale=estimate.scale,
        translation=estimate.scale * (pelvis + translation),
    )


def _keep_rigged(
    folder: Path, model: BodyModel, options: BodyOptions, found: BodyParameters
) -> tuple[bool, tuple[str, ...]]:
    pose, shape = (np.array(a, np.float64) for a in (found.pose, found.shape))
    scale = found.scale
    wearer = fitted_wearer(model, pose, shape, scale=scale)
    offset = pelvis_of(model, shape, scale=scale) - np.asarray(found.translation, np.float64)
    pelvis = rest_pelvis(model, shape)
    write_body(
        folder / BODY,
        SavedBody(pose, shape, scale, np.asarray(found.translation) / scale - pelvis),
        smplx=options.body != DEFAULT_BODY,
    )
    return _keep(folder, wearer, {"kind": _FITTED, "body": options.body}, offset)


def _keep(
    folder: Path, wearer: Wearer, document: dict[str, Any], offset: np.ndarray
) -> tuple[bool, tuple[str, ...]]:
    write_body_obj(folder / "body.obj", wearer.vertices, wearer.faces)
    if not (folder / "report.json").exists():
        height = float(np.ptp(wearer.start[:, 1]))
        write_report(folder / "report.json", {"kind": document["kind"], "height_m": height})
    write_json(folder / WEARER, {**document, "offset_m": offset.tolist()})
    return True, ()
