"""Table I: forecasts on the five folds of ETH/UCY, beside the paper, released models and trivial lines."""

from __future__ import annotations

import io
import time
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, cast

from pedzoo.core.errors import UserError
from pedzoo.core.types import GoalProtocol
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import BASELINES, FLOOR, BlockSums, forecast_row
from pedzoo.eval.results import ResultTable
from pedzoo.eval.suites.replay import digest_of
from pedzoo.eval.work_units import fingerprint
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.store import find
from tools.paper.base import Jobs
from tools.paper.folds import means
from tools.paper.line_density import NATS, line_likelihood
from tools.paper.paper import FOLDS, RELEASED, TABLE_1
from tools.paper.table1_pages import notes, table1_pages

SAMPLES = 20


class Block(NamedTuple):
    """What is compared under one protocol.

    Attributes:
        pred_len: Predicted steps of 0.4 s.
        goal: Goal protocol.
        models: Architectures, one row each.
        tag: The end of their weights' names, behind the fold.
    """

    pred_len: int
    goal: GoalProtocol
    models: tuple[str, ...]
    tag: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The untrained predictors that stand beside them."""
        return BASELINES if self.goal != "none" else BASELINES[:1]


BLOCKS = (
    Block(8, "none", (FLOOR, "sgan", "sgan_pool", "social_vrnn")),
    Block(8, "window_end", (FLOOR, "sgan_goal", "sgan_goal_map", "sgan_goal_map_alexnet")),
    Block(8, "destination", (FLOOR, "sgan_goal"), "_destination"),
    Block(12, "none", (FLOOR, "sgan", "sgan_pool"), "_pred12"),
)
"""12 steps are for the comparison with the released models, which have no goal."""


class Job(NamedTuple):
    """One model on one fold under one protocol: the smallest part that is kept.

    Attributes:
        row: What the row is called.
        weights: What is loaded.
        fold: The test scene.
        goal: Goal protocol.
        pred_len: Predicted steps.
        samples: K.
        seed: Of the samples.
        root: Folder with recordings.
    """

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
    blocks: ClassVar[tuple[Block, ...]] = BLOCKS

    def __init__(
        self,
        folds: Sequence[str] = FOLDS,
        seed: int = 0,
        root: str | None = None,
        journal: Path | None = None,
    ) -> None:
        """Say what is to be done.

        Args:
            folds: Test scenes.
            seed: Of the random samples.
            root: Folder with recordings; None for the usual places.
            journal: A file that keeps finished parts.

        Raises:
            UserError: A fold has no recordings.
        """
        self.folds, self.seed = tuple(folds), seed
        self.missing: dict[str, str] = {}
        jobs: list[Job] = []
        digests: list[str] = []
        recordings = {fold: digest_of(fold, root) for fold in self.folds}
        for fold in self.folds:
            for block in self.blocks:
                for row, weights, digest in self._rows(block, fold):
                    job = Job(row, weights, fold, block.goal, block.pred_len, SAMPLES, seed, root)
                    jobs.append(job)
                    digests.append(fingerprint(job._replace(root=None), digest, recordings[fold]))
        super().__init__(jobs, digests, work, journal, lambda job: (job.fold, job.pred_len))

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
        return {
            "protocol": protocol,
            "seeds": [self.seed],
            "notes": notes(missing),
            "missing": missing,
            "blocks": [
                {"pred_len": str(block.pred_len), "goal": block.goal, "tag": block.tag,
                 "rows": [*block.lines, *block.models]}
                for block in self.blocks
            ],
            "rows": rows,
            "means": means(rows, self.folds),
            "training_seeds": {name: seeds for name in sorted({row["weights"] for row in rows})
                               if (seeds := _training(name))},
            "paper": [row._asdict() | {"errors": row.errors._asdict()} for row in TABLE_1],
            "released": [model.plain() for model in RELEASED],
        }  # fmt: skip

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the tables."""
        return table1_pages(report)


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


def _training(name: str) -> dict[str, Any] | None:
    """Return what a card says about the seeds that were trained, None where it does not."""
    entry = find(name)
    if entry is None or not entry.card.training["seeds"]:
        return None
    training = entry.card.training
    return {key: cast("Any", training[key]) for key in ("seeds", "seed", "chosen_by")}
