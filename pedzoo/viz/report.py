"""What a page of results shows, from the files that commands write."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError
from pedzoo.eval.results import INTERVALS, SEEN, case_label, legend
from pedzoo.viz.page import LARGEST

Row = Mapping[str, Any]

REAL = "real"

REFERENCES = (REAL, "real halves")
"""Rows that no policy is better than."""

_NOTE = INTERVALS.replace("In brackets", "Below numbers") + " A number that is a link leads to an episode."

_ROOM = 400_000  # bytes of a page beside its episodes and floor plans

HIGHER = re.compile(
    r"success|clean|contact_free|s[pt]l|goals_p.*|personal_space.*|(all_)?through|specific_flow.*|.*steps_per_s"
    r"|episode_success|person_yields"
)
LOWER = re.compile(
    r"(?!contact_free).*contact.*|collision.*|deadlock|failed|timeout|time_ratio.*|path_ratio|time_s|delay.*"
    r"|detour.*|intrusion_ratio|discomfort|realism|w1_.*|(.*_)?[af]de(_.*)?|dtw_m|.*rmse.*|next_step.*|nll.*"
    r"|intervention_.*|outcome_(blocked|lost|through)|step_s|.*_ms"
)

FIRST = (
    *("success", "episode_success", "realism", "clean", "collision_person", "collision_wall", "timeout"),
    *("agent_contacts_per_min", "wall_contacts_per_min", "time_ratio", "time_ratio_median", "deadlock"),
    *("path_ratio", "stl", "time_s", "delay_s", "intrusion_ratio", "least_distance_m", "closed_loop_ade_m"),
    *("density_speed_rmse_m_per_s", "agent_contact_excess", "ade_m", "fde_m", "min_ade_20_scene_m"),
)
"""Columns that are shown at once, in this order; the others with a click."""

AT_ONCE = 8
"""Columns at most: so many fit a page of usual width."""

FIRST_CURVES = ("val/ade", "val/fde", "val/unlike", "rollout/success", "rollout/clean", "rollout/stl")
"""Metrics that are shown before all others."""

PANELS = 12
"""Metrics of trainings that are drawn."""

RARE = 0.005
"""Densities that a smaller share of the real steps has are not drawn: their means are of a few people."""

_CASE_SIZE = re.compile(r"(\d+) x (\d+)")


def content_of(files: Sequence[str | Path]) -> dict[str, Any]:
    """Return the content of the page of some results.

    Args:
        files: JSON of ``pedzoo evaluate``, ``rollout``, ``forecast``, ``score``, ``reproduce`` or ``bench``,
            and folders of trainings.

    Raises:
        UserError: A file is not there, or is something else.
    """
    reports, runs, content = {}, [], empty_content()
    for path in map(Path, files):
        if path.is_dir():
            runs += _trainings(path)
        else:
            reports[str(path)] = _read(path)
    for path, report in reports.items():
        add_report(content, report, Path(path).stem if len(reports) > 1 else "")
    content["charts"] += training_curves(runs)
    content["about"] = _about(list(reports.values()), runs)
    shorten(content)
    return content


def empty_content() -> dict[str, Any]:
    """Return the content of a page without anything."""
    return {"cases": [], "plans": {}, "tables": [], "charts": [], "notes": []}


def shorten(content: dict[str, Any], largest: int = LARGEST - _ROOM) -> None:
    """Leave out the last episodes of all policies until a page is small enough, and plans without use."""
    policies = [policy for case in content["cases"] for policy in case["policies"]]
    sizes = [[len(json.dumps(one)) for one in policy["episodes"]] for policy in policies]
    taken = sum(len(json.dumps(plan)) for plan in content["plans"].values())
    longest = most = max(map(len, sizes), default=0)
    while most and taken + sum(sum(size[:most]) for size in sizes) > largest:
        most -= 1
    if most < longest:
        content["notes"].append(
            f"Only the first {most} of {longest} episodes are here: the page would be too large with more."
        )
    used = set()
    for policy in policies:
        policy["episodes"] = policy["episodes"][:most]
        used |= {one["plan"] for one in policy["episodes"]}
    content["cases"] = content["cases"] if most else []
    content["plans"] = {name: plan for name, plan in content["plans"].items() if name in used}


def _read(path: Path) -> dict[str, Any]:
    kinds = "evaluate, rollout, forecast, score or bench"
    wanted = f"expected JSON that pedzoo {kinds} wrote, or the folder of a training"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"cannot read {str(path)!r}: {error.strerror}; {wanted}") from error
    except ValueError as error:
        raise UserError(f"{str(path)!r} is no JSON: {wanted}") from error
    rows = report.get("rows") if isinstance(report, dict) else None
    are_rows = isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
    if not are_rows or not all({"name", "metrics"} <= row.keys() for row in rows or ()):
        raise UserError(f"{str(path)!r} has no rows with name and metrics: {wanted}")
    return report


def _trainings(folder: Path) -> list[Path]:
    runs = [folder] if (folder / "metrics.csv").is_file() else []
    runs = runs or sorted(file.parent for file in folder.glob("*/*/metrics.csv"))
    if not runs:
        raise UserError(
            f"no training in {str(folder)!r}: expected a folder that pedzoo fit wrote, with metrics.csv"
        )
    return runs


def add_report(content: dict[str, Any], report: Mapping[str, Any], stem: str = "") -> None:
    """Add the tables, episodes and curves of one file, with its ``stem`` in their titles."""
    suffix = f" ({stem})" if stem else ""
    content["plans"] |= report.get("plans", {})
    for name, rows in _grouped(report["rows"], lambda row: _table(row, report)).items():
        cases = _grouped(rows, _label)
        means = [row for row in report.get("summary", []) if row.get("table") == name]
        tables = []
        if len(cases) > 1 and means:
            tables.append(_table_of(f"mean of {len(cases)} cases", means, None))
        for label, of_case in cases.items():
            number = _add_case(content, f"{name} {label}".strip() + suffix, of_case)
            tables.append(_table_of(label or name, of_case, number))
        note = "" if content["tables"] else _NOTE
        content["tables"].append({"name": name + suffix, "note": note, "tables": tables})
    content["notes"] += [str(note) for note in report.get("notes", [])]
    content["charts"] += _distributions(report["rows"], suffix) + _scaling(report["rows"], suffix)


def _grouped(rows: Sequence[Row], key: Callable[[Row], str]) -> dict[str, list[Row]]:
    """Return rows by their key, in the order in which keys are first seen."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def _add_case(content: dict[str, Any], name: str, rows: Sequence[Row]) -> int | None:
    """Add the episodes of a case; returns its number, None where no row keeps any."""
    kept = [row for row in rows if row.get("episodes")]
    if not kept:
        return None
    name = " ".join(dict.fromkeys(name.split()))  # a table's name is often part of its cases
    known = {case["name"] for case in content["cases"]}
    if name in known:
        name = next(other for i in count(2) if (other := f"{name} {i}") not in known)
    policies = [{"name": str(row["name"]), "episodes": row["episodes"]} for row in kept]
    content["cases"].append({"name": name, "policies": policies})
    return len(content["cases"]) - 1


def _table(row: Row, report: Mapping[str, Any]) -> str:
    protocol = report.get("protocol", {})
    usual = protocol.get("scenario") if isinstance(protocol, dict) else None
    return str(row.get("table") or row.get("section") or usual or report.get("command", "results"))


def _label(row: Row) -> str:
    case = {key: str(value) for key, value in row.get("case", {}).items()}
    return case_label({"case": case}) if case else ""


def _table_of(title: str, rows: Sequence[Row], case: int | None) -> dict[str, Any]:
    """Return a table; ``case`` is the number of the case whose episodes it leads to, None for a mean."""
    texts = legend()
    metrics = list(dict.fromkeys(key for row in rows for key in row["metrics"]))
    columns = [
        {"key": key, "help": texts.get(key, ""), "better": better(key), "first": first}
        for key, first in ordered(metrics)
    ]
    return {"title": title, "case": case, "columns": columns, "rows": list(map(_row, rows))}


def _row(row: Row) -> dict[str, Any]:
    intervals, number = row.get("ci95", {}), row.get("n", "")
    numbers = {key: value for key, value in row["metrics"].items() if isinstance(value, int | float)}
    return {
        "name": str(row["name"]),
        "n": number if isinstance(number, int | str) else "",
        "cells": {key: [value, *intervals.get(key, (None, None))] for key, value in numbers.items()},
        "seen": SEEN in row.get("case", {}),
        "reference": row["name"] in REFERENCES,
    }


def _about(reports: Sequence[Row], runs: Sequence[Path]) -> str:
    lines = []
    for report in reports:
        versions, seeds = report.get("versions", {}), report.get("seeds", [])
        made = [f"pedzoo {report.get('command', '')}".strip(), f"version {versions.get('pedzoo', 'unknown')}"]
        made += [f"commit {versions['commit']}"] if "commit" in versions else []
        made += [f"seeds {' '.join(map(str, seeds))}"] if isinstance(seeds, list) and seeds else []
        lines.append(", ".join(made))
    lines += [f"{len(runs)} trainings"] if runs else []
    return "; ".join(dict.fromkeys(lines))


def better(metric: str) -> int:
    """Return 1 where more of a metric is better, -1 where less is, 0 where neither is."""
    if HIGHER.fullmatch(metric):
        return 1
    return -1 if LOWER.fullmatch(metric) else 0


def ordered(metrics: list[str]) -> list[tuple[str, bool]]:
    """Return metrics with whether they are shown at once: all of them where none is known."""
    first = [name for name in FIRST if name in metrics][:AT_ONCE]
    return [(name, True) for name in first] + [(name, not first) for name in metrics if name not in first]


def training_curves(runs: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the charts of trainings, a panel for each metric of validation, a line for each run."""
    panels: dict[str, list[dict[str, Any]]] = {}
    for run in runs:
        name = f"{run.parent.name}/{run.name}"
        for metric, (epochs, values) in _logged(run / "metrics.csv").items():
            panels.setdefault(metric, []).append({"name": name, "x": epochs, "y": values})
    order = sorted(panels, key=lambda metric: (metric not in FIRST_CURVES, -len(panels[metric]), metric))
    common = {"x": "epoch", "y": "", "zero": False}
    charts = [{"title": metric, "lines": panels[metric], **common} for metric in order[:PANELS]]
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
        key: (sorted(epochs), [sum(epochs[epoch]) / len(epochs[epoch]) for epoch in sorted(epochs)])
        for key, epochs in values.items()
    }


def _distributions(rows: Sequence[Row], suffix: str) -> list[dict[str, Any]]:
    """Return the charts of crowds beside the recorded one, a group for each case."""

    def crowd(row: Row) -> str:
        case = row.get("case", {})
        return f"{case.get('fold', '')} {case.get('simulated', '')}".strip()

    drawn = [row for row in rows if row.get("distributions") or row.get("density_speed")]
    note = (
        "Shares of all steps of 0.4 s. The thick line is the recorded crowd; ends count what is beyond them."
    )
    return [
        {"title": f"Beside real people: {name}{suffix}", "note": note, "panels": _beside_real(of_case)}
        for name, of_case in _grouped(drawn, crowd).items()
    ]


def _beside_real(rows: Sequence[Row]) -> list[dict[str, Any]]:
    rows = [row for row in rows if row["name"] != REAL] or list(rows)
    panels = []
    for feature, first in rows[0].get("distributions", {}).items():
        bins = len(first["real_share"])
        wide = (first["high"] - first["low"]) / bins
        x = [round(first["low"] + (i + 0.5) * wide, 4) for i in range(bins)]
        shares = [(REAL, first["real_share"])]
        shares += [
            (str(row["name"]), row["distributions"][feature]["share"])
            for row in rows
            if feature in row.get("distributions", {})
        ]
        lines = [{"name": name, "x": x, "y": share} for name, share in shares]
        unit = first["unit"].replace("_per_", "/")
        panels.append({"title": feature.replace("_", " "), "x": unit, "y": "share", "lines": lines})
    if curve := rows[0].get("density_speed"):
        curves = [(REAL, "real_speed_m_per_s", curve)]
        curves += [(str(row["name"]), "speed_m_per_s", row["density_speed"]) for row in rows]
        lines = []
        for name, key, points in curves:
            often = [one for one in points if one["real_share"] >= RARE]
            places = [one["density_per_m2"] for one in often]
            lines.append({"name": name, "x": places, "y": [one[key] for one in often]})
        where = "people per m² within 2 m"
        panels.append({"title": "density and speed", "x": where, "y": "mean, m/s", "lines": lines})
    return panels


def _scaling(rows: Sequence[Row], suffix: str) -> list[dict[str, Any]]:
    """Return how many steps of people are done per second, by the number of people, of ``pedzoo bench``."""
    places: dict[str, dict[str, dict[int, float]]] = {}
    for row in rows:
        size = _CASE_SIZE.fullmatch(str(row.get("case", {}).get("size", "")))
        if size and (value := row["metrics"].get("agent_steps_per_s")):
            lines = places.setdefault(str(row["case"].get("map", "")), {})
            lines.setdefault(str(row["name"]), {})[int(size[1]) * int(size[2])] = value
    panels = []
    for place, by_name in places.items():
        several = {name: sorted(points.items()) for name, points in by_name.items() if len(points) > 1}
        lines = [
            {"name": name, "x": [size for size, _ in points], "y": [value for _, value in points]}
            for name, points in several.items()
        ]
        common = {"x": "people in all scenes (powers of ten)", "y": "steps of people per second", "log": True}
        if lines:
            panels.append({"title": place or "the usual floor plans", "lines": lines, **common})
    note = "Both axes are logarithmic."
    return [{"title": f"Speed by size{suffix}", "note": note, "panels": panels}] if panels else []
