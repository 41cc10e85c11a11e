"""Forecasts with a floor under them: centroids, networks that move them, and what others have printed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, ClassVar

from pedzoo.core.paths import shipped
from pedzoo.eval.forecast import FLOOR
from pedzoo.eval.results import ResultTable
from pedzoo.models.zoo.store import find
from tools.paper.folds import means
from tools.paper.forecasting_pages import forecasting_notes, forecasting_pages
from tools.paper.forecasting_published import PEERS
from tools.paper.table1 import Block, Table1

NETWORKS = ("anchor_mlp", "anchor_net")

RECORD = "FORECAST.json"
"""Every training seed of the zoo on the test scenes, by ``tools/zoo/train_zoo.py table``."""


class Forecasting(Table1):
    """The zoo's forecasters on every fold, with the spread over training seeds, beside published rows."""

    title = "Forecasting with a floor: best of 20 on ETH/UCY, leave one scene out"
    stem = "FORECASTING"
    blocks: ClassVar[tuple[Block, ...]] = (
        Block(12, "none", (FLOOR, *NETWORKS, "sgan"), "_pred12"),
        Block(8, "none", (FLOOR, *NETWORKS)),
        Block(8, "destination", ("anchor_net_goal", "sgan_goal"), "_destination"),
        Block(8, "window_end", ("anchor_net_goal", "sgan_goal")),
    )

    def _rows(self, block: Block, fold: str) -> list[tuple[str, str, str]]:
        """Return the rows of a block; with a goal where the zoo has the network that it is about."""
        if block.goal != "none" and not find(f"anchor_net_goal.{fold}{block.tag}"):
            self.missing[f"anchor_net_goal.{fold}{block.tag}"] = "no such weights"
            return []
        return super()._rows(block, fold)

    def report(self) -> dict[str, Any]:
        """Return rows and means, the training seeds on record, and the published rows."""
        result = super().report()
        for key in ("paper", "released", "training_seeds"):
            del result[key]
        return result | {
            "notes": forecasting_notes(result["missing"]),
            "training": trainings(self.folds),
            "published": [peer.plain() for peer in PEERS],
        }

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the tables."""
        return forecasting_pages(report)


def trainings(folds: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return the errors of every training seed on the test scenes, by fold, and their means over the folds.

    Each has ``name``, ``case`` and ``seeds``: the metrics of seed 0, 1, ... A mean is of as many seeds as all
    folds have.
    """
    record = shipped("checkpoints") / "results" / RECORD
    blocks = {(block.pred_len, block.goal): block.models for block in Forecasting.blocks}
    result, by_case = [], {}
    for row in json.loads(record.read_text())["rows"]:
        case = {"pred_len": 8} | row["case"]
        name = row["name"].removesuffix("_destination")
        if name not in blocks.get((case["pred_len"], case["goal"]), ()) or case["fold"] not in folds:
            continue
        if "per_seed" not in row:
            continue
        values = row["per_seed"]
        seeds = [{key: values[key][seed] for key in values} for seed in range(row["seeds"])]
        case["pred_len"] = str(case["pred_len"])
        result.append({"name": name, "case": case, "seeds": seeds})
        by_case.setdefault((name, case["goal"], case["pred_len"]), []).append(result[-1])
    for (name, goal, pred_len), rows in by_case.items():
        counts = [len(row["seeds"]) for row in rows]
        if len(rows) < len(folds):
            continue
        of_seed = []
        for seed in range(min(counts)):
            parts = [
                {
                    "name": name,
                    "case": row["case"],
                    "n": 0,
                    "blocks": 1,
                    "ci95": {},
                    "metrics": row["seeds"][seed],
                }
                for row in rows
            ]
            of_seed += [mean["metrics"] for mean in means(parts, folds)]
        if of_seed:
            case = {"fold": "mean", "goal": goal, "pred_len": pred_len}
            result.append({"name": name, "case": case, "seeds": of_seed})
    return result
