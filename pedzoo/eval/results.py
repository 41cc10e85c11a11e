"""The tables of an evaluation: the mean of several cases, a terminal's tables, a page of Markdown."""

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from pedzoo.core.registry import METRICS


class SuiteColumns(NamedTuple):
    """What tables show of a suite, as of `pedzoo.eval.suite.Suite`."""

    headline: Sequence[str]
    columns: Sequence[str]
    counted: str
    legend: Mapping[str, str] = {}


SEEN = "seen"
"""What a row's case has if the policy's weights were trained on that case."""

_LEGEND = {
    "seconds_per_goal": "time that people walk in episodes in which all arrive, by the goals that they reach",
    "time_ratio_median": "the median over people of each one's time by that of free walking; in a replay of "
    "the time until the exit to the real one",
    "outcome_blocked": "share of episodes in which not both arrive and one of them is deadlocked",
    "outcome_lost": "in which not both arrive, though no person stands still",
    "outcome_through": "in which both arrive, but their centres come closer than 0.15 m",
    "outcome_circle": "in which both arrive and turn around each other: by 90 degrees or more within 0.6 m",
    "outcome_pass": "in which both arrive at a distance, or one after the other",
    "both_pass": "share of episodes in which both pass the door and arrive in time",
    "no_contact": "without any contact with people or walls",
    "one_slows": "in which both get through, and exactly one walks at less than half their speed before it",
    "as_in_paper": "in which all three hold, as the paper shows of its model",
    "bearing_sweep_deg": "how far the bearing of the other turns while they are closer than 0.6 m",
    "realism": "mean distance of six distributions (speed, acceleration, heading rate, nearest distance, "
    "time to collision, lateral deviation) to the real ones, in real standard deviations: lower is better",
    "w1_speed": "and `w1_acceleration` to `w1_lateral_deviation`: each of these six alone",
    "closed_loop_ade_m": "mean distance to where the person really was at that time",
    "dtw_m": "distance between the walked and the real way, whatever the time (dynamic time warping)",
    "density_speed_rmse_m_per_s": "between the mean speeds of both crowds at equal densities",
    "acceleration_p95_ratio": "quantile of 0.95 of acceleration, divided by that of the real crowd",
    "acceleration_p99_ratio": "likewise that of 0.99",
    "agent_contact_excess": "share of their time in which people touch others, beyond that of the real crowd",
    "agent_contact_excess_per_min": "touches of others beyond those of the real crowd",
    "wall_contact_excess_per_min": "touches of walls, likewise",
}
"""What metrics are that are no ratios of a rollout: of replays and of the paper's suites."""


def legend() -> dict[str, str]:
    """Return what each metric is: the first line of its function, or a text."""
    texts = {name: METRICS.describe(name).rstrip(".") for name in METRICS.names()}
    return {name: text[:1].lower() + text[1:] for name, text in texts.items()} | _LEGEND


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for every policy and table: each case counts the same, however many people it has.

    A metric that a case has no value of (no arrivals, no meetings) has none in the summary either. A mean
    over the other cases could not be compared with those of other policies.
    """
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["table"], row["name"]), []).append(row)
    result = []
    for (table, name), cases in groups.items():
        metrics, intervals = {}, {}
        for key in cases[0]["metrics"]:
            if all(key in case["metrics"] for case in cases):
                values = [case["metrics"][key] for case in cases]
                ends = [case["ci95"].get(key, (case["metrics"][key],) * 2) for case in cases]
                metrics[key] = sum(values) / len(values)
                low, high = mean_interval(values, ends)
                if low < high:
                    intervals[key] = low, high
        where = {key: cases[0]["case"][key] for key in ("suite", "physics")}
        seen = {SEEN: "yes"} if any(SEEN in case["case"] for case in cases) else {}
        seconds = {key: round(sum(case["seconds"][key] for case in cases), 2) for key in ("wall", "cpu")}
        counts = {"n": sum(case["n"] for case in cases), "cases": len(cases)}
        row = {"name": name, "table": table, "case": where | seen, **counts}
        result.append(row | {"metrics": metrics, "ci95": intervals, "seconds": seconds})
    return result


def mean_interval(values: Sequence[float], intervals: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Return the interval of the mean of independent estimates, each with an interval of its own.

    The method is that of variance estimates recovery: the squares of deviations to either side add up. So it
    stays longer towards the middle where the intervals are Wilson's. Source: Zou and Donner, "Construction of
    confidence limits about effect measures", Statistics in Medicine 27, 2008.
    """
    mean = sum(values) / len(values)
    below, above = (math.dist(values, side) / len(values) for side in zip(*intervals, strict=True))
    return mean - below, mean + above


class ResultTable(NamedTuple):
    """A table: its title, names of columns, rows of cells, and how many of the first columns are names."""

    title: str
    head: list[str]
    rows: list[list[str]]
    names: int


def pages(report: Mapping[str, Any], shown: Mapping[str, SuiteColumns]) -> list[ResultTable]:
    """Return the headline, and for each table of a suite its metrics, and the cases where it has several."""
    rows, summary = report["rows"], report["summary"]
    texts = {(row["name"], row["table"], key): cell(row, key) for row in summary for key in row["metrics"]}
    names = _labels(summary)
    columns = dict.fromkeys(
        (row["table"], key) for row in summary for key in shown[row["case"]["suite"]].headline
    )
    columns = [column for column in columns if any((name, *column) in texts for name in names)]
    body = [[label, *(texts.get((name, *one), "-") for one in columns)] for name, label in names.items()]
    result = [ResultTable("all suites", ["policy", *map(" ".join, columns)], body, 1)]
    for table in dict.fromkeys(row["table"] for row in summary):
        mine = [row for row in summary if row["table"] == table]
        headline, columns, *_ = shown[mine[0]["case"]["suite"]]
        known = [key for key in columns if any(key in row["metrics"] for row in mine)]
        if not any(row["metrics"].get("failed") for row in mine):
            known = [key for key in known if key != "failed"]
        cases = max(row["cases"] for row in mine)
        title = f"{table}: mean of {cases} cases" if cases > 1 else table
        labels = _labels(mine)
        body = [[labels[row["name"]], str(row["n"]), *(cell(row, key) for key in known)] for row in mine]
        result.append(ResultTable(title, ["policy", "n", *known], body, 2))
        if cases > 1:
            result += [_by_case([row for row in rows if row["table"] == table], key) for key in headline]
    return result


def _by_case(rows: Sequence[Mapping[str, Any]], key: str) -> ResultTable:
    """Return one metric: policies as rows, cases as columns."""
    texts = {(row["name"], case_label(row)): cell(row, key) for row in rows}
    names, cases = dict.fromkeys(name for name, _ in texts), dict.fromkeys(case for _, case in texts)
    body = [[name, *(texts.get((name, case), "-") for case in cases)] for name in names]
    table = rows[0]["table"]
    shorter = [" ".join(word for word in case.split() if word not in table.split()) for case in cases]
    return ResultTable(f"{table}: {key} in each case", ["policy", *shorter], body, 1)


def _labels(summary: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the policies with their labels in tables, which mark those with means of fewer cases."""
    cases: dict[str, int] = {}
    for row in summary:
        cases[row["table"]] = max(row["cases"], cases.get(row["table"], 0))
    fewer = {row["name"] for row in summary if row["cases"] < cases[row["table"]]}
    return {row["name"]: row["name"] + " (not all cases)" * (row["name"] in fewer) for row in summary}


def protocol_line(report: Mapping[str, Any], shown: Mapping[str, SuiteColumns]) -> str:
    """Return the protocol in a line: suites with their episodes, physics and warm starts, noise and seeds."""
    parts, protocol = [], report["protocol"]
    for suite in dict.fromkeys(row["case"]["suite"] for row in report["rows"]):
        mine = [row for row in report["rows"] if row["case"]["suite"] == suite]
        cases = {case_label(row): row["n"] for row in mine}
        size = f"{len(cases)} x {min(cases.values())}" if len(cases) > 1 else str(*cases.values())
        if len(set(cases.values())) > 1:
            size = f"{len(cases)} cases, {sum(cases.values())}"
        physics = " and ".join(dict.fromkeys(row["case"]["physics"] for row in mine))
        where = f"{physics}, warm start {protocol['warm_start'][suite]}"
        parts.append(f"{suite} {size} {shown[suite].counted} ({where})")
    noise = "none" if protocol["deterministic"] else "sampled"
    seeds = " ".join(map(str, report["seeds"]))
    return f"{'; '.join(parts)}; noise {noise}, seeds {seeds}"


def markdown(report: Mapping[str, Any], shown: Mapping[str, SuiteColumns], command: Sequence[str]) -> str:
    """Return the page with the command that made it, and all tables."""
    made = report["versions"]
    lines = [
        "# Closed-loop evaluation\n",
        f"Made by `{shlex.join(command)}` with pedzoo {made['pedzoo']}, torch {made['torch']}, commit"
        f" {made.get('commit', 'unknown')}: {protocol_line(report, shown)}. {INTERVALS}\n",
        *(f"* {note}\n" for note in report["notes"]),
    ]
    for page in pages(report, shown):
        lines += [f"## {page.title}\n", markdown_table(page.head, page.rows)]
    explained: dict[str, None] = {}
    for suite, one in shown.items():
        known = {key for row in report["summary"] if row["case"]["suite"] == suite for key in row["metrics"]}
        texts = one.legend or legend()
        explained |= {f"* `{key}`: {text}.": None for key, text in texts.items() if key in known}
    return "\n".join([*lines, "## What the numbers are\n", *explained]).rstrip() + "\n"


INTERVALS = (
    "In brackets 95 % intervals over what n counts: Wilson's for shares, Student's t for means and rates "
    "(jackknife, upper ends of the logarithm), bootstrapped for medians and distances; none if all say the "
    "same or fewer than 3 say anything. The mean of several cases counts each the same."
)


def cell(row: Mapping[str, Any], key: str) -> str:
    """Return a number with its interval; a dash where there is none."""
    if key not in row["metrics"]:
        return "-"
    text = _number(row["metrics"][key])
    if SEEN in row["case"]:
        text += "*"
    if key in row["ci95"]:
        text += f" [{', '.join(map(_number, row['ci95'][key]))}]"
    return text


def case_label(row: Mapping[str, Any]) -> str:
    """Return what distinguishes a row within its suite."""
    case = {
        key: text for key, text in row["case"].items() if key not in ("suite", "physics", "weights", SEEN)
    }
    if {"people", "goals"} <= case.keys():  # as in Table II
        case["people"] = f"{case['people']}/{case.pop('goals')}"
    return " ".join(case.values())


def _number(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"


def markdown_table(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table of Markdown."""
    lines = [names, ["---"] * len(names), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"
