"""Forecasts on the five folds of ETH/UCY: Table I of the paper, and forecasts with a floor under them.

Both stand beside what others have printed, and beside trivial lines.
"""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any, ClassVar, NamedTuple, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.paths import shipped
from pedzoo.core.types import GoalProtocol
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import BASELINES, FLOOR, BlockSums, forecast_row
from pedzoo.eval.results import ResultTable, mean_interval
from pedzoo.eval.suites.replay import digest_of
from pedzoo.eval.work_units import fingerprint
from pedzoo.metrics.forecast import negative_log_likelihood
from pedzoo.metrics.ratios import FEWEST, Interval
from pedzoo.models.base import known_displacements, true_displacements
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.store import find
from tools.paper.base import Jobs
from tools.paper.forecast_pages import NATS, floor_notes, floor_pages, table1_notes, table1_pages
from tools.paper.published import FOLDS, PEERS, RELEASED, TABLE_1

SAMPLES = 20

NETWORKS = ("anchor_mlp", "anchor_net")

RECORD = "FORECAST.json"
"""Every training seed of the zoo on the test scenes, by ``tools/zoo/train_zoo.py table``."""


class Block(NamedTuple):
    """What is compared under one protocol; ``tag`` ends the names of weights, behind the fold."""

    pred_len: int
    goal: GoalProtocol
    models: tuple[str, ...]
    tag: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The untrained predictors that stand beside them."""
        return BASELINES if self.goal != "none" else BASELINES[:1]


class Job(NamedTuple):
    """One model on one fold under one protocol: the smallest part that is kept; ``row`` is its name."""

    row: str
    weights: str
    fold: str
    goal: GoalProtocol
    pred_len: int
    samples: int
    seed: int
    root: str | None

    @property
    def label(self) -> str:
        """What is said while it is done."""
        return f"{self.fold}, 8 -> {self.pred_len}, {self.goal}: {self.row}"


class Table1(Jobs):
    """Every model of the zoo that was trained for a fold, on that fold."""

    title = "Table I: forecasts on ETH/UCY, leave one scene out"
    stem = "TABLE1"
    # 12 steps are for the comparison with the released models, which have no goal
    blocks: ClassVar[tuple[Block, ...]] = (
        Block(8, "none", (FLOOR, "sgan_nopool", "sgan", "social_vrnn")),
        Block(8, "window_end", (FLOOR, "sgan_goal", "sgan_goal_map")),
        Block(8, "destination", (FLOOR, "sgan_goal"), "_destination"),
        Block(12, "none", (FLOOR, "sgan_nopool", "sgan"), "_pred12"),
    )

    def __init__(
        self,
        folds: Sequence[str] = FOLDS,
        seed: int = 0,
        root: str | None = None,
        journal: Path | None = None,
    ) -> None:
        """Take the test scenes, and the seed of the random samples.

        Raises:
            UserError: A fold has no recordings.
        """
        self.folds, self.seed = tuple(folds), seed
        self.missing: dict[str, str] = {}
        jobs: dict[str, Job] = {}
        recordings = {fold: digest_of(fold, root) for fold in self.folds}
        for fold in self.folds:
            for block in self.blocks:
                for row, weights, digest in self._rows(block, fold):
                    job = Job(row, weights, fold, block.goal, block.pred_len, SAMPLES, seed, root)
                    jobs[fingerprint(job._replace(root=None), digest, recordings[fold])] = job
        super().__init__(jobs, work, journal, lambda job: (job.fold, job.pred_len))

    def _rows(self, block: Block, fold: str) -> list[tuple[str, str, str]]:
        """Return name, weights and their sum of all rows of a block that can be made."""
        rows = [(name, name, "") for name in block.lines]
        for architecture in block.models:
            # the floor sees no goal: it is the same for all protocols
            tag = block.tag.removesuffix("_destination") if architecture == FLOOR else block.tag
            weights = f"{architecture}.{fold}{tag}"
            if entry := find(weights):
                rows.append((architecture, weights, entry.card.sha256))
            else:
                self.missing[weights] = "no such weights"
        return rows

    def report(self) -> dict[str, Any]:
        """Return all rows, means over folds, and what others have printed."""
        missing = self.missing | {row["weights"]: row["missing"] for row in self.rows if "missing" in row}
        rows = [row for row in self.rows if "missing" not in row]
        protocol = {"folds": list(self.folds), "obs_len": 8, "samples": SAMPLES, "split": "test"}
        protocol |= {"clock": "benchmark", "keep_people": "complete", "min_people": 2}
        blocks = [
            {"pred_len": str(pred_len), "goal": goal, "tag": tag, "rows": [*one.lines, *models]}
            for one in self.blocks
            for pred_len, goal, models, tag in [one]
        ]
        report = {"protocol": protocol, "seeds": [self.seed], "notes": [], "missing": missing}
        report |= {"blocks": blocks, "rows": rows, "means": means(rows, self.folds)}
        return report | self._beside(report)

    def _beside(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Return the notes of a report, and what stands beside its rows."""
        entries = {name: find(name) for name in sorted({row["weights"] for row in report["rows"]})}
        known = {name: dict(entry.card.training) for name, entry in entries.items() if entry}
        return {
            "notes": table1_notes(report["missing"]),
            "training_seeds": {  # that cards tell of
                name: {key: training[key] for key in ("seeds", "seed", "chosen_by")}
                for name, training in known.items()
                if training["seeds"]
            },
            "paper": TABLE_1,
            "released": RELEASED,
        }

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the tables."""
        return table1_pages(report)


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

    def _beside(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Return the notes of a report, the training seeds on record, and the published rows."""
        notes = floor_notes(report["missing"])
        return {"notes": notes, "training": trainings(self.folds), "published": PEERS}

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the tables."""
        return floor_pages(report)


def work(job: Job) -> list[dict[str, Any]]:
    """Do a part and return its one row, or why it cannot be made."""
    started = time.perf_counter()
    where = {"fold": job.fold, "goal": job.goal, "pred_len": str(job.pred_len)}
    row: dict[str, Any] = {"weights": job.weights}
    try:
        model = load(job.weights, job.goal)
        with redirect_stdout(io.StringIO()):  # counts of windows and people: each row has its n
            data = _data(job.fold, job.goal, job.pred_len, job.root)
            row |= forecast_row(job.row, model, data, job.samples, job.seed)
            if (job.row, job.goal) == (BASELINES[0], "none"):  # it has no likelihood of its own
                row["metrics"][NATS], ends = line_likelihood(data)
                row["ci95"] |= ends
        test = data.sets["test"]
        row |= {"case": where, "windows": len(test), "blocks": BlockSums(test).count}
    except UserError as error:  # such as AlexNet's convolutions, which are not in the weights
        row |= {"missing": str(error)}
    return [row | {"seconds": round(time.perf_counter() - started, 2)}]


@lru_cache(maxsize=1)
def _data(fold: str, goal: GoalProtocol, pred_len: int, root: str | None) -> TrajectoryDataModule:
    return TrajectoryDataModule(fold, root, pred_len=pred_len, goal=goal)


def means(rows: Sequence[dict[str, Any]], folds: Sequence[str]) -> list[dict[str, Any]]:
    """Return the mean over the folds, each counts the same, of every row that all of them have.

    ``blocks`` is the smallest number of blocks of time; fewer than `FEWEST` give no interval.
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
        ci95, blocks = {}, min(row["blocks"] for row in mine)
        by_key = {key: [row["metrics"][key] for row in mine] for key in mine[0]["metrics"]}
        for key, values in by_key.items() if blocks >= FEWEST else ():
            # who is always exactly right has no interval either
            ends = [row["ci95"].get(key, (value, value)) for row, value in zip(mine, values, strict=True)]
            low, high = mean_interval(values, ends)
            ci95 |= {key: (low, high)} if low < high else {}
        about = {"name": name, "case": {"fold": "mean", "goal": goal, "pred_len": pred_len}}
        about |= {"n": sum(row["n"] for row in mine), "blocks": blocks, "ci95": ci95}
        result.append(about | {"metrics": {key: sum(v) / len(v) for key, v in by_key.items()}})
    return result


def trainings(folds: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return the errors of every training seed on the test scenes, by fold, and their means over folds."""
    record = shipped("checkpoints") / "results" / RECORD
    models = {(block.pred_len, block.goal): block.models for block in Forecasting.blocks}
    result: list[dict[str, Any]] = []
    by_case: dict[tuple[str, str, str], list[list[dict[str, float]]]] = {}
    for row in json.loads(record.read_text())["rows"]:
        case = {"pred_len": 8} | row["case"]
        name = row["name"].removesuffix("_destination")
        wanted = name in models.get((case["pred_len"], case["goal"]), ()) and case["fold"] in folds
        if not wanted or "per_seed" not in row:
            continue
        values, case["pred_len"] = row["per_seed"], str(case["pred_len"])
        seeds = [{key: values[key][seed] for key in values} for seed in range(row["seeds"])]
        result.append({"name": name, "case": case, "seeds": seeds})
        by_case.setdefault((name, case["goal"], case["pred_len"]), []).append(seeds)
    for (name, goal, pred_len), of_folds in by_case.items():
        if len(of_folds) < max(2, len(folds)):
            continue
        together = zip(*of_folds, strict=False)
        seeds = [{key: fmean(one[key] for one in each) for key in each[0]} for each in together]
        case = {"fold": "mean", "goal": goal, "pred_len": pred_len}
        result.append({"name": name, "case": case, "seeds": seeds})
    return result


# A trivial density for likelihoods to stand beside: constant velocity, and how far people stray from it

LEAST = 0.02
"""Metres per step: the smallest standard deviation, for people who stand at exactly one place."""


def line_likelihood(data: TrajectoryDataModule) -> tuple[float, dict[str, Interval]]:
    """Return minus the log density of the test windows, nats per person and step, and its 95 % interval.

    Every displacement is Gaussian around the last observed one, as wide as in training at that step.
    """
    data.setup("fit")
    data.setup("test")
    scale = strayed(data)
    above, below, sums, loader = 0.0, 0, BlockSums(data.sets["test"]), data.test_dataloader()
    for draw, batch in zip(loader.sampler, loader, strict=True):
        nats, steps = negative_log_likelihood(log_density(batch, scale), known_displacements(batch))
        sums.add(draw.scenes, {NATS: (nats, steps)})
        above, below = above + float(nats.sum()), below + int(steps.sum())
    return above / below, sums.intervals()


def strayed(data: TrajectoryDataModule) -> Tensor:
    """Return the standard deviation (T,) of training windows' displacements from the last observed one."""
    square = count = torch.zeros(data.pred_len)
    for batch in data.train_dataloader():
        known = known_displacements(batch)
        square = square + _off(batch).square().mean(-1).where(known, 0).sum((0, 1))
        count = count + known.sum((0, 1))
    return (square / count).sqrt().clamp_min(LEAST)


def log_density(batch: TensorDict, scale: Tensor) -> Tensor:
    """Return every person's log density (B, A), nats, for standard deviations (T,), metres per step."""
    squares = (_off(batch) / scale.unsqueeze(-1)).square().sum(-1)
    nats = -0.5 * squares - 2 * scale.log() - math.log(2 * math.pi)
    return nats.where(known_displacements(batch), 0).sum(-1)


def _off(batch: TensorDict) -> Tensor:
    """Return true displacements (B, A, T, 2) minus the last observed one."""
    history = cast("Tensor", agents_of(batch)["history"])
    return true_displacements(batch) - (history[:, :, -1:] - history[:, :, -2:-1])
