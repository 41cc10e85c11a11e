"""Table I: forecasts on the five folds of ETH/UCY, beside the paper, released models and trivial lines."""

from __future__ import annotations

import io
import time
from collections.abc import Mapping, Sequence
from contextlib import closing, redirect_stdout
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, cast

from pedzoo.core.errors import UserError
from pedzoo.core.types import GoalProtocol
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import BASELINES, forecast_row
from pedzoo.eval.results import Page
from pedzoo.eval.suites.replay import digest_of
from pedzoo.eval.time_blocks import BlockSums
from pedzoo.eval.units import fingerprint
from pedzoo.eval.workers.journal import Journal
from pedzoo.eval.workers.pool import finished
from pedzoo.eval.workers.progress_meter import Progress, ProgressReport
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.store import find
from tools.paper.base import Reproduction
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
    Block(8, "none", ("sgan", "sgan_pool", "social_vrnn")),
    Block(8, "window_end", ("sgan_goal", "sgan_goal_map", "sgan_goal_map_alexnet")),
    Block(8, "destination", ("sgan_goal",), "_destination"),
    Block(12, "none", ("sgan", "sgan_pool"), "_pred12"),
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
        """What people are told is going on."""
        return f"{self.fold}, 8 -> {self.pred_len}, {self.goal}: {self.row}"


class Table1(Reproduction):
    """Every model of the zoo that was trained for a fold, on that fold."""

    title = "Table I: forecasts on ETH/UCY, leave one scene out"
    stem = "TABLE1"

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
        self.jobs: list[Job] = []
        self._digests: list[str] = []
        recordings = {fold: digest_of(fold, root) for fold in self.folds}
        for fold in self.folds:
            for block in BLOCKS:
                for row, weights, digest in self._rows(block, fold):
                    job = Job(row, weights, fold, block.goal, block.pred_len, SAMPLES, seed, root)
                    self.jobs.append(job)
                    self._digests.append(fingerprint(job._replace(root=None), digest, recordings[fold]))
        self._journal = Journal(journal)
        self._done = {
            number: self._journal.done[known]
            for number, known in enumerate(self._digests)
            if known in self._journal.done
        }

    def _rows(self, block: Block, fold: str) -> list[tuple[str, str, str]]:
        """Return name, weights and their sum of all rows of a block that can be made."""
        result = [(name, name, "") for name in block.lines]
        for architecture in block.models:
            weights = f"{architecture}.{fold}{block.tag}"
            if entry := find(weights):
                result.append((architecture, weights, entry.card.sha256))
            else:
                self.missing[weights] = "no such weights"
        return result

    @property
    def parts(self) -> tuple[int, int]:
        """How many parts are done, and how many there are."""
        return len(self._done), len(self.jobs)

    @property
    def others(self) -> int:
        """How many parts the journal had of other requests, weights or code."""
        return len(self._journal.done.keys() - set(self._digests))

    def run(self, workers: int = 1, progress: Progress | None = None) -> None:
        """Do whatever is not done."""
        missing = [number for number in range(len(self.jobs)) if number not in self._done]
        start, total = time.perf_counter(), len(self.jobs)
        results = finished(
            [self.jobs[number] for number in missing],
            work,
            workers,
            group=lambda job: (job.fold, job.pred_len),
        )
        with closing(results):
            for count, (place, rows) in enumerate(results, 1):
                number = missing[place]
                self._done[number] = rows
                if "missing" not in rows[0]:  # what is missing may be there next time
                    self._journal.add(self._digests[number], rows)
                if progress:
                    left = (time.perf_counter() - start) / count * (len(missing) - count)
                    done, label = len(self._done), self.jobs[number].label
                    progress(ProgressReport(label, done / total, done, total, rows[0]["seconds"], left))

    def report(self) -> dict[str, Any]:
        """Return all rows, means over folds, and what others have printed."""
        rows = [row for number in sorted(self._done) for row in self._done[number]]
        missing = self.missing | {row["weights"]: row["missing"] for row in rows if "missing" in row}
        rows = [row for row in rows if "missing" not in row]
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
                for block in BLOCKS
            ],
            "rows": rows,
            "means": means(rows, self.folds),
            "training_seeds": {name: seeds for name in sorted({row["weights"] for row in rows})
                               if (seeds := _training(name))},
            "paper": [row._asdict() | {"errors": row.errors._asdict()} for row in TABLE_1],
            "released": [model.plain() for model in RELEASED],
        }  # fmt: skip

    def pages(self, report: Mapping[str, Any]) -> list[Page]:
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
