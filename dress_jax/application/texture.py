"""From a fitted garment and pictures of it to a textured one (S14)."""

import dataclasses
import enum
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, UInt8

from dress_jax.application.progress import Progress, silent
from dress_jax.application.tile_sources import read_tile, run_tile_command
from dress_jax.core.errors import InputError
from dress_jax.io.figures import write_comparison
from dress_jax.io.images import Targets, write_rgb
from dress_jax.io.report import write_report
from dress_jax.io.results import DrapedState, versions, write_picture
from dress_jax.io.textured import write_textured_glb, write_textured_obj
from dress_jax.render.cameras import Camera, cameras_from_dict
from dress_jax.render.rings import frame_body, ring_cameras
from dress_jax.texture.atlas import Atlas, find_texels, pack_panels
from dress_jax.texture.baking import INSIDE, Baked, View, bake, outer_sides
from dress_jax.texture.cut import Cut, cut_cloth
from dress_jax.texture.filling import Shares, fill
from dress_jax.texture.panel_maps import Occluder, panel_map
from dress_jax.texture.square import Square, even_cloth, uniform_square
from dress_jax.texture.surface import PanelSurface, make_panel_surface
from dress_jax.texture.textured import Texture, atlas_texture, draw_textured, tile_texture
from dress_jax.texture.tiling import Tile, seamless_tile, wrap_jump

FACING = (0.6, 0.4, 0.2)
"""Smallest cosines between cloth and view for the square, tried in turn until one has a square."""

COMPARED_VIEWS = 4
_T = TypeVar("_T")
_PREVIEW = 512  # px
_SUPERSAMPLING = 2


class Mode(enum.Enum):
    """Where a texture comes from."""

    TILE = "tile"
    BAKE = "bake"


@dataclasses.dataclass(frozen=True)
class TextureOptions:
    """How a garment is textured.

    Attributes:
        mode: one tile per garment repeated over its panels, or an atlas baked from all views.
        view: azimuth by name of the view that the square is cut from [degrees].
        texel_size: of a baked atlas [m]; that of the finest pixel on the garment when None.
        tile: a tileable picture instead of a cut.
        tile_command: a command that makes a tile of the cut, see `tile_sources`.
        tile_width: of the cloth that such a tile shows [m].
    """

    mode: Mode = Mode.TILE
    view: int = 0
    texel_size: float | None = None
    tile: Path | None = None
    tile_command: str | None = None
    tile_width: float | None = None

    def __post_init__(self) -> None:
        if self.tile is not None and self.tile_command is not None:
            raise InputError("there are a tile and a tile command", where="tile", mend="give one")
        if self.tile is not None and self.tile_width is None:
            raise InputError(
                "the size of a tile from a file is unknown",
                where=str(self.tile),
                mend="give the width of the cloth that it shows with --tile-size-cm",
            )
        if self.tile is None and self.tile_command is None and self.tile_width is not None:
            raise InputError(
                "a size is given for a tile that is cut from the picture",
                where="tile size",
                mend="leave it away: the cut's size is measured; or give a tile",
            )
        for name, value in (("tile size", self.tile_width), ("texel size", self.texel_size)):
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"is {value} m", where=name, mend="give a positive number")


@dataclasses.dataclass(frozen=True)
class Piece:
    """A piece of cloth that was found in the front view.

    Attributes:
        square: where.
        cosine: smallest cosine between cloth and view that was allowed.
        cut: it, flat.
    """

    square: Square
    cosine: float
    cut: Cut


@dataclasses.dataclass(frozen=True)
class TextureResult:
    """A textured garment.

    Attributes:
        state, surface, options: what was textured.
        views: what was looked at, all of it for a baked atlas.
        azimuths: their names [degrees].
        texture: the result.
        pieces: of each garment, None where none was looked for or found.
        tiles: likewise.
        atlas, baked, shares: of a baked texture, else None.
    """

    state: DrapedState
    surface: PanelSurface
    options: TextureOptions
    views: tuple[View, ...]
    azimuths: tuple[int, ...]
    texture: Texture
    pieces: tuple[Piece | None, ...]
    tiles: tuple[Tile | None, ...]
    atlas: Atlas | None = None
    baked: Baked | None = None
    shares: tuple[Shares, ...] = ()


def texture_garment(
    state: DrapedState,
    targets: Targets,
    *,
    options: TextureOptions | None = None,
    progress: Progress = silent,
) -> TextureResult:
    """Texture a garment from pictures of it.

    Args:
        state: the garment and the body, from a drape or a fit.
        targets: pictures with masks and cameras; normals are used where they are there.
        options: see `TextureOptions`.
        progress: told about every view.

    Raises:
        InputError: pictures are missing or do not fit their cameras, no view has the asked name,
            no piece of cloth can be cut, or a tile from elsewhere cannot be had.
    """
    options = TextureOptions() if options is None else options
    garment, body = state.garment, (state.body_vertices, state.body_faces)
    surface = make_panel_surface(
        garment.vertices,
        garment.faces,
        garment.rest_positions,
        garment.rest_faces,
        garment.panels,
        garment.face_panels,
    )
    cameras = _cameras(targets)
    front = _named_view(targets, options.view)
    baking = options.mode is Mode.BAKE
    wanted = range(len(cameras)) if baking else _compared(targets, front)
    views, azimuths = {}, {}
    for done, number in enumerate(wanted):
        views[number] = _view(targets, number, cameras[number], surface, body)
        azimuths[number] = targets.azimuths[number]
        progress("views", done + 1, len(wanted))
    pieces, tiles = _tiles(targets, front, views[front], surface, options)
    made: dict[str, Any] = {}
    if baking:
        texture, made = _baked(tuple(views.values()), surface, tiles, options, progress)
    else:
        texture = tile_texture([_present(tile) for tile in tiles], surface)
    return TextureResult(
        state=state,
        surface=surface,
        options=options,
        views=tuple(views.values()),
        azimuths=tuple(azimuths.values()),
        texture=texture,
        pieces=pieces,
        tiles=tiles,
        **made,
    )


def find_piece(
    view: View,
    surface: PanelSurface,
    component: int,
    *,
    mask: Float[np.ndarray, "h w"] | None = None,
    normal: Float[np.ndarray, "h w 3"] | None = None,
) -> Piece | None:
    """The largest uniform square of a garment in a view, as flat cloth (S14.1).

    Args:
        view: the picture.
        surface: the outfit.
        component: the garment.
        mask: coverage by this garment, where the pictures tell; the view's otherwise.
        normal: as pictured, world frame; folds that the fitted surface lacks are in it.

    Returns:
        The piece, or None where there is no square.
    """
    inside = (view.mask if mask is None else mask) >= INSIDE
    inside &= surface.panel_components[np.maximum(view.seen.panel, 0)] == component
    cosine = view.seen.cosine
    if normal is not None:
        length = np.linalg.norm(normal, axis=-1)
        toward = np.asarray(view.camera.rotation, np.float64)[2]
        pictured = (normal @ toward) / np.where(length > 0.0, length, 1.0)
        cosine = np.minimum(cosine, pictured)
    for smallest in FACING:
        allowed = even_cloth(view.seen, inside, cosine, smallest_cosine=smallest)
        square = uniform_square(view.picture, allowed)
        cut = None if square is None else cut_cloth(view.picture, view.seen, square)
        if square is not None and cut is not None:
            return Piece(square, smallest, cut)
    return None


def texture_report(result: TextureResult) -> dict[str, Any]:
    """Numbers of a textured garment, ready for `report.json`; lengths in metres."""
    garments = {}
    for number, name in enumerate(result.surface.components):
        piece, tile = result.pieces[number], result.tiles[number]
        garments[name] = {
            "square": None if piece is None else _square_report(piece, result.surface),
            "tile": None if tile is None else _tile_report(tile),
        }
    report: dict[str, Any] = {
        "mode": result.options.mode.value,
        "view": result.options.view,
        "tile_source": _tile_source(result.options),
        "garments": garments,
        "error": {str(azimuth): _difference(result, view) for azimuth, view in _shown(result)},
    }
    if result.atlas is not None and result.baked is not None:
        report["atlas"] = {
            "texel_size": result.atlas.texel_size,
            "height": result.atlas.height,
            "width": result.atlas.width,
            "texels": len(result.baked.seen),
            "seen": float(result.baked.seen.mean()),
            "views_per_seen_texel": float(result.baked.views[result.baked.seen].mean()),
        }
        report["panels"] = {
            name: dataclasses.asdict(share)
            for name, share in zip(result.surface.panels, result.shares, strict=True)
        }
    return report


def save_texture(folder: str | Path, result: TextureResult, report: Mapping[str, Any]) -> None:
    """Write `textured.obj` with its materials and pictures, `textured.glb`, `cut-*.png`,
    `preview.png`, `comparison.png`, and last `report.json`.

    Args:
        folder: made where it is missing.
        result: the textured garment.
        report: from `texture_report`, with whatever else belongs into the file.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder = Path(folder)
    # A report that is there already belongs to what is about to be replaced.
    (folder / "report.json").unlink(missing_ok=True)
    for name, piece in zip(result.surface.components, result.pieces, strict=True):
        if piece is not None:
            write_rgb(folder / f"cut-{name}.png", piece.cut.image)
    write_textured_obj(folder, result.state.garment, result.texture)
    body = (result.state.body_vertices, result.state.body_faces)
    write_textured_glb(folder / "textured.glb", result.state.garment, result.texture, body=body)
    write_picture(folder / "preview.png", preview(result))
    rows = {
        "target": [_bytes(view.picture) for _, view in _shown(result)],
        "result": [_bytes(_drawn(result, view.camera)[0]) for _, view in _shown(result)],
    }
    write_comparison(folder / "comparison.png", rows, [f"{a}°" for a, _ in _shown(result)])
    write_report(folder / "report.json", {**report, "versions": versions()}, nonfinite_to_null=True)


def preview(result: TextureResult) -> UInt8[np.ndarray, "h w 3"]:
    """Front and back; a tile is lit, a baked texture has the pictures' own light."""
    everything = np.concatenate([result.surface.positions, result.state.body_vertices])
    center, half_extent = frame_body(everything)
    cameras = ring_cameras((0.0, 180.0), size=_PREVIEW, center=center, half_extent=half_extent)
    return np.concatenate([_bytes(_drawn(result, camera)[0]) for camera in cameras], axis=1)


def _cameras(targets: Targets) -> list[Camera]:
    if targets.rgb is None or targets.mask is None:
        raise InputError(
            "a texture needs pictures and masks", where="targets", mend="add rgb/ and mask/"
        )
    cameras = cameras_from_dict({"cameras": list(targets.cameras)})
    for stack in (targets.rgb, targets.mask, targets.normal, *targets.parts.values()):
        for azimuth, camera, picture in zip(
            targets.azimuths, cameras, () if stack is None else stack, strict=stack is not None
        ):
            if picture.shape[:2] != (camera.height, camera.width):
                raise InputError(
                    f"is {picture.shape[1]}x{picture.shape[0]}, its camera's picture "
                    f"{camera.width}x{camera.height}",
                    where=f"view {azimuth:03d}",
                    mend="give pictures of the cameras' size",
                )
    return cameras


def _named_view(targets: Targets, azimuth: int) -> int:
    if azimuth not in targets.azimuths:
        names = ", ".join(f"{a}" for a in targets.azimuths)
        raise InputError(f"there is no view {azimuth}", where="view", mend=f"views are {names}")
    return targets.azimuths.index(azimuth)


def _compared(targets: Targets, front: int) -> list[int]:
    """Evenly chosen views, the front among them, in the folder's order."""
    count = len(targets.azimuths)
    steps = np.arange(COMPARED_VIEWS) * count // COMPARED_VIEWS
    return sorted({int((front + step) % count) for step in steps})


def _view(
    targets: Targets, number: int, camera: Camera, surface: PanelSurface, body: Occluder
) -> View:
    rgb, mask = _present(targets.rgb), _present(targets.mask)
    return View(
        camera=camera,
        picture=np.asarray(rgb[number], np.float64),
        mask=np.asarray(mask[number], np.float64),
        seen=panel_map(camera, surface, body),
    )


def _tiles(
    targets: Targets, front: int, view: View, surface: PanelSurface, options: TextureOptions
) -> tuple[tuple[Piece | None, ...], tuple[Tile | None, ...]]:
    """A piece and a tile for every garment; in a baked texture they only fill holes."""
    if options.tile is not None:
        tile = read_tile(options.tile, _present(options.tile_width))
        count = len(surface.components)
        return (None,) * count, (tile,) * count
    pieces, tiles = [], []
    for number, name in enumerate(surface.components):
        part = targets.parts.get(name)
        piece = find_piece(
            view,
            surface,
            number,
            mask=None if part is None else part[front],
            normal=None if targets.normal is None else targets.normal[front],
        )
        pieces.append(piece)
        if piece is None and options.mode is Mode.TILE:
            raise InputError(
                f"view {options.view} shows no square of cloth that faces it",
                where=name,
                mend="choose another view, use --mode bake, or give a tile",
            )
        if piece is None:
            tiles.append(None)
        elif options.tile_command is not None:
            tiles.append(run_tile_command(options.tile_command, piece.cut, options.tile_width))
        else:
            cut = piece.cut
            corner = (float(cut.corner[0]), float(cut.corner[1]))
            tiles.append(seamless_tile(cut.image, cut.texel_size, corner=corner))
    return tuple(pieces), tuple(tiles)


def _baked(
    views: tuple[View, ...],
    surface: PanelSurface,
    tiles: tuple[Tile | None, ...],
    options: TextureOptions,
    progress: Progress,
) -> tuple[Texture, dict[str, Any]]:
    progress("bake", 0, 2)
    size = options.texel_size
    if size is None:
        size = min(_pixel_size(view) for view in views)
    atlas = pack_panels(surface, size)
    texels = find_texels(atlas, surface)
    baked = bake(views, texels, outer_sides(views, len(surface.panels)))
    progress("bake", 1, 2)
    own = [tiles[component] for component in surface.panel_components]
    image, shares = fill(atlas, texels, baked, len(surface.panels), own)
    progress("bake", 2, 2)
    made = {"atlas": atlas, "baked": baked, "shares": tuple(shares)}
    return atlas_texture(image, atlas, surface), made


def _pixel_size(view: View) -> float:
    """The finest pixel on the garment [m]; infinite where the view shows none of it."""
    return float(view.seen.spacing[view.seen.panel >= 0].min(initial=np.inf))


def _shown(result: TextureResult) -> list[tuple[int, View]]:
    """The views that are compared, with their names."""
    every = list(zip(result.azimuths, result.views, strict=True))
    chosen = np.unique(np.arange(COMPARED_VIEWS) * len(every) // COMPARED_VIEWS)
    return [every[k] for k in chosen]


def _drawn(
    result: TextureResult, camera: Camera, *, lit: bool | None = None
) -> tuple[np.ndarray, np.ndarray]:
    return draw_textured(
        camera,
        result.surface,
        result.texture,
        (result.state.body_vertices, result.state.body_faces),
        supersampling=_SUPERSAMPLING,
        lit=result.options.mode is Mode.TILE if lit is None else lit,
    )


def _difference(result: TextureResult, view: View) -> float | None:
    """Mean absolute difference of picture and unlit result where both show the garment."""
    drawn, coverage = _drawn(result, view.camera, lit=False)
    both = (coverage >= INSIDE) & (view.mask >= INSIDE)
    return float(np.abs(drawn - view.picture)[both].mean()) if both.any() else None


def _square_report(piece: Piece, surface: PanelSurface) -> dict[str, Any]:
    return {
        **dataclasses.asdict(piece.square),
        "smallest_cosine": piece.cosine,
        "panel": surface.panels[piece.cut.panel],
        "cut_side": piece.cut.side,
        "cut_texel_size": piece.cut.texel_size,
    }


def _tile_report(tile: Tile) -> dict[str, Any]:
    return {
        "width": tile.size[0],
        "height": tile.size[1],
        "pixels": [tile.image.shape[1], tile.image.shape[0]],
        "periods": list(tile.periods),
        "wrap_jump": list(wrap_jump(tile.image)),
    }


def _tile_source(options: TextureOptions) -> str:
    if options.tile is not None:
        return str(options.tile)
    return "cut" if options.tile_command is None else options.tile_command


def _present(value: _T | None) -> _T:
    """A value that earlier checks guarantee."""
    if value is None:
        raise ValueError("a value is missing")
    return value


def _bytes(image: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    return np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
