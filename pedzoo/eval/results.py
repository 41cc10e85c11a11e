"""What people read of an evaluation: the same tables on a terminal and on a page."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

Shown = Mapping[str, tuple[Sequence[str], Sequence[str]]]
"""Metrics of each suite: of the headline, and of its own table."""

LEGEND = {
    "success": "share of people who reach all goals in time (max(20 s, 4 x the way's time) each)",
    "episode_success": "share of episodes in which everybody does",
    "deadlock": "share of people who do not arrive and once moved less than 0.1 m in 5 s, 0.5 m from a goal",
    "failed": "share of episodes in which the policy gave no number",
    "agent_contacts_per_min": "touches of others per minute that a person walks; one that lasts counts once",
    "wall_contacts_per_min": "touches of walls, likewise",
    "time_ratio": "time that people need, divided by that of the planner's way at the speed they like",
    "path_ratio": "way that people walk, divided by the planner's",
    "least_distance_m": "distance between centres of an episode's nearest two",
    "symmetry_index": "0 where both sides of the door wait the same time",
}


class Page(NamedTuple):
    """A table.

    Attributes:
        title: What it shows.
        head: Names of columns.
        rows: Cells, the first ones are names.
        names: How many of the first columns are names.
    """

    title: str
    head: list[str]
    rows: list[list[str]]
    names: int


def pages(report: Mapping[str, Any], shown: Shown) -> list[Page]:
    """Return the headline, and for each suite its metrics, and the cases where it has several.

    Args:
        report: Of `pedzoo.eval.evaluate.evaluate`.
        shown: Which metrics.
    """
    rows, summary = report["rows"], report["summary"]
    found = [_headline(summary, shown)]
    for suite, (headline, columns) in shown.items():
        mine = [row for row in summary if row["case"]["suite"] == suite]
        if not mine:
            continue
        known = [key for key in columns if any(key in row["metrics"] for row in mine)]
        cases = max(row["cases"] for row in mine)
        title = f"{suite}: mean of {cases} cases" if cases > 1 else suite
        body = [[row["name"], str(row["n"]), *(cell(row, key) for key in known)] for row in mine]
        found.append(Page(title, ["policy", "n", *known], body, 2))
        if cases > 1:
            found += [
                _by_case([row for row in rows if row["case"]["suite"] == suite], key) for key in headline
            ]
    return found


def markdown(report: Mapping[str, Any], shown: Shown, command: Sequence[str]) -> str:
    """Return the page with the command that made it, and all tables."""
    made, protocol = report["versions"], report["protocol"]
    said = ", ".join(f"{key} {value}" for key, value in protocol.items())
    seeds = " ".join(map(str, report["seeds"]))
    lines = [
        "# Closed-loop evaluation\n",
        f"Made by `{shlex.join(command)}` with pedzoo {made['pedzoo']}, torch {made['torch']}, commit"
        f" {made.get('commit', 'unknown')}: {said}, seeds {seeds}. {INTERVALS}\n",
        *(f"* {note}\n" for note in report["notes"]),
    ]
    for page in pages(report, shown):
        lines += [f"## {page.title}\n", _markdown_table(page)]
    lines += ["## What the numbers are\n", *(f"* `{key}`: {text}." for key, text in LEGEND.items())]
    return "\n".join(lines).rstrip() + "\n"


INTERVALS = (
    "In brackets 95 % intervals over episodes: Wilson's for shares, bootstrapped otherwise. The mean of "
    "several cases counts each the same."
)


def cell(row: Mapping[str, Any], key: str) -> str:
    """Return a number with its interval; a dash where there is none."""
    if key not in row["metrics"]:
        return "-"
    text = _number(row["metrics"][key])
    if key in row["ci95"]:
        text += f" [{', '.join(map(_number, row['ci95'][key]))}]"
    return text


def case_label(row: Mapping[str, Any]) -> str:
    """Return what tells a row from others of its suite."""
    kept = {key: value for key, value in row["case"].items() if key not in ("suite", "world", "weights")}
    if {"people", "goals"} <= kept.keys():  # as in Table II
        kept = {"map": kept.get("map", ""), "cell": f"{kept['people']}/{kept['goals']}"}
    return " ".join(kept.values())


def _headline(summary: Iterable[Mapping[str, Any]], shown: Shown) -> Page:
    columns = [(suite, key) for suite, (headline, _) in shown.items() for key in headline]
    found = {(row["name"], row["case"]["suite"]): row for row in summary}
    names = dict.fromkeys(name for name, _ in found)
    nothing: dict[str, Any] = {"metrics": {}, "ci95": {}}
    columns = [
        one for one in columns if any(one[1] in found.get((n, one[0]), nothing)["metrics"] for n in names)
    ]
    body = [
        [name, *(cell(found.get((name, suite), nothing), key) for suite, key in columns)] for name in names
    ]
    return Page("all suites", ["policy", *(f"{suite} {key}" for suite, key in columns)], body, 1)


def _by_case(rows: Sequence[Mapping[str, Any]], key: str) -> Page:
    """Return one metric: policies as rows, cases as columns."""
    cases = list(dict.fromkeys(map(case_label, rows)))
    found = {(row["name"], case_label(row)): row for row in rows}
    nothing: dict[str, Any] = {"metrics": {}, "ci95": {}}
    body = [
        [name, *(cell(found.get((name, case), nothing), key) for case in cases)]
        for name in dict.fromkeys(row["name"] for row in rows)
    ]
    return Page(f"{rows[0]['case']['suite']}: {key} in each case", ["policy", *cases], body, 1)


def _number(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"


def _markdown_table(page: Page) -> str:
    lines = [page.head, ["---"] * len(page.head), *page.rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
