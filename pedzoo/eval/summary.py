"""Several cases as one row: the mean over them, with its interval."""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from pedzoo.eval.results import SEEN
from pedzoo.metrics.statistics.intervals import Interval


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for every policy and table: each case counts the same, however many people it has.

    A metric that a case has no value of (no arrivals, no meetings) has none in the summary either: a mean
    over the other cases could not be compared with those of other policies.
    """
    order = {key: number for number, key in enumerate(dict.fromkeys(map(_place, rows)))}
    result = []
    for (table, name), group in groupby(sorted(rows, key=lambda row: order[_place(row)]), key=_place):
        cases = list(group)
        metrics: dict[str, float] = {}
        intervals: dict[str, Interval] = {}
        for key in cases[0]["metrics"]:
            if all(key in case["metrics"] for case in cases):
                values = [case["metrics"][key] for case in cases]
                ends = [
                    case["ci95"].get(key, (value, value)) for case, value in zip(cases, values, strict=True)
                ]
                metrics[key] = sum(values) / len(values)
                interval = mean_interval(values, ends)
                if interval[0] < interval[1]:
                    intervals[key] = interval
        seconds = {key: round(sum(case["seconds"][key] for case in cases), 2) for key in ("wall", "cpu")}
        result.append(
            {
                "name": name,
                "table": table,
                "case": {key: cases[0]["case"][key] for key in ("suite", "physics")} | _seen(cases),
                "n": sum(case["n"] for case in cases),
                "cases": len(cases),
                "metrics": metrics,
                "ci95": intervals,
                "seconds": seconds,
            }
        )
    return result


def mean_interval(values: Sequence[float], intervals: Sequence[Sequence[float]]) -> Interval:
    """Return the interval of the mean of independent estimates, each with an interval of its own.

    The method of variance estimates recovery (Zou and Donner, "Construction of confidence limits about effect
    measures", Statistics in Medicine 27, 2008): the squares of deviations to either side add up. So it
    stays longer towards the middle where the intervals are Wilson's.
    """
    mean = sum(values) / len(values)
    below, above = (
        math.sqrt(sum((value - ends[side]) ** 2 for value, ends in zip(values, intervals, strict=True)))
        for side in (0, 1)
    )
    return mean - below / len(values), mean + above / len(values)


def _seen(cases: Sequence[dict[str, Any]]) -> dict[str, str]:
    return {SEEN: "yes"} if any(SEEN in case["case"] for case in cases) else {}


def _place(row: dict[str, Any]) -> tuple[str, str]:
    return row["table"], row["name"]
