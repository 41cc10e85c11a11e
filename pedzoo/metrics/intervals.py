"""95 % intervals of closed-loop numbers: episodes are independent of each other, people in them are not."""

import math
from functools import lru_cache

import torch
from torch import Tensor

from pedzoo.metrics.quantiles import quantiles

_NORMAL_95 = 1.959964

Interval = tuple[float, float]


def wilson(share: float, trials: int) -> Interval:
    """Return Wilson's score interval of a share; it has a width even where nothing or everything succeeded.

    With episodes as trials it is on the safe side for shares of people, who meet each other in an episode.

    Args:
        share: Between 0 and 1.
        trials: Independent ones, at least 1.
    """
    square = _NORMAL_95**2
    middle = share + square / (2 * trials)
    half = _NORMAL_95 * math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    low, high = ((middle + sign * half) / (1 + square / trials) for sign in (-1, 1))
    return max(0.0, low), min(1.0, high)


def bootstrap(numerator: Tensor, denominator: Tensor, resamples: int = 2000, seed: int = 0) -> Interval:
    """Return the percentile bootstrap interval of ``numerator.sum() / denominator.sum()`` over episodes.

    Args:
        numerator: One value per episode (E,).
        denominator: Likewise, at least one of them above 0; a mean has 1 for each episode that counts.
        resamples: Drawn with replacement.
        seed: Of the draws.
    """
    times = _resampled(len(numerator), resamples, seed)
    below = times @ denominator.double()
    result = (times @ numerator.double() / below)[below > 0]
    low, high = torch.quantile(result, torch.tensor([0.025, 0.975], dtype=torch.float64)).tolist()
    return low, high


def bootstrap_quantile(
    value: Tensor, episode: Tensor, episodes: int, at: float, resamples: int = 2000, seed: int = 0
) -> Interval:
    """Return the percentile bootstrap interval of a quantile over episodes, of which each has several values.

    Args:
        value: Of people (N,), at least one.
        episode: Episode of each value (N,) long.
        episodes: How many there are, E.
        at: Which quantile, 0.5 for the median.
        resamples: Of episodes, drawn with replacement.
        seed: Of the draws.
    """
    result = quantiles(value, episode, _resampled(episodes, resamples, seed), (at,))[:, 0]
    ends = torch.nanquantile(result, torch.tensor([0.025, 0.975], dtype=torch.float64))
    low, high = ends.tolist()
    return low, high


@lru_cache(maxsize=2)  # all metrics of a row, and all rows of a table, have the same
def _resampled(episodes: int, resamples: int, seed: int) -> Tensor:
    """Return how often each episode is drawn in each resample (resamples, E) float64."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randint(episodes, (resamples, episodes), generator=generator)
    times = torch.zeros(resamples, episodes, dtype=torch.float64)
    return times.scatter_add_(1, chosen, torch.ones_like(times))
