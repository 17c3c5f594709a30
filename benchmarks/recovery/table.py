"""The table of the recovery benchmark, its totals and its pictures."""

import json
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

HELD_OUT, CHAMFER, MEDIAN, BENDING, MINUTES = 0.98, 0.2, 0.01, 0.10, 10.0
"""Goals: IoU of views that no fit saw, Chamfer distance [cm], median error of edge lengths, error
of the bending stiffness, wall time."""


def reached(row: dict) -> dict[str, bool]:
    """Which goals a recovery reached."""
    if "error" in row:
        return dict.fromkeys(("held out", "chamfer", "edges", "bending", "time", "free"), False)
    return {
        "held out": row["held_out"][1] >= HELD_OUT,
        "chamfer": row["chamfer_cm"][1] <= CHAMFER,
        "edges": row["median_error"][1] <= MEDIAN,
        "bending": abs(row["bending_error"]) <= BENDING,
        "time": row["seconds"] <= 60.0 * MINUTES,
        "free": row["crossings"] == 0 and row["valid"],
    }


def line(row: dict) -> str:
    """One row as text: start and end of what changes."""
    if "error" in row:
        return f"{row['name']:42} {row['error']}"
    held, chamfer = row["held_out"], row["chamfer_cm"]
    known = "-" if row.get("covered") is None else f"{100.0 * row['covered']:.0f} %"
    median, largest = (100.0 * np.array(row[k]) for k in ("median_error", "largest_error"))
    return (
        f"{row['name']:42} {row['vertices']:5d} {row['iou'][0]:6.3f} {row['iou'][1]:6.4f} "
        f"{held[0]:6.3f} {held[1]:6.4f} {row['true_held_out']:6.4f} "
        f"{chamfer[0]:6.2f} {chamfer[1]:6.3f} {row['true_chamfer_cm']:6.3f} "
        f"{median[0]:6.1f} {median[1]:6.2f} {largest[0]:6.1f} {largest[1]:6.1f} "
        f"{100.0 * row['bending_error']:7.0f} {100.0 * row['stretching_error']:7.0f} {known:>5} "
        f"{row['iterations']:4d} {row['rejected']:4d} {row['remeshed']:3d} "
        f"{row['crossings']:3d} {row['seconds']:6.0f} {row['peak_mb']:6.0f}"
    )


HEAD = (
    f"{'case':42} {'verts':>5} {'IoU':>13} {'held-out IoU, true':>20} {'Chamfer [cm], true':>20} "
    f"{'median edge %':>13} {'largest edge %':>13} {'bend %':>7} {'stret %':>7} {'in':>5} "
    f"{'it':>4} {'rej':>4} {'rm':>3} {'x':>3} {'s':>6} {'MB':>6}"
)


def totals(rows: list[dict]) -> list[str]:
    """How many recoveries reached each goal, per kind of observation."""
    lines = []
    for view in sorted({row["view"] for row in rows}):
        own = [row for row in rows if row["view"] == view]
        goals = [reached(row) for row in own]
        count = {name: sum(goal[name] for goal in goals) for name in goals[0]}
        every = sum(g["held out"] and g["chamfer"] and g["edges"] for g in goals)
        parts = ", ".join(f"{name} {number}" for name, number in count.items())
        lines.append(
            f"{view}: of {len(own)}, {every} reach held-out IoU >= {HELD_OUT}, "
            f"Chamfer <= {CHAMFER} cm and median edge error <= {100 * MEDIAN:g} %; {parts}"
        )
        errors = [row["name"] for row in own if "error" in row]
        if errors:
            lines.append(f"{view}: ended with an error: {', '.join(errors)}")
    return lines


def write_table(rows: list[dict], out: Path) -> str:
    """`table.txt`, `results.json` and `pictures.png` of the rows so far."""
    text = "\n".join([HEAD, *map(line, rows), "", *totals(rows)]) + "\n"
    (out / "table.txt").write_text(text)
    (out / "results.json").write_text(json.dumps(rows, indent=1))
    tiles = []
    for row in rows:
        path = out / "fits" / row["name"] / "comparison.png"
        if path.is_file():
            tile = Image.open(path).convert("RGB")
            tile.thumbnail((640, 640))
            ImageDraw.Draw(tile).text((4, 2), row["name"], "black")
            tiles.append(tile)
    if tiles:
        height = max(tile.height for tile in tiles)
        sheet = Image.new("RGB", (3 * 640, height * ((len(tiles) + 2) // 3)), "white")
        for number, tile in enumerate(tiles):
            sheet.paste(tile, (640 * (number % 3), height * (number // 3)))
        sheet.save(out / "pictures.png")
    return text
