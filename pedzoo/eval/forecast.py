"""Open-loop tables: any models on one split, between the trivial baselines, under one named protocol."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import torch
from torch import Tensor

from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.registry import MODELS
from pedzoo.core.types import GoalProtocol
from pedzoo.data.datamodule import STAGES, TrajectoryDataModule
from pedzoo.data.recordings import Split
from pedzoo.data.scenes import SceneSet
from pedzoo.metrics.forecast import ForecastScore
from pedzoo.metrics.inputs import input_use
from pedzoo.metrics.ratios import Interval, ratio_interval
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import load

BASELINES = ("constant_velocity", "straight_line", "bent_line")
"""Predictors that are not trained; the lines know the goal."""

FLOOR = "anchors"
"""The baseline where the best of several is reported: centroids of the fold's training futures."""

FEW = 10
"""Tables mark intervals of fewer blocks as rough."""

Progress = Callable[[str, int, int], None]


def forecast(
    names: Sequence[str],
    data: TrajectoryDataModule,
    samples: int = 20,
    seed: int = 0,
    split: Split = "test",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Return the report of ``pedzoo forecast``: protocol, seeds and one row per model and baseline.

    Args:
        names: What `pedzoo.load` accepts.
        data: The data; their options are the protocol.
        samples: K of the best-of-K errors; 0 for none.
        seed: Of the samples, the same for every model.
        split: Which part of the fold.
        progress: Called with the model, batches done and batches in all.

    Raises:
        UserError: An unknown model, one that needs a goal where the data give none, a goal protocol for
            training only, or data without a window.
    """
    if data.goal == "random_future":
        raise UserError(
            "random_future goals are for training: "
            "set --data.goal to window_end, destination, planner or none"
        )
    samples, seed = as_integer("samples", samples), as_integer("seed", seed)
    if samples < 0:
        raise UserError(f"samples {samples}: expected at least 0")
    data.setup(STAGES[split])
    wanted = [name for name in BASELINES if data.goal != "none" or name == BASELINES[0]]
    models = {name: load(name, cast("GoalProtocol", data.goal)) for name in [wanted[0], *names, *wanted[1:]]}
    if samples > 1 and FLOOR not in models:
        models[FLOOR] = MODELS.get(FLOOR, Forecaster).of(steps=data.pred_len, modes=samples).eval()
        models[FLOOR].prepare(data.recorded("train"))
    rows = [forecast_row(name, model, data, samples, seed, split, progress) for name, model in models.items()]
    return {"protocol": data.protocol | {"split": split, "samples": samples}, "seeds": [seed], "rows": rows}


def forecast_row(
    name: str,
    model: Forecaster,
    data: TrajectoryDataModule,
    samples: int = 20,
    seed: int = 0,
    split: Split = "test",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Return one row: ``n`` people, each counted in every window, and errors with their 95 % intervals.

    Intervals are over time: see `BlockSums`. Arguments and errors are those of `forecast`.
    """
    if "goal" in model.needs and data.goal == "none":
        raise UserError(f"{name} needs a goal: set --data.goal (it was trained on {model.goal_protocol})")
    data.setup(STAGES[split])
    loader = getattr(data, f"{split}_dataloader")()
    score, generator, people = ForecastScore(samples), torch.Generator().manual_seed(seed), 0
    sums = BlockSums(data.sets[split])
    for i, (draw, batch) in enumerate(zip(loader.sampler, loader, strict=True)):
        score.update(model, batch, generator)
        sums.add(draw.scenes, score.latest)
        people += int(batch["agents", "mask"].sum())
        if progress:
            progress(name, i + 1, len(loader))
    own = model.goal_protocol
    other = own not in (None, data.goal) and "goal" in model.needs
    case = {"note": f"trained for {own} goals"} if other else {}
    return {"name": name, "case": case, "n": people, "metrics": score.compute(), "ci95": sums.intervals()}


def input_rows(
    name: str,
    model: Forecaster,
    data: TrajectoryDataModule,
    seed: int = 0,
    split: Split = "test",
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Return a row for each input of a model: its most likely forecasts with the input and without it.

    Metrics are those of `pedzoo.metrics.inputs.input_use`, and ``largest_shift_m``. Arguments and intervals
    are as of `forecast_row`.
    """
    data.setup(STAGES[split])
    loader = getattr(data, f"{split}_dataloader")()
    generator = torch.Generator().manual_seed(seed)
    blocks: dict[str, BlockSums] = {}
    totals: dict[str, dict[str, Tensor]] = {}
    largest: dict[str, float] = {}
    for i, (draw, batch) in enumerate(zip(loader.sampler, loader, strict=True)):
        for case, (shift, sums) in input_use(model, batch, generator).items():
            blocks.setdefault(case, BlockSums(data.sets[split])).add(draw.scenes, sums)
            largest[case] = max(largest.get(case, 0.0), float(shift.amax()) if shift.numel() else 0.0)
            total = totals.setdefault(case, {})
            for key, pair in sums.items():
                total[key] = total.get(key, 0) + torch.stack([value.double().sum() for value in pair])
        if progress:
            progress(name, i + 1, len(loader))
    rows = []
    for case, total in totals.items():
        means = {key: float(above / below.clamp(min=1)) for key, (above, below) in total.items()}
        metrics = means | {"largest_shift_m": largest[case]}
        count, ci95 = int(total["shift_m"][1]), blocks[case].intervals()
        rows.append({"name": name, "case": {"without": case}, "n": count, "metrics": metrics, "ci95": ci95})
    return rows


class BlockSums:
    """Sums of errors over blocks of time, which give 95 % intervals of their means.

    Windows share nearly all of their frames with the next one: taken as independent, intervals would be
    several times too narrow. A block is as many windows in a row as a window has frames, within one
    recording, so that only neighbouring blocks share frames (the block jackknife: Künsch, "The jackknife and
    the bootstrap for general stationary observations", Annals of Statistics 17, 1989). What differs between
    scenes and between trainings is not in these intervals.

    Attributes:
        block: Of each window (S,) long.
    """

    def __init__(self, scenes: SceneSet) -> None:
        """Cut the windows of a split into blocks."""
        windows = [counts.windows for _, counts in scenes.counts]
        self.block = blocks(windows, scenes.obs_len + scenes.pred_len)
        self._sums: dict[str, tuple[Tensor, Tensor]] = {}

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return int(self.block[-1]) + 1

    def add(self, scenes: Tensor, errors: Mapping[str, tuple[Tensor, Tensor]]) -> None:
        """Add the sums and numbers of people (B,) of each error in some scenes (B,)."""
        for name, result in errors.items():
            nothing = torch.zeros(self.count, dtype=torch.float64)
            totals = self._sums.setdefault(name, (nothing, nothing.clone()))
            for total, value in zip(totals, result, strict=True):
                total.index_add_(0, self.block[scenes], value.double().cpu())

    def intervals(self) -> dict[str, Interval]:
        """Return the interval of every mean; see `ratio_interval` for when there is none."""
        result = {name: ratio_interval(above, below) for name, (above, below) in self._sums.items()}
        return {name: ends for name, ends in result.items() if ends}


def blocks(windows: list[int], length: int) -> Tensor:
    """Return the number of each window's block (S,): ``length`` windows in a row, of one recording.

    ``windows`` are those of each recording. What is left at its end joins its last block, if there is one.
    """
    result, before = [], 0
    for number in windows:
        whole = max(1, number // length)
        result.append(before + (torch.arange(number) // length).clamp_max(whole - 1))
        before += whole if number else 0
    return torch.cat(result)
