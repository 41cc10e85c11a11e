"""Closed-loop metrics as ratios of two sums over episodes, their 95 % intervals, and quantiles.

Sums add up over rollouts and processes. Episodes are independent, people in them are not. R resamples of G
groups (episodes, people) are weights (R, G): how often each group counts.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, wraps
from typing import Literal, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import torch
from scipy.special import ndtr, stdtrit
from torch import Tensor

from pedzoo.sim.rollout import Rollout

RESAMPLES = 2000

FEWEST, FEWEST_DRAWN = 3, 6
"""Episodes (or people, or blocks of time) of an interval by Student's t, and of one by a bootstrap."""

_NORMAL_95 = 1.959964

Interval = tuple[float, float]

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


def wilson(share: float, trials: int) -> Interval:
    """Return Wilson's score interval of a share; it has a width even where nothing or all succeeded."""
    square = _NORMAL_95**2
    middle = share + square / (2 * trials)
    half = _NORMAL_95 * math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    low, high = ((middle + sign * half) / (1 + square / trials) for sign in (-1, 1))
    return max(0.0, low), min(1.0, high)


def ratio_interval(above: Tensor, below: Tensor, part: bool = False) -> Interval | None:
    """Return the interval of a ratio of sums over episodes, (E,) each; None where it cannot be honest.

    Student's t with the jackknife's standard error (HC3: MacKinnon and White, "Some heteroskedasticity-
    consistent covariance matrix estimators with improved finite sample properties", Journal of Econometrics
    29, 1985). Where no value is below 0 the upper end is that of the logarithm, which is larger: rare counts
    and other skewed values are mostly too low. There is none for fewer than `FEWEST` episodes, nor where all
    say the same. ``part``: the values above are parts of those below, so that the ratio is at most 1.
    """
    known = below > 0
    above, below = above[known].double(), below[known].double()
    episodes = len(above)
    if episodes < FEWEST:
        return None
    value, weight = float(above.sum() / below.sum()), below / below.sum()
    error = float(((above / below - value) * weight / (1 - weight)).norm())
    half = t_95(episodes) * error
    if not 1e-9 * abs(value) < half < math.inf:
        return None
    if bool((above < 0).any()):
        return value - half, value + half
    if half > 10 * value:  # one episode has nearly all the weight
        return None
    low, high = value - half, value * math.exp(half / value)
    if part and value < 1:
        low = 1 - (1 - value) * math.exp(min(half / (1 - value), 10.0))
    return max(0.0, low), min(high, 1.0 if part else math.inf)


def t_95(groups: int) -> float:
    """Return how many standard errors of so many groups are in half of an interval."""
    return float(stdtrit(groups - 1, 0.975))


def percentile_interval(values: Tensor, groups: int | None = None) -> Interval | None:
    """Return the interval of a number from its values (R,) in resamples; NaN where it has none.

    Of resamples of ``groups`` it is the expanded percentile interval, wider as Student's t is (Hesterberg,
    "What Teachers Should Know About the Bootstrap", The American Statistician 69, 2015); else it holds 95 %.
    None for fewer than `FEWEST_DRAWN` groups, or where all values are the same.
    """
    if not len(values) or (groups is not None and groups < FEWEST_DRAWN):
        return None
    tail = float(ndtr(-math.sqrt(groups / (groups - 1)) * t_95(groups))) if groups else 0.025
    ends = torch.tensor([tail, 1 - tail], dtype=torch.float64)
    low, high = torch.nanquantile(values.double(), ends).tolist()
    return (low, high) if low < high else None


def bootstrap_quantile(value: Tensor, episode: Tensor, episodes: int, at: float) -> Interval | None:
    """Return `percentile_interval` of the quantile ``at`` of values (N,), each of an ``episode`` (N,)."""
    result = quantiles(value, episode, drawn_people(episodes), (at,))[:, 0]
    return percentile_interval(result, len(episode.unique()))


@lru_cache(maxsize=2)  # all metrics of a row, and all rows of a table, have the same
def drawn_people(people: int, resamples: int = RESAMPLES, seed: int = 0) -> Tensor:
    """Return how often each person (episode) is drawn (R, P), float64: P of P with replacement, R times."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.randint(people, (resamples, people), generator=generator)
    times = torch.zeros(resamples, people, dtype=torch.float64)
    return times.scatter_add_(1, chosen, torch.ones_like(times))


_AT_ONCE = 4_000_000
"""Weights of values that are added up at once: several such tensors fit memory."""


def quantiles(value: Tensor, group: Tensor, weights: Tensor, at: Sequence[float]) -> Tensor:
    """Return quantiles (R, Q) float64 of values (N,) of groups (N,), of the inverse distribution function."""
    shares = torch.tensor(at, dtype=torch.float64)
    if not len(value):
        return torch.full((len(weights), len(shares)), torch.nan, dtype=torch.float64)
    order = value.argsort()
    ordered, owner = value[order].double(), group[order]
    result = []
    for part in weights.double().split(max(1, _AT_ONCE // len(value))):
        until = part[:, owner].cumsum(1)
        total = until[:, -1:]
        # a share of a whole number of values may be rounded up to just above it
        place = torch.searchsorted(until, total * shares - 1e-9 * total).clamp_max(len(value) - 1)
        result.append(ordered[place].where(total > 0, torch.nan))
    return torch.cat(result)
