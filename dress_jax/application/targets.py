"""Target views of a dressed body: drawn from a drape, and read as what a fit looks at (S6.1)."""

import dataclasses
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.application.progress import Progress, silent
from dress_jax.capture.surfaces import Surface
from dress_jax.core.errors import InputError
from dress_jax.geometry.topology import connected_components
from dress_jax.io.body_meshes import read_surface
from dress_jax.io.documents import read_json
from dress_jax.io.images import Targets, load_targets, save_targets
from dress_jax.io.meshes import GarmentMesh, read_garment_obj, write_garment_obj
from dress_jax.io.results import DrapedState
from dress_jax.optimisation import Landmark, Scan, make_scan
from dress_jax.optimisation.observation import Observation, make_observation
from dress_jax.render.cameras import Camera, cameras_from_dict, cameras_to_dict, stack_cameras
from dress_jax.render.images import check_image, render
from dress_jax.render.mesh import make_render_mesh
from dress_jax.render.rings import frame_body, magicman_cameras
from dress_jax.render.shading import BODY_COLOR, GARMENT_COLOR

VIEWS, SIZE = 20, 512
SCAN_VIEWS, SCAN_SIZE = 4, 128
TRUTH = "garment.obj"
"""Name of the true garment in a target folder that was drawn from one."""

_CORE = 0.99  # colours and normals count where the garment covers this part of a pixel

_render = jax.jit(render)


@dataclasses.dataclass(frozen=True)
class TargetViews:
    """What a target folder holds.

    Attributes:
        observation: the views, as a fit looks at them.
        azimuths: name of each view [degrees].
        has_color, has_normal: which pictures there were besides masks.
        truth: the true garment, where it is known.
        has_mask: whether the masks are to be fitted.
        scan: of the garment, to be fitted as well; None without one.
        landmarks: likewise.
    """

    observation: Observation
    azimuths: tuple[int, ...]
    has_color: bool
    has_normal: bool
    truth: GarmentMesh | Surface | None
    has_mask: bool = True
    scan: Scan | None = None
    landmarks: tuple[Landmark, ...] = ()


def ring(
    vertices: Float[np.ndarray, "n 3"], *, views: int = VIEWS, size: int = SIZE
) -> tuple[tuple[int, ...], list[Camera]]:
    """MagicMan's ring of cameras around a body, and the names of its views.

    View i is named by i (360 // views) degrees; that angle turns the camera towards -x, the
    wearer's right.

    Args:
        vertices: what the frame must hold [m], shape (n, 3).
        views: number of cameras.
        size: image height and width [px].

    Raises:
        InputError: no views, too many, or a size that is not positive.
    """
    center, half_extent = frame_body(vertices)
    cameras = magicman_cameras(views, center=center, half_extent=half_extent, size=size)
    return tuple(i * (360 // views) for i in range(views)), cameras


def draw_targets(
    state: DrapedState, *, views: int = VIEWS, size: int = SIZE, progress: Progress = silent
) -> Targets:
    """Masks, normals and colours of a draped garment from all around.

    Mask and normals show the garment where the body does not hide it; colours show both, unlit, on
    white, so that they can be compared with the renderer's own colours. An outfit of several
    garments gets a mask for each as well.

    Args:
        state: the garment and the body.
        views: number of cameras on the ring.
        size: image height and width [px].
        progress: told about every view.

    Raises:
        InputError: sizes that cannot be drawn, or a contour that could not be followed.
    """
    everything = np.concatenate([state.garment.vertices, state.body_vertices])
    azimuths, cameras = ring(everything, views=views, size=size)
    garments = _garments(state)
    garment = make_render_mesh(
        jnp.asarray(state.garment.vertices),
        state.garment.faces,
        colors=_plain(GARMENT_COLOR, len(state.garment.vertices)),
        attributes=_channels(garments, len(state.garment.vertices)),
    )
    body = make_render_mesh(
        jnp.asarray(state.body_vertices),
        state.body_faces,
        colors=_plain(BODY_COLOR, len(state.body_vertices)),
    )
    masks, normals, colors, parts = [], [], [], {name: [] for name in garments}
    for number, camera in enumerate(cameras):
        dress = check_image(_render(camera, garment, body))
        skin = check_image(_render(camera, body, garment))
        white = 1.0 - np.asarray(dress.mask) - np.asarray(skin.mask)
        masks.append(np.clip(np.asarray(dress.mask), 0.0, 1.0))
        normals.append(np.clip(np.asarray(dress.normal), -1.0, 1.0))
        for channel, own in enumerate(parts.values()):
            own.append(np.clip(np.asarray(dress.attributes[..., channel]), 0.0, 1.0))
        colors.append(np.clip(np.asarray(dress.color + skin.color) + white[..., None], 0.0, 1.0))
        progress("render", number + 1, views)
    return Targets(
        azimuths=azimuths,
        cameras=tuple(cameras_to_dict(cameras)["cameras"]),
        rgb=np.stack(colors),
        normal=np.stack(normals),
        mask=np.stack(masks),
        parts={name: np.stack(own) for name, own in parts.items()},
    )


def write_targets(folder: str | Path, targets: Targets, garment: GarmentMesh | None = None) -> None:
    """Write a target folder, with the true garment beside the pictures where it is known."""
    if garment is not None:
        write_garment_obj(Path(folder) / TRUTH, garment)
    save_targets(folder, targets)


def read_targets(folder: str | Path) -> TargetViews:
    """Read a target folder.

    Raises:
        InputError: something is missing or malformed; masks are needed.
    """
    folder = Path(folder)
    targets = load_targets(folder)
    if targets.mask is None:
        raise InputError(
            "holds no masks", where=str(folder), mend="add mask/ with one picture per view"
        )
    if not targets.azimuths:
        raise InputError("holds no views", where=str(folder / "cameras.json"))
    cameras = stack_cameras(cameras_from_dict({"cameras": list(targets.cameras)}))
    truth = folder / TRUTH
    return TargetViews(
        observation=as_observation(targets, cameras),
        azimuths=targets.azimuths,
        has_color=targets.rgb is not None,
        has_normal=targets.normal is not None,
        truth=read_garment_obj(truth) if truth.is_file() else None,
    )


def read_scan(path: str | Path, *, complete: bool = False) -> Scan:
    """A scan of a garment: a mesh or a point cloud, in metres and in the frame of the body.

    Args:
        path: OBJ, PLY, GLB, glTF, STL or OFF file.
        complete: see `optimisation.Scan`.

    Raises:
        InputError: the file is missing or broken, or holds no point.
    """
    vertices, faces = read_surface(path)
    try:
        return make_scan(vertices, faces if len(faces) else None, complete=complete)
    except InputError as error:
        raise InputError(str(error), where=str(path), mend="export the scan again") from error


def read_landmarks(path: str | Path) -> tuple[Landmark, ...]:
    """Landmarks of a JSON file.

    `{"landmarks": [{"panel": "front", "edge": 2, "at": 0.5, "position_m": [0.1, 0.9, 0.1]}, ...]}`;
    instead of a position there may be `"view": 3, "pixel": [210, 330]`. `at` is the fraction of the
    edge's length from its start.

    Raises:
        InputError: names the landmark and what is wrong with it.
    """
    document = read_json(path, what="landmarks")
    listed = document.get("landmarks")
    if not isinstance(listed, list) or not listed:
        raise InputError(
            "has no list 'landmarks'", where=str(path), mend='write {"landmarks": [...]}'
        )
    return tuple(
        _landmark(entry, f"{path}, landmark {number}") for number, entry in enumerate(listed)
    )


def _landmark(entry: Any, where: str) -> Landmark:
    keys = {"panel", "edge", "at"}
    wanted = [keys | {"position_m"}, keys | {"view", "pixel"}]
    if not isinstance(entry, dict) or set(entry) not in wanted:
        found = sorted(entry) if isinstance(entry, dict) else entry
        raise InputError(
            f"has keys {found}",
            where=where,
            mend="give panel, edge, at, and either position_m, or view and pixel",
        )
    own = {name: entry[name] for name in ("edge", "view") if name in entry}
    whole = all(isinstance(n, int) and not isinstance(n, bool) for n in own.values())
    if not (isinstance(entry["panel"], str) and whole and isinstance(entry["at"], (int, float))):
        raise InputError("panel is a name, edge and view are whole numbers", where=where)

    def numbers(name: str) -> tuple[float, ...] | None:
        values = entry.get(name)
        if values is None:
            return None
        if not isinstance(values, list) or not all(isinstance(v, (int, float)) for v in values):
            raise InputError(f"{name} is {values!r}, no list of numbers", where=where)
        return tuple(float(v) for v in values)

    return Landmark(
        entry["panel"],
        entry["edge"],
        float(entry["at"]),
        position=cast(Any, numbers("position_m")),
        view=entry.get("view"),
        pixel=cast(Any, numbers("pixel")),
    )


def views_without_pictures(
    body_vertices: Float[np.ndarray, "b 3"],
    *,
    scan: Scan | None = None,
    landmarks: tuple[Landmark, ...] = (),
    views: int = SCAN_VIEWS,
    size: int = SCAN_SIZE,
) -> TargetViews:
    """A scan or landmarks alone as what a fit looks at: cameras for its pictures, nothing in them.

    Args:
        body_vertices: the body, which the cameras frame [m].
        scan: of the garment.
        landmarks: of the garment, in space.
        views, size: of the cameras.

    Raises:
        InputError: a landmark in a picture.
    """
    for number, mark in enumerate(landmarks):
        if mark.view is not None:
            raise InputError(
                "there are no pictures", where=f"landmark {number}", mend="give target views"
            )
    seen = body_vertices if scan is None else np.concatenate([scan.points, body_vertices])
    azimuths, cameras = ring(seen, views=views, size=size)
    stack = stack_cameras(cameras)
    shape = (views, size, size)
    empty = np.zeros((*shape, 3), np.float32)
    return TargetViews(
        observation=Observation(
            cameras=stack,
            mask=jnp.zeros(shape, jnp.float32),
            parts=jnp.zeros((*shape, 1), jnp.float32),
            color=jnp.asarray(empty),
            normal=jnp.asarray(empty),
            valid=jnp.zeros(shape, jnp.float32),
            garment=jnp.zeros(shape, jnp.float32),
        ),
        azimuths=azimuths,
        has_color=False,
        has_normal=False,
        truth=None,
        has_mask=False,
        scan=scan,
        landmarks=landmarks,
    )


def as_observation(targets: Targets, cameras: Camera) -> Observation:
    """Target pictures as a fit looks at them.

    Colours and normals count inside the garment only: a pixel on its contour shows what is behind
    it as well.

    Raises:
        InputError: pictures and cameras that do not fit each other.
    """
    if targets.mask is None:
        raise InputError("there are no masks", where="targets")
    core = targets.mask >= _CORE
    color = None if targets.rgb is None else targets.rgb * core[..., None]
    normal = None
    if targets.normal is not None:
        # Eight bits shorten normals a little.
        length = np.linalg.norm(targets.normal, axis=-1, keepdims=True)
        unit = targets.normal / np.where(length > 0.0, length, 1.0)
        normal = unit * core[..., None]
    parts = np.stack(list(targets.parts.values()), axis=-1) if targets.parts else None
    return make_observation(
        cameras, targets.mask, parts=parts, color=color, normal=normal, garment=core
    )


def _garments(state: DrapedState) -> dict[str, Int[np.ndarray, " k"]]:
    """The vertices of each garment of an outfit, from the top down; nothing for a single one."""
    count = len(state.garment.vertices)
    label = connected_components(state.garment.faces, count)
    own = [np.flatnonzero(label == number) for number in range(int(label.max()) + 1)]
    own.sort(key=lambda vertices: -float(state.garment.vertices[vertices, 1].mean()))
    return {} if len(own) == 1 else {f"garment-{k + 1}": v for k, v in enumerate(own)}


def _channels(garments: dict[str, Int[np.ndarray, " k"]], count: int) -> Float[Array, "n c"]:
    channels = np.zeros((count, len(garments)), np.float32)
    for channel, vertices in enumerate(garments.values()):
        channels[vertices, channel] = 1.0
    return jnp.asarray(channels)


def _plain(color: tuple[float, float, float], count: int) -> Float[Array, "n 3"]:
    return jnp.tile(jnp.asarray(color, jnp.float32)[None], (count, 1))
