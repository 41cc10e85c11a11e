"""Charts of a page: crowds beside real ones, trainings over epochs, and how speed scales with size."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

REAL = "real"

FIRST = ("val/ade", "val/fde", "val/unlike", "rollout/success", "rollout/clean", "rollout/stl")
"""Metrics that are shown before all others."""

PANELS = 12
"""Metrics of trainings that are drawn."""

_SIZE = re.compile(r"(\d+) x (\d+)")


def curves_of(report: Mapping[str, Any], said: str = "") -> list[dict[str, Any]]:
    """Return the groups of charts of a report; ``said`` stands behind their titles."""
    return _distributions(report["rows"], said) + _scaling(report["rows"], said)


def training_curves(runs: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the charts of trainings, a panel for each metric of validation, a line for each run."""
    panels: dict[str, list[dict[str, Any]]] = {}
    for run in runs:
        name = f"{run.parent.name}/{run.name}"
        for metric, (epochs, values) in _logged(run / "metrics.csv").items():
            panels.setdefault(metric, []).append({"name": name, "x": epochs, "y": values})
    shown = sorted(panels, key=lambda metric: (metric not in FIRST, -len(panels[metric]), metric))[:PANELS]
    charts = [
        {"title": metric, "x": "epoch", "y": "", "lines": panels[metric], "zero": False} for metric in shown
    ]
    note = "A point for every epoch with a validation; losses of training are means over the epoch."
    return [{"title": "Training", "note": note, "panels": charts}] if charts else []


def _logged(file: Path) -> dict[str, tuple[list[int], list[float]]]:
    """Return epochs and means of every metric that is worth a panel."""
    values: dict[str, dict[int, list[float]]] = {}
    with file.open(newline="") as lines:
        for row in csv.DictReader(lines):
            for key, text in row.items():
                if text and row.get("epoch") and re.match(r"(val|rollout)/|train/.*loss|train/g", key or ""):
                    values.setdefault(key, {}).setdefault(int(float(row["epoch"])), []).append(float(text))
    return {
        key: (sorted(its), [sum(its[epoch]) / len(its[epoch]) for epoch in sorted(its)])
        for key, its in values.items()
    }


def _distributions(rows: Sequence[Mapping[str, Any]], said: str) -> list[dict[str, Any]]:
    """Return the charts of crowds beside the recorded one, a group for each case."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row.get("distributions") or row.get("density_speed"):
            case = row.get("case", {})
            groups.setdefault(f"{case.get('fold', '')} {case.get('simulated', '')}".strip(), []).append(row)
    note = (
        "Shares of all steps of 0.4 s. The thick line is the recorded crowd; ends count what is beyond them."
    )
    return [
        {"title": f"Beside real people: {name}{said}", "note": note, "panels": _beside_real(its)}
        for name, its in groups.items()
    ]


def _beside_real(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    rows = [row for row in rows if row["name"] != REAL] or list(rows)
    panels = []
    for feature, first in rows[0].get("distributions", {}).items():
        bins = len(first["real_share"])
        wide = (first["high"] - first["low"]) / bins
        x = [round(first["low"] + (i + 0.5) * wide, 4) for i in range(bins)]
        lines = [{"name": REAL, "x": x, "y": first["real_share"]}]
        lines += [
            {"name": str(row["name"]), "x": x, "y": row["distributions"][feature]["share"]}
            for row in rows
            if feature in row.get("distributions", {})
        ]
        unit = first["unit"].replace("_per_", "/")
        panels.append({"title": feature.replace("_", " "), "x": unit, "y": "share", "lines": lines})
    if curve := rows[0].get("density_speed"):
        lines = [_line(REAL, curve, "real_speed_m_per_s")]
        lines += [_line(str(row["name"]), row["density_speed"], "speed_m_per_s") for row in rows]
        where = "people per m² within 2 m"
        panels.append({"title": "density and speed", "x": where, "y": "mean, m/s", "lines": lines})
    return panels


def _line(name: str, curve: Sequence[Mapping[str, Any]], key: str) -> dict[str, Any]:
    often = [one for one in curve if one["real_share"] >= 0.005]  # means of a few people say nothing
    return {"name": name, "x": [one["density_per_m2"] for one in often], "y": [one[key] for one in often]}


def _scaling(rows: Sequence[Mapping[str, Any]], said: str) -> list[dict[str, Any]]:
    """Return how many steps of people are done per second, by the number of people, of ``pedzoo bench``."""
    lines: dict[str, dict[str, dict[int, float]]] = {}
    for row in rows:
        size = _SIZE.fullmatch(str(row.get("case", {}).get("size", "")))
        value = row["metrics"].get("agent_steps_per_s")
        if size and value:
            places = lines.setdefault(str(row["case"].get("map", "")), {})
            places.setdefault(str(row["name"]), {})[int(size[1]) * int(size[2])] = value
    panels = [
        {
            "title": place,
            "x": "people in all scenes (powers of ten)",
            "y": "steps of people per second",
            "log": True,
            "lines": [
                {"name": name, "x": sorted(points), "y": [points[size] for size in sorted(points)]}
                for name, points in its.items()
                if len(points) > 1
            ],
        }
        for place, its in lines.items()
    ]
    panels = [panel for panel in panels if panel["lines"]]
    for panel in panels:
        panel["title"] = panel["title"] or "the usual floor plans"
    note = "Both axes are logarithmic."
    return [{"title": f"Speed by size{said}", "note": note, "panels": panels}] if panels else []
