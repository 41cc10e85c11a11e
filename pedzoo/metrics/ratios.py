"""Closed-loop metrics as ratios of two sums over episodes, which add up over rollouts and processes."""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Literal, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from pedzoo.metrics.statistics import Interval, ratio_interval, wilson
from pedzoo.sim.rollout import Rollout

T = TypeVar("T")

Scenes = Literal["all", "ordinary", "doors"]
"""Of which rollouts a metric is: ``ordinary`` are all but replays, ``doors`` those of them with a gate."""


class Ratio(NamedTuple):
    """A metric: ``above.sum() / below.sum()``, (E,) float64; an episode without a value has 0 in both."""

    above: Tensor
    below: Tensor
    share: bool = False  # of episodes or people
    part: bool = False  # a share of anything else, such as steps: at most 1


Function = TypeVar(
    "Function", bound=Callable[[Rollout], Ratio | tuple[Tensor, Tensor] | tuple[Tensor, Tensor, bool]]
)


def metric(scenes: Scenes = "all") -> Callable[[Function], Function]:
    """Declare a metric of rollouts of such ``scenes``: a function that returns a `Ratio`, or two sums (E,).

    The registry finds it in any file of this folder. Its name is the metric's, its docstring the legend.
    """

    def declare(function: Function) -> Function:
        setattr(function, "scenes", scenes)  # noqa: B010 - functions have no such field for type checkers
        return function

    return declare


def once(function: Callable[[Rollout], T]) -> Callable[[Rollout], T]:
    """Keep values that several metrics need of a rollout for as long as that rollout exists."""
    known: WeakKeyDictionary[Rollout, T] = WeakKeyDictionary()

    @wraps(function)
    def call(rollout: Rollout) -> T:
        if rollout not in known:
            known[rollout] = function(rollout)
        return known[rollout]

    return call


def ratio(above: Tensor, below: Tensor | None = None) -> Ratio:
    """Return the ratio of sums over all but episodes; per episode where the denominator is empty."""
    part = below is not None and above.dtype == below.dtype == torch.bool
    above = above.flatten(1).sum(1, dtype=torch.float64) if above.dim() > 1 else above.double()
    if below is None:
        return Ratio(above, torch.ones_like(above))
    below = below.flatten(1).sum(1, dtype=torch.float64) if below.dim() > 1 else below.double()
    return Ratio(above, below, part=part)


def share(above: Tensor, below: Tensor | None = None) -> Ratio:
    """Return a share of people or episodes, see `ratio`."""
    return ratio(above, below)._replace(share=True)


def mean(value: Tensor, known: Tensor) -> Ratio:
    """Return the mean of the ``known`` values, both (E, ...)."""
    return ratio(value & known if value.dtype == torch.bool else value.where(known, 0), known)


def of_sums(above: Tensor, below: Tensor, known: Tensor) -> Ratio:
    """Return the sum of one quantity by the sum of another, of their ``known`` values, all (E, ...)."""
    return ratio(above.where(known, 0), below.where(known, 0))


def finite(value: Tensor) -> Ratio:
    """Return the mean of the finite values (E, ...)."""
    return mean(value, value.isfinite())


def of_parts(parts: Sequence[Ratio]) -> Ratio:
    """Return a metric of all episodes, given that of some episodes after the other."""
    above, below, *_ = zip(*parts, strict=True)
    return parts[0]._replace(above=torch.cat(above), below=torch.cat(below))


def summarised(ratios: Mapping[str, Ratio]) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return the values of metrics and their 95 % intervals over episodes, where there are any."""
    metrics: dict[str, float] = {}
    intervals: dict[str, Interval] = {}
    for name, (above, below, is_share, part) in ratios.items():
        if not float(below.sum()) > 0:  # no person arrived, met another or walked
            continue
        metrics[name] = float(above.sum() / below.sum())
        trials = int((below > 0).sum())
        interval = wilson(metrics[name], trials) if is_share else ratio_interval(above, below, part)
        if interval and interval[0] < interval[1]:
            intervals[name] = interval
    return metrics, intervals
