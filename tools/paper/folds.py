"""Means over the folds of ETH/UCY, in which each of them counts the same."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from pedzoo.eval.results import mean_interval
from pedzoo.metrics.statistics import FEWEST
from tools.paper.paper import Errors


def means(rows: Sequence[dict[str, Any]], folds: Sequence[str]) -> list[dict[str, Any]]:
    """Return the mean over the folds of every row that all of them have, with its interval.

    ``blocks`` is the smallest number of blocks of time among them. A fold of fewer than `FEWEST` has no
    interval, and so nothing that it is part of has one.
    """
    grouped: dict[tuple[str, str, str], dict[str, dict[str, Any]]] = {}
    for row in rows:
        key = row["name"], row["case"]["goal"], row["case"]["pred_len"]
        grouped.setdefault(key, {})[row["case"]["fold"]] = row
    result = []
    for (name, goal, pred_len), by_fold in grouped.items():
        if len(folds) < 2 or set(by_fold) != set(folds):
            continue
        mine = [by_fold[fold] for fold in folds]
        metrics, ci95, blocks = {}, {}, min(row["blocks"] for row in mine)
        for key in mine[0]["metrics"]:
            values = [row["metrics"][key] for row in mine]
            metrics[key] = sum(values) / len(values)
            if blocks < FEWEST:
                continue
            # who is always exactly right has no interval either
            ends = [row["ci95"].get(key, (value, value)) for row, value in zip(mine, values, strict=True)]
            low, high = mean_interval(values, ends)
            ci95 |= {key: (low, high)} if low < high else {}
        case = {"fold": "mean", "goal": goal, "pred_len": pred_len}
        n = sum(row["n"] for row in mine)
        result.append(
            {"name": name, "case": case, "n": n, "blocks": blocks, "metrics": metrics, "ci95": ci95}
        )
    return result


def mean_errors(by_fold: Mapping[str, Errors]) -> Errors:
    """Return the means over the folds of errors that others printed."""
    return Errors(*(statistics.fmean(values) for values in zip(*by_fold.values(), strict=True)))
