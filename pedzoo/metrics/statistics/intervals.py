"""95 % intervals of closed-loop numbers: episodes are independent of each other, people in them are not."""

import math
from functools import lru_cache

import torch
from torch import Tensor

from pedzoo.metrics.statistics.quantiles import quantiles

RESAMPLES = 2000

_NORMAL_95 = 1.959964

Interval = tuple[float, float]


def wilson(share: float, trials: int) -> Interval:
    """Return Wilson's score interval of a share; it has a width even where nothing or everything succeeded.

    With episodes as trials it is on the safe side for shares of people, who meet each other in an episode.
    """
    square = _NORMAL_95**2
    middle = share + square / (2 * trials)
    half = _NORMAL_95 * math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    low, high = ((middle + sign * half) / (1 + square / trials) for sign in (-1, 1))
    return max(0.0, low), min(1.0, high)


def bootstrap(numerator: Tensor, denominator: Tensor) -> Interval:
    """Return the percentile bootstrap interval over episodes of a ratio of sums, (E,) each."""
    times = _resampled(len(numerator))
    below = times @ denominator.double()
    result = (times @ numerator.double() / below)[below > 0]
    low, high = torch.quantile(result, torch.tensor([0.025, 0.975], dtype=torch.float64)).tolist()
    return low, high


def bootstrap_quantile(value: Tensor, episode: Tensor, episodes: int, at: float) -> Interval:
    """Return the percentile bootstrap interval over episodes of the quantile ``at`` of values (N,).

    ``episode`` (N,) is the episode of each value.
    """
    result = quantiles(value, episode, _resampled(episodes), (at,))[:, 0]
    ends = torch.nanquantile(result, torch.tensor([0.025, 0.975], dtype=torch.float64))
    low, high = ends.tolist()
    return low, high


@lru_cache(maxsize=2)  # all metrics of a row, and all rows of a table, have the same
def _resampled(episodes: int) -> Tensor:
    """Return how often each episode is drawn in each resample (RESAMPLES, E) float64."""
    generator = torch.Generator().manual_seed(0)
    chosen = torch.randint(episodes, (RESAMPLES, episodes), generator=generator)
    times = torch.zeros(RESAMPLES, episodes, dtype=torch.float64)
    return times.scatter_add_(1, chosen, torch.ones_like(times))
