"""What the embedded defaults find in plain photographs, against what is known of them.

    python -m benchmarks.photo --data DATA --out OUT

DATA holds `photos/*.png` (people cut out, with alpha), `labels/demo.jpg` with `demo_atr.png`, and
`sewfactory/*` (a scene with cameras, views and the garment). Cut-out people are laid on four made
backgrounds; their alpha is the true matte. SewFactory's garment, drawn with its cameras, is the
true area of the clothes; it draws no body, so that arms in front of it count as clothes. No scene
has true landmarks: each landmark is triangulated from all views of the ring, and its error is how
far the views disagree with that point, which hides an error that all views share. Writes
`photo.json` and `sheet.png`.
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from dress_jax.application.bundle_targets import draw_masks
from dress_jax.capture import CLOTHES, Bundle, ClothesLabel, Landmarks
from dress_jax.capture.labels import LABEL_COLORS, convert_labels
from dress_jax.capture.landmarks import BODY_NAMES, USUAL_THRESHOLD
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.io.capture.pictures import read_ids
from dress_jax.io.capture.preview import contact_sheet
from dress_jax.io.capture.sewfactory import read_sewfactory
from dress_jax.io.networks import load_landmark_network, load_matting_network
from dress_jax.render.cameras import Camera, project
from dress_jax.vision.body_landmarks import find_landmarks
from dress_jax.vision.clothes import parse_clothes
from dress_jax.vision.matting import find_matte

BACKGROUNDS = ("white", "grey", "room", "busy")
POSES = ("static", "0000")
_ROUNDS, _HUBER = 10, 5.0
_ROW = 230


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A picture and what is known of it.

    Args:
        name: for the table.
        image: RGB, shape (h, w, 3).
        person: true mask, shape (h, w).
        clothes: true area of the clothes, where known, shape (h, w).
        labels: true labels, where known, shape (h, w).
        camera: of a ring, where there is one.
    """

    name: str
    image: np.ndarray
    person: np.ndarray
    clothes: np.ndarray | None = None
    labels: np.ndarray | None = None
    camera: Camera | None = None


def iou(first: np.ndarray, second: np.ndarray) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = int((first | second).sum())
    return float((first & second).sum()) / union if union else 1.0


def background(kind: str, height: int, width: int) -> np.ndarray:
    """A made background, the same in every run, shape (h, w, 3)."""
    generator = np.random.default_rng(0)
    rows, columns = np.mgrid[:height, :width] / max(height, width)
    if kind in ("white", "grey"):
        return np.full((height, width, 3), 255.0 if kind == "white" else 150.0)

    def blotches(size: float, strength: float) -> np.ndarray:
        noise = generator.normal(size=(height, width, 3))
        noise = ndimage.gaussian_filter(noise, (size * height, size * height, 0))
        return strength * noise / noise.std()

    if kind == "busy":
        return 128.0 + blotches(0.05, 45.0) + blotches(0.025, 12.0)
    wall = np.stack(
        [120 + 60 * rows + 20 * np.sin(9 * columns), 110 + 50 * rows, 100 + 40 * columns], axis=-1
    )
    wall[rows > 0.8 * rows.max()] *= 0.7
    return wall + blotches(0.025, 10.0)


def photographs(folder: Path) -> Iterator[Case]:
    """Cut-out people on every background."""
    for path in sorted(folder.glob("*.png")):
        rgba = np.array(Image.open(path).convert("RGBA")).astype(np.float64)
        alpha = rgba[..., 3:] / 255.0
        name = path.stem.replace("pexels-", "").rsplit("-", 1)[0]
        for kind in BACKGROUNDS:
            pixels = rgba[..., :3] * alpha + background(kind, *alpha.shape[:2]) * (1.0 - alpha)
            image = np.round(np.clip(pixels, 0.0, 255.0)).astype(np.uint8)
            yield Case(f"{name}, {kind}", image, alpha[..., 0] > 0.5)


def labelled(folder: Path) -> Iterator[Case]:
    """The photograph with a label map: half a person."""
    labels = convert_labels(read_ids(folder / "demo_atr.png"), "atr")
    image = np.array(Image.open(folder / "demo.jpg").convert("RGB"))
    person = labels != ClothesLabel.BACKGROUND
    yield Case("demo (half a person)", image, person, np.isin(labels, CLOTHES), labels)


def rings(folder: Path) -> Iterator[list[Case]]:
    """All views of each pose of each scene."""
    for scene in sorted(path for path in folder.iterdir() if path.is_dir()):
        for pose in POSES:
            bundle = draw_masks(read_sewfactory(scene, pose=pose))
            yield [_view_case(view, pose) for view in bundle.views]


def _view_case(view: View, pose: str) -> Case:
    if view.rgb is None or view.matte is None or view.mask is None:
        raise InputError("lacks pictures", where=f"view '{view.name}'")
    name = f"SewFactory {pose}, {view.name}"
    return Case(name, view.rgb, view.matte >= 128, view.mask >= 128, camera=view.camera)


def observe(case: Case) -> tuple[dict[str, Any], Bundle, Landmarks | None]:
    """Everything that is measured on one picture."""
    row: dict[str, Any] = {"case": case.name}
    parts: dict[str, Any] = {"image": case.image}
    landmarks = None
    start = time.perf_counter()
    try:
        matte = parts["matte"] = find_matte(case.image, load_matting_network())
        row["matte_iou"] = iou(matte >= 128, case.person)
        person = find_landmarks(case.image, matte, load_landmark_network())
        landmarks = parts["landmarks"] = person.landmarks
        row["presence"] = person.presence
        labels, report = parse_clothes(case.image, matte, landmarks)
        parts["labels"] = labels
        row["waist_contrast"], row["one_piece"] = report.waist_contrast, report.one_piece
        row["shares"] = {kind.name.lower(): share for kind, share in report.shares.items()}
        row["cut_off"] = report.cut_off
        if case.clothes is not None:
            row["clothes_iou"] = iou(np.isin(labels, CLOTHES), case.clothes)
        if case.labels is not None:
            row["label_iou"] = {
                kind.name.lower(): iou(labels == kind, case.labels == kind)
                for kind in ClothesLabel
                if (case.labels == kind).any()
            }
    except InputError as error:
        row["fault"] = str(error)
    row["seconds"] = time.perf_counter() - start
    return row, Bundle(**parts), landmarks


def disagreement(
    cameras: list[Camera], found: list[Landmarks], heights: list[int]
) -> dict[str, list[float]]:
    """Distances of the seen landmarks from their triangulated points, in shares of image height."""
    errors: dict[str, list[float]] = {}
    for index, name in enumerate(BODY_NAMES):
        seen = [k for k, f in enumerate(found) if f.confidence[index] >= USUAL_THRESHOLD]
        if len(seen) < 3:
            continue
        pixels = np.array([found[k].points[index] for k in seen])
        rows = np.concatenate([_lines(cameras[k], pixels[i]) for i, k in enumerate(seen)])
        weight = np.ones(len(seen))
        gaps = np.zeros(len(seen))
        for _ in range(_ROUNDS):
            scaled = rows * np.repeat(weight, 2)[:, None]
            point = np.linalg.lstsq(scaled[:, :3], scaled[:, 3], rcond=None)[0]
            shown = [project(cameras[k], jnp.asarray(point[None])) for k in seen]
            gaps = np.array(
                [
                    np.hypot(float(x[0]) - pixel[0], float(y[0]) - pixel[1])
                    for (x, y, _), pixel in zip(shown, pixels, strict=True)
                ]
            )
            weight = np.minimum(1.0, _HUBER / np.maximum(gaps, 1e-9))
        errors[name] = [float(gap / heights[k]) for gap, k in zip(gaps, seen, strict=True)]
    return errors


def _lines(camera: Camera, pixel: np.ndarray) -> np.ndarray:
    """Two equations a . p = b of the points that a perspective camera shows at a pixel."""
    right, up, toward = np.asarray(camera.rotation, np.float64)
    across, down = pixel - np.asarray(camera.principal, np.float64)
    scale = np.asarray(camera.scale, np.float64)
    rows = np.stack([scale[0] * right + across * toward, scale[1] * up - down * toward])
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    return np.column_stack([rows, rows @ np.asarray(camera.position, np.float64)])


def sheet(entries: list[tuple[dict[str, Any], Bundle]]) -> Image.Image:
    """One row per picture: image, labels, matte, landmarks, and the numbers."""
    rows = []
    for row, bundle in entries:
        pixels = contact_sheet(bundle)
        strip = Image.new("RGB", (4 * 192 + 190, _ROW), "white")
        strip.paste(Image.fromarray(pixels), (0, 0))
        text = [row["case"]] + [
            f"{key} {row[key]:.3f}" for key in ("matte_iou", "clothes_iou") if key in row
        ]
        if "waist_contrast" in row:
            text.append(f"waist {row['waist_contrast']:.1f}")
        text += ["CUT OFF"] * bool(row.get("cut_off")) + [row.get("fault", "")[:40]]
        ImageDraw.Draw(strip).multiline_text((4 * 192 + 4, 20), "\n".join(text), fill="black")
        rows.append(strip)
    across = 2
    width, height = rows[0].size
    made = Image.new("RGB", (across * width, -(-len(rows) // across) * height), "white")
    for k, strip in enumerate(rows):
        made.paste(strip, ((k % across) * width, (k // across) * height))
    draw = ImageDraw.Draw(made)
    for kind in ClothesLabel:
        place = (4 * 192 + 4, 120 + 12 * kind)
        draw.text(place, kind.name.lower(), fill=tuple(int(c) for c in LABEL_COLORS[kind] * 0.8))
    return made


def summary(rows: list[dict[str, Any]], errors: dict[str, list[float]]) -> dict[str, Any]:
    """Means and extremes over groups of pictures."""
    groups = {
        "photographs": [r for r in rows if not r["case"].startswith(("Sew", "demo"))],
        "SewFactory": [r for r in rows if r["case"].startswith("Sew")],
        "demo": [r for r in rows if r["case"].startswith("demo")],
    }
    result: dict[str, Any] = {}
    for group, members in groups.items():
        for key in ("matte_iou", "clothes_iou"):
            values = [r[key] for r in members if key in r]
            if values:
                result[f"{group}, {key}"] = {
                    "mean": float(np.mean(values)),
                    "least": float(np.min(values)),
                    "pictures": len(values),
                }
    gaps = np.array([gap for values in errors.values() for gap in values])
    if len(gaps):
        result["landmarks, share of image height"] = {
            "median": float(np.median(gaps)),
            "mean": float(gaps.mean()),
            "90 %": float(np.quantile(gaps, 0.9)),
            "largest": float(gaps.max()),
            "points": len(gaps),
        }
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the embedded defaults for photographs.")
    parser.add_argument("--data", type=Path, required=True, help="photos/ labels/ sewfactory/")
    parser.add_argument("--out", type=Path, required=True, help="folder for photo.json, sheet.png")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows: list[dict[str, Any]] = []
    shown: list[tuple[dict[str, Any], Bundle]] = []
    for case in [
        *photographs(arguments.data / "photos"),
        *labelled(arguments.data / "labels"),
    ]:
        row, bundle, _ = observe(case)
        rows.append(row)
        shown.append((row, bundle))
        _print(row)
    errors: dict[str, list[float]] = {}
    for ring in rings(arguments.data / "sewfactory"):
        found, cameras, heights = [], [], []
        for k, case in enumerate(ring):
            row, bundle, landmarks = observe(case)
            rows.append(row)
            _print(row)
            if k % 3 == 0:
                shown.append((row, bundle))
            if landmarks is not None and case.camera is not None:
                found.append(landmarks)
                cameras.append(case.camera)
                heights.append(case.image.shape[0])
        for name, values in disagreement(cameras, found, heights).items():
            errors.setdefault(name, []).extend(values)
    totals = summary(rows, errors)
    for name, values in totals.items():
        print(name, {key: round(value, 4) for key, value in values.items()})
    worst = {name: float(np.median(values)) for name, values in errors.items()}
    print("median by landmark", {name: round(value, 4) for name, value in worst.items()})
    arguments.out.mkdir(parents=True, exist_ok=True)
    document = {"pictures": rows, "summary": totals, "landmarks": errors}
    (arguments.out / "photo.json").write_text(json.dumps(document, indent=1))
    sheet(shown).save(arguments.out / "sheet.png")


def _print(row: dict[str, Any]) -> None:
    numbers = [f"{key} {row[key]:.4f}" for key in ("matte_iou", "clothes_iou") if key in row]
    numbers += [f"{key} {value:.3f}" for key, value in row.get("label_iou", {}).items()]
    if "waist_contrast" in row:
        kind = "one piece" if row["one_piece"] else "two"
        numbers.append(f"waist {row['waist_contrast']:.1f} ({kind})")
    if "fault" in row:
        numbers.append(row["fault"])
    print(f"{row['case']:32s} {', '.join(numbers)}  {row['seconds']:.1f} s", flush=True)


if __name__ == "__main__":
    main()
