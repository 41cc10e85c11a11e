"""Metrics as ratios of two sums over episodes: what can be added over rollouts, seeds and processes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.metrics.intervals import Interval, bootstrap, wilson


class Ratio(NamedTuple):
    """A metric: ``above.sum() / below.sum()``; episodes about which it says nothing have 0 in both.

    Attributes:
        above: Of each episode (E,) float64.
        below: Likewise: how many episodes, people, frames, ... the sum above is over.
        share: Whether it is a share of episodes or people.
    """

    above: Tensor
    below: Tensor
    share: bool = False


def ratio(above: Tensor, below: Tensor | None = None) -> Ratio:
    """Return the ratio of what is summed over all but episodes; per episode where there is nothing below."""
    above = above.flatten(1).sum(1, dtype=torch.float64) if above.dim() > 1 else above.double()
    if below is None:
        return Ratio(above, torch.ones_like(above))
    return Ratio(above, below.flatten(1).sum(1, dtype=torch.float64) if below.dim() > 1 else below.double())


def share(above: Tensor, below: Tensor | None = None) -> Ratio:
    """Return a share of people or episodes, see `ratio`."""
    return ratio(above, below)._replace(share=True)


def mean(value: Tensor, known: Tensor) -> Ratio:
    """Return the mean of what is ``known``, both (E, ...)."""
    return ratio(value.where(known, 0), known)


def of_sums(above: Tensor, below: Tensor, known: Tensor) -> Ratio:
    """Return the sum of one quantity by the sum of another, both of what is ``known``, all (E, ...)."""
    return ratio(above.where(known, 0), below.where(known, 0))


def finite(value: Tensor) -> Ratio:
    """Return the mean of the finite values (E, ...)."""
    return mean(value, value.isfinite())


def summarised(ratios: Mapping[str, Ratio]) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return the values of metrics and their 95 % intervals over episodes.

    A metric about which no episode says anything is in neither; one about which all say the same has no
    interval, unless it is a share: a bootstrap knows nothing then.
    """
    metrics: dict[str, float] = {}
    intervals: dict[str, Interval] = {}
    for name, (above, below, is_share) in ratios.items():
        if not float(below.sum()) > 0:
            continue  # nobody arrived, nobody met, nobody walked
        metrics[name] = float(above.sum() / below.sum())
        trials = int((below > 0).sum())
        interval = wilson(metrics[name], trials) if is_share else bootstrap(above, below)
        if interval[0] < interval[1]:
            intervals[name] = interval
    return metrics, intervals
