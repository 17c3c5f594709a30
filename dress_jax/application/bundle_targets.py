"""An observation bundle as what a fit looks at (S6.3, S10.2 to S10.4)."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8

from dress_jax.application.progress import Progress, silent
from dress_jax.application.targets import TargetViews, read_targets
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.frames import view_azimuth
from dress_jax.capture.labels import CLOTHES
from dress_jax.capture.surfaces import Surface, split_clothes
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.io.capture.bundles import is_bundle, load_bundle
from dress_jax.io.images import Targets
from dress_jax.optimisation.observation import make_observation
from dress_jax.render.cameras import cameras_to_dict, stack_cameras
from dress_jax.render.images import check_image, render
from dress_jax.render.mesh import RenderMesh, make_render_mesh

_CORE = 0.99  # colours and normals count where clothes cover this part of a pixel

_render = jax.jit(render)


def read_views(path: str | Path) -> TargetViews:
    """What a fit looks at, from a target folder or from a bundle of either form.

    Raises:
        InputError: neither is there, or it lacks what a fit needs.
    """
    if not is_bundle(path):
        return read_targets(path)
    try:
        return bundle_targets(load_bundle(path))
    except InputError as error:
        where = error.where if str(path) in error.where else f"{path}, {error.where}"
        raise InputError(error.problem, where=where, mend=error.mend) from error


def bundle_targets(bundle: Bundle) -> TargetViews:
    """The views of a bundle as a fit looks at them.

    Masks are the clothes; pixels that hair or accessories cover do not count (S10.4). Colours and
    normals count inside the clothes, and only where every view has them. Kinds of clothes are told
    apart where there are two at least. The scan is not part of it: a fit is given that by name.

    Raises:
        InputError: there are no views, one has no mask, cameras differ in kind or size, or no view
            shows any clothes.
    """
    views = bundle.views
    if not views:
        raise InputError("there are no views", where="views", mend="add some to the bundle")
    for view in views:
        if view.mask is None:
            raise InputError(
                "has no mask of the clothes",
                where=f"view '{view.name}'",
                mend="add a label map per view (bundle --source labels), or draw masks from a "
                "labelled scan (bundle --draw-masks)",
            )
    mask = _coverage([view.mask for view in views if view.mask is not None])
    valid = 1.0 - _coverage([_or_none(view, view.hidden) for view in views])
    inside = (mask >= _CORE) & (valid >= _CORE)
    kinds = [kind.name.lower() for kind in CLOTHES]
    worn = [kind for kind in kinds if any(kind in view.parts for view in views)]
    worn += sorted({name for view in views for name in view.parts} - set(kinds))
    parts = None
    if len(worn) > 1:
        stacks = [_coverage([_or_none(view, view.parts.get(k)) for view in views]) for k in worn]
        parts = np.stack(stacks, axis=-1)
    rgb = [view.rgb for view in views if view.rgb is not None]
    normals = [view.normal for view in views if view.normal is not None]
    color = _coverage(rgb) * inside[..., None] if len(rgb) == len(views) else None
    normal = np.stack(normals) * inside[..., None] if len(normals) == len(views) else None
    observation = make_observation(
        stack_cameras([view.camera for view in views]),
        mask,
        parts=parts,
        color=color,
        normal=normal,
        valid=valid >= _CORE,
        garment=inside,
    )
    return TargetViews(
        observation=observation,
        azimuths=tuple(view_azimuth(view.camera) for view in views),
        has_color=color is not None,
        has_normal=normal is not None,
        truth=None,
    )


def bundle_pictures(bundle: Bundle) -> Targets | None:
    """The views of a bundle as pictures to texture from; None where one lacks colours or a mask.

    Raises:
        InputError: two views stand at the same azimuth, by which pictures are named.
    """
    views = bundle.views
    rgb = [view.rgb for view in views if view.rgb is not None]
    masks = [view.mask for view in views if view.mask is not None]
    if not views or len(rgb) < len(views) or len(masks) < len(views):
        return None
    azimuths = tuple(view_azimuth(view.camera) for view in views)
    if len(set(azimuths)) < len(azimuths):
        raise InputError(
            f"azimuths repeat: {sorted(azimuths)}", where="views", mend="leave some views out"
        )
    normals = [view.normal for view in views if view.normal is not None]
    return Targets(
        azimuths=azimuths,
        cameras=tuple(cameras_to_dict([view.camera for view in views])["cameras"]),
        rgb=_coverage(rgb),
        normal=np.stack(normals) if len(normals) == len(views) else None,
        mask=_coverage(masks),
    )


def true_garment(bundle: Bundle) -> Surface | None:
    """The scan where it is a garment and nothing else, as data sets with a true one have it."""
    scan = bundle.scan
    if scan is None or scan.labels is None or not len(scan.faces):
        return None
    return scan if bool(np.isin(scan.labels, CLOTHES).all()) else None


def draw_masks(bundle: Bundle, *, progress: Progress = silent) -> Bundle:
    """Masks of the clothes in every view, drawn from the labelled scan.

    What the scan shows besides clothes hides them; a scan of clothes alone is hidden by nothing, so
    that arms in front of it count as clothes. Where a view has a matte, masks are cut to it.

    Args:
        bundle: with views and a labelled mesh as the scan.
        progress: told about every view.

    Raises:
        InputError: there are no views, or no labelled mesh with clothes on it.
    """
    scan = bundle.scan
    if scan is None or not bundle.views:
        raise InputError(
            "masks are drawn from a scan into views",
            where="bundle",
            mend="give a bundle that has both",
        )
    if len(scan.faces) == 0:
        raise InputError("is a cloud of points, which hides nothing", where="scan")
    clothes, rest = split_clothes(scan)
    if clothes is None:
        raise InputError("shows no clothes", where="scan", mend="check its labels")
    garment = make_render_mesh(
        jnp.asarray(clothes.vertices), clothes.faces, attributes=_channels(clothes)
    )
    occluder = None if rest is None else make_render_mesh(jnp.asarray(rest.vertices), rest.faces)
    views = []
    for number, view in enumerate(bundle.views):
        views.append(_drawn(view, garment, occluder, clothes))
        progress("render", number + 1, len(bundle.views))
    source = f"{bundle.sources.get('views', 'views')}, masks drawn from the scan"
    return dataclasses.replace(
        bundle, views=tuple(views), sources={**bundle.sources, "views": source}
    )


def _drawn(view: View, garment: RenderMesh, occluder: RenderMesh | None, scan: Surface) -> View:
    image = check_image(_render(view.camera, garment, occluder))

    def cut(coverage: np.ndarray) -> UInt8[np.ndarray, "h w"]:
        pixels = np.round(255.0 * np.clip(coverage, 0.0, 1.0)).astype(np.uint8)
        return pixels if view.matte is None else np.minimum(pixels, view.matte)

    channels = np.asarray(image.attributes)
    parts = {
        kind.name.lower(): cut(channels[..., k])
        for k, kind in enumerate(CLOTHES)
        if scan.labels is not None and (scan.labels == kind).any()
    }
    return dataclasses.replace(view, mask=cut(np.asarray(image.mask)), parts=parts)


def _channels(clothes: Surface) -> jax.Array:
    labels = np.zeros(len(clothes.vertices)) if clothes.labels is None else clothes.labels
    return jnp.asarray(np.stack([labels == kind for kind in CLOTHES], axis=1), jnp.float32)


def _coverage(pictures: list[np.ndarray]) -> np.ndarray:
    """8-bit pictures as numbers in [0, 1], stacked.

    Raises:
        InputError: they differ in size.
    """
    if len({array.shape for array in pictures}) > 1:
        raise InputError("views differ in size", where="views", mend="give all the same size")
    return np.stack(pictures).astype(np.float32) / 255.0


def _or_none(view: View, picture: np.ndarray | None) -> np.ndarray:
    """A picture, or one in which nothing is covered."""
    size = (view.camera.height, view.camera.width)
    return np.zeros(size, np.uint8) if picture is None else picture
