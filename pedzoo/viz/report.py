"""A page of results from the files that commands write: one HTML file, and no address of anything else."""

from __future__ import annotations

import base64
import csv
import hashlib
import html
import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import resources
from itertools import count
from pathlib import Path
from string import Template
from typing import Any

from pedzoo.core.errors import UserError
from pedzoo.eval.results import INTERVALS, SEEN, case_label, legend

Row = Mapping[str, Any]

REAL = "real"

REFERENCES = (REAL, "real halves")
"""Rows that no policy is better than."""

SCRIPTS = ("dom", "decode", "scene", "charts", "inspect", "table", "player", "main")
"""Files of the page's script, in this order."""

LARGEST, ROOM = 3_000_000, 400_000
"""Bytes of a page, which opens at once and fits an e-mail; of these, beside episodes and floor plans."""

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


def page(content: Mapping[str, Any], title: str = "pedzoo report", live: str | None = None) -> str:
    """Return the page of a content as of `content_of`.

    Names in it may come from any file. They stand in JSON without ``<``, the script writes them as text, and
    the page's policy runs no script but its own. ``live`` is where its server tells of people who walk now.
    """
    style, body = _asset("page.css"), "".join(_asset(f"{name}.js") for name in SCRIPTS)
    script = f"'use strict';\n(() => {{\n{body}}})();\n"
    sources = f"style-src {_hash(style)}; script-src {_hash(script)}; img-src data:"
    sources += "; connect-src 'self'" if live else ""
    policy = f"default-src 'none'; {sources}; base-uri 'none'; form-action 'none'"
    # JSON that no HTML parser takes for anything else
    data = json.dumps({**content, "live": live}, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        data = data.replace(sign, f"\\u{ord(sign):04x}")
    title, policy = html.escape(title), html.escape(policy, quote=True)
    parts = {"title": title, "policy": policy, "style": style, "script": script, "data": data}
    return Template(_asset("page.html")).substitute(parts)


def framed(content: Mapping[str, Any], title: str, height: int = 640) -> str:
    """Return the page as a frame for notebooks, ``height`` pixels high; its script sees nothing outside."""
    inside = html.escape(page(content, title), quote=True)
    return (
        f'<iframe srcdoc="{inside}" sandbox="allow-scripts" title="{html.escape(title, quote=True)}" '
        f'style="width:100%;height:{int(height)}px;border:0"></iframe>'
    )


def _asset(name: str) -> str:
    return (resources.files("pedzoo.viz") / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def empty_content() -> dict[str, Any]:
    """Return the content of a page without anything."""
    return {"cases": [], "plans": {}, "tables": [], "charts": [], "notes": []}


def content_of(files: Sequence[str | Path]) -> dict[str, Any]:
    """Return the content of the page of some results: JSON that commands wrote, and folders of trainings.

    Raises:
        UserError: A file is not there, or is something else.
    """
    content, about, paths = empty_content(), [], [*map(Path, files)]
    runs = [run for path in paths if path.is_dir() for run in _trainings(path)]
    reports = {str(path): _read(path) for path in paths if not path.is_dir()}
    for path, report in reports.items():
        add_report(content, report, Path(path).stem if len(reports) > 1 else "")
        versions, seeds = report.get("versions", {}), report.get("seeds", [])
        made = [f"pedzoo {report.get('command', '')}".strip(), f"version {versions.get('pedzoo', 'unknown')}"]
        made += [f"commit {versions['commit']}"] if "commit" in versions else []
        made += [f"seeds {' '.join(map(str, seeds))}"] if isinstance(seeds, list) and seeds else []
        about.append(", ".join(made))
    about += [f"{len(runs)} trainings"] if runs else []
    content["charts"] += _training_curves(runs)
    content["about"] = "; ".join(dict.fromkeys(about))
    shorten(content)
    return content


def shorten(content: dict[str, Any], largest: int = LARGEST - ROOM) -> None:
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
    for policy in policies:
        policy["episodes"] = policy["episodes"][:most]
    used = {one["plan"] for policy in policies for one in policy["episodes"]}
    content["cases"] = content["cases"] if most else []
    content["plans"] = {name: plan for name, plan in content["plans"].items() if name in used}


def _read(path: Path) -> dict[str, Any]:
    wanted = (
        "expected JSON that pedzoo evaluate, rollout, forecast, score or bench wrote, or the folder of a "
    )
    wanted += "training"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"cannot read {str(path)!r}: {error.strerror}; {wanted}") from error
    except ValueError as error:
        raise UserError(f"{str(path)!r} is no JSON: {wanted}") from error
    rows = report.get("rows") if isinstance(report, dict) else None
    keys = [set(row if isinstance(row, dict) else ()) for row in rows] if isinstance(rows, list) else [set()]
    if not all({"name", "metrics"} <= one for one in keys):
        raise UserError(f"{str(path)!r} has no rows with name and metrics: {wanted}")
    return report


def _trainings(folder: Path) -> list[Path]:
    if (folder / "metrics.csv").is_file():
        return [folder]
    if runs := sorted(file.parent for file in folder.glob("*/*/metrics.csv")):
        return runs
    raise UserError(
        f"no training in {str(folder)!r}: expected a folder that pedzoo fit wrote, with metrics.csv"
    )


def add_report(content: dict[str, Any], report: Mapping[str, Any], stem: str = "") -> None:
    """Add the tables, episodes and curves of one file, with its ``stem`` in their titles."""
    suffix, protocol = f" ({stem})" if stem else "", report.get("protocol", {})
    usual = protocol.get("scenario") if isinstance(protocol, dict) else None

    def table(row: Row) -> str:
        return str(row.get("table") or row.get("section") or usual or report.get("command", "results"))

    def label(row: Row) -> str:
        case = {key: str(value) for key, value in row.get("case", {}).items()}
        return case_label({"case": case}) if case else ""

    content["plans"] |= report.get("plans", {})
    for name, rows in _grouped(report["rows"], table).items():
        cases = _grouped(rows, label)
        means = [row for row in report.get("summary", []) if row.get("table") == name]
        tables = [_table(f"mean of {len(cases)} cases", means, None)] if len(cases) > 1 and means else []
        for case, of_case in cases.items():
            number = _add_case(content, f"{name} {case}".strip() + suffix, of_case)
            tables.append(_table(case or name, of_case, number))
        note = INTERVALS.replace("In brackets", "Below numbers")
        note += " A number that is a link leads to an episode."
        shown = {"name": name + suffix, "note": "" if content["tables"] else note, "tables": tables}
        content["tables"].append(shown)
    content["notes"] += [str(note) for note in report.get("notes", [])]
    content["charts"] += _distributions(report["rows"], suffix) + _scaling(report["rows"], suffix)


def _grouped(rows: Iterable[Row], key: Callable[[Row], str]) -> dict[str, list[Row]]:
    """Return rows by their key, in the order in which keys are first seen."""
    groups = defaultdict[str, list[Row]](list)
    for row in rows:
        groups[key(row)].append(row)
    return groups


def _add_case(content: dict[str, Any], name: str, rows: Sequence[Row]) -> int | None:
    """Add the episodes of a case; returns its number, None where no row keeps any."""
    if not (kept := [row for row in rows if row.get("episodes")]):
        return None
    name = " ".join(dict.fromkeys(name.split()))  # a table's name is often part of its cases
    known = {case["name"] for case in content["cases"]}
    if name in known:
        name = next(other for i in count(2) if (other := f"{name} {i}") not in known)
    policies = [{"name": str(row["name"]), "episodes": row["episodes"]} for row in kept]
    content["cases"].append({"name": name, "policies": policies})
    return len(content["cases"]) - 1


def _table(title: str, rows: Sequence[Row], case: int | None) -> dict[str, Any]:
    """Return a table; ``case`` is the number of the case whose episodes it leads to, None for a mean."""
    texts, metrics = legend(), list(dict.fromkeys(key for row in rows for key in row["metrics"]))
    # all of them are shown at once where none is known
    first = [name for name in FIRST if name in metrics][:AT_ONCE]
    columns = [
        {"key": key, "help": texts.get(key, ""), "better": better(key), "first": key in first or not first}
        for key in dict.fromkeys((*first, *metrics))
    ]
    lines = []
    for row in rows:
        intervals, number = row.get("ci95", {}), row.get("n", "")
        numbers = {key: value for key, value in row["metrics"].items() if isinstance(value, int | float)}
        lines.append(
            {
                "name": str(row["name"]),
                "n": number if isinstance(number, int | str) else "",
                "cells": {key: [value, *intervals.get(key, (None, None))] for key, value in numbers.items()},
                "seen": SEEN in row.get("case", {}),
                "reference": row["name"] in REFERENCES,
            }
        )
    return {"title": title, "case": case, "columns": columns, "rows": lines}


def better(metric: str) -> int:
    """Return 1 where more of a metric is better, -1 where less is, 0 where neither is."""
    return 1 if HIGHER.fullmatch(metric) else -1 if LOWER.fullmatch(metric) else 0


def _training_curves(runs: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the charts of trainings, a panel for each metric of validation, a line for each run."""
    panels = defaultdict[str, list[dict[str, Any]]](list)
    for run in runs:
        logged = defaultdict[str, dict[int, list[float]]](lambda: defaultdict(list))
        with (run / "metrics.csv").open(newline="") as lines:
            for row in csv.DictReader(lines):
                for key, text in row.items() if row.get("epoch") else ():
                    if text and re.match(r"(val|rollout)/|train/.*loss|train/g", key or ""):
                        logged[key][int(float(row["epoch"]))].append(float(text))
        for metric, values in logged.items():
            means = {epoch: sum(values[epoch]) / len(values[epoch]) for epoch in sorted(values)}
            panels[metric].append(_line(f"{run.parent.name}/{run.name}", means))
    order = sorted(panels, key=lambda metric: (metric not in FIRST_CURVES, -len(panels[metric]), metric))
    common = {"x": "epoch", "y": "", "zero": False}
    charts = [{"title": metric, "lines": panels[metric], **common} for metric in order[:PANELS]]
    note = "A point for every epoch with a validation; losses of training are means over the epoch."
    return [{"title": "Training", "note": note, "panels": charts}] if charts else []


def _line(name: str, points: Mapping[Any, Any]) -> dict[str, Any]:
    return {"name": name, "x": list(points), "y": list(points.values())}


def _distributions(rows: Sequence[Row], suffix: str) -> list[dict[str, Any]]:
    """Return the charts of crowds beside the recorded one, a group for each case."""

    def crowd(row: Row) -> str:
        case = row.get("case", {})
        return f"{case.get('fold', '')} {case.get('simulated', '')}".strip()

    drawn = [row for row in rows if row.get("distributions") or row.get("density_speed")]
    note = "Shares of all steps of 0.4 s. The thick line is the recorded crowd; ends count what is beyond."
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
        having = [row for row in rows if feature in row.get("distributions", {})]
        shares = [(REAL, first["real_share"])]
        shares += [(str(row["name"]), row["distributions"][feature]["share"]) for row in having]
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
    places = defaultdict[str, dict[str, dict[int, float]]](lambda: defaultdict(dict))
    for row in rows:
        size = re.fullmatch(r"(\d+) x (\d+)", str(row.get("case", {}).get("size", "")))
        if size and (value := row["metrics"].get("agent_steps_per_s")):
            place = str(row["case"].get("map", ""))
            places[place][str(row["name"])][int(size[1]) * int(size[2])] = value
    panels = []
    common = {"x": "people in all scenes (powers of ten)", "y": "steps of people per second", "log": True}
    for place, by_name in places.items():
        several = {name: dict(sorted(points.items())) for name, points in by_name.items() if len(points) > 1}
        if lines := [_line(*one) for one in several.items()]:
            panels.append({"title": place or "the usual floor plans", "lines": lines, **common})
    note = "Both axes are logarithmic."
    return [{"title": f"Speed by size{suffix}", "note": note, "panels": panels}] if panels else []
