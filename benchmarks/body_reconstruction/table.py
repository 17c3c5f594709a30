"""The table of the reconstructions, and which goals they reach."""

import json
from pathlib import Path

import numpy as np

JOINTS, VERTICES, SCALE, SECONDS = 1.5, 1.0, 0.5, 180.0
"""Goals: mean errors of joints and vertices [cm], of the scale [%], wall time; the first three may
be twice as large where landmarks are noisy."""

HEAD = (
    f"{'case':16} {'body':>4} {'hidden':>6} {'joints [cm]':>20} {'fingers':>7} "
    f"{'vertices [cm]':>20} {'largest':>7} {'scale %':>7} {'stature %':>9} {'px':>5} "
    f"{'steps':>9} {'s':>6} {'compile':>7}"
)
STAGES = ("coarse", "landmarks", "fine")


def line(row: dict) -> str:
    """One body: joints and vertices after each stage, the rest at the end."""
    stages, end = row["stages"], row["stages"]["fine"]
    joints = "".join(f"{stages[name]['joints_cm']:7.2f}" for name in STAGES)
    vertices = "".join(f"{stages[name]['vertices_cm']:7.2f}" for name in STAGES)
    steps = "/".join(str(row["iterations"][name]) for name in STAGES)
    return (
        f"{row['case']:16} {row['seed']:4d} {row['hidden']:6.2f} {joints:>20} "
        f"{end['fingers_cm']:7.2f} {vertices:>20} {end['largest_cm']:7.2f} "
        f"{end['scale_percent']:+7.2f} {end['stature_percent']:+9.2f} "
        f"{row['landmark_error_px']:5.2f} {steps:>9} {row['seconds']['total']:6.1f} "
        f"{row['seconds']['compile']:7.1f}"
    )


def totals(rows: list[dict]) -> list[str]:
    """Per case: the largest errors, and how many bodies reach each goal."""
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        slack = 2.0 if case.startswith("noisy") else 1.0
        end = [row["stages"]["fine"] for row in own]
        errors = {
            f"joints <= {slack * JOINTS:g} cm": ([e["joints_cm"] for e in end], slack * JOINTS),
            f"vertices <= {slack * VERTICES:g} cm": (
                [e["vertices_cm"] for e in end],
                slack * VERTICES,
            ),
            f"scale <= {slack * SCALE:g} %": (
                [abs(e["scale_percent"]) for e in end],
                slack * SCALE,
            ),
            f"stature <= {slack * SCALE:g} %": (
                [abs(e["stature_percent"]) for e in end],
                slack * SCALE,
            ),
            f"time <= {SECONDS:g} s": ([row["seconds"]["total"] for row in own], SECONDS),
        }
        parts = [
            f"{name}: {int(np.sum(np.array(values) <= goal))} (mean {np.mean(values):.3f}, "
            f"largest {np.max(values):.3f})"
            for name, (values, goal) in errors.items()
        ]
        lines += [f"{case}, {len(own)} bodies:", *(f"  {part}" for part in parts)]
        methods = [row["methods"] for row in own if "methods" in row]
        for stage in ("coarse", "landmarks") if methods else ():
            runs = [method[stage] for method in methods]
            mean = {key: np.mean([run[key] for run in runs]) for key in runs[0]}
            close = sum(run["adam_loss"] <= 1.01 * run["loss"] for run in runs)
            lines.append(
                f"  {stage}: Levenberg-Marquardt {mean['marquardt_steps']:.0f} steps "
                f"{mean['marquardt_seconds']:.3f} s; Adam {mean['adam_steps']:.0f} steps "
                f"{mean['adam_seconds']:.3f} s, {close} of {len(runs)} within 1 % of its loss"
            )
    return lines


def write_table(rows: list[dict], out: Path) -> str:
    """`table.txt` and `results.json` of the rows so far."""
    text = "\n".join([HEAD, *map(line, rows), "", *totals(rows)]) + "\n"
    (out / "table.txt").write_text(text)
    (out / "results.json").write_text(json.dumps(rows, indent=1))
    return text
