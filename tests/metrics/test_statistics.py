"""Quantiles of weighted values against numpy's, and intervals by hand and over many trials."""

import math

import numpy as np
import pytest
import torch

from pedzoo.metrics.ratios import (
    Ratio,
    bootstrap_quantile,
    drawn_people,
    quantiles,
    ratio_interval,
    summarised,
    wilson,
)

AT = (0.05, 0.5, 0.95, 1.0)


def test_quantiles_by_hand() -> None:
    value, group = torch.tensor([3.0, 1.0, 2.0, 4.0]), torch.tensor([0, 0, 1, 1])
    weights = torch.tensor([[1.0, 1.0], [1.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    result = quantiles(value, group, weights, (0.5, 0.75))
    assert result[:3].tolist() == [[2.0, 3.0], [1.0, 3.0], [2.0, 4.0]]
    assert result[3].isnan().all()
    assert quantiles(value[:0], group[:0], weights, (0.5,)).isnan().all()


def test_quantiles_of_resamples_are_those_of_the_repeated_values(monkeypatch) -> None:
    monkeypatch.setattr("pedzoo.metrics.ratios._AT_ONCE", 700)  # several parts
    generator = torch.Generator().manual_seed(0)
    value = torch.randn(300, generator=generator, dtype=torch.float64)
    group = torch.randint(20, (300,), generator=generator)
    weights = drawn_people(20, resamples=7)
    for mine, result in zip(weights, quantiles(value, group, weights, AT), strict=True):
        repeated = value.repeat_interleave(mine[group].long())
        assert result.tolist() == np.quantile(repeated.numpy(), AT, method="inverted_cdf").tolist()


@pytest.mark.parametrize("episodes", [3, 5, 6, 10, 20])
def test_intervals_of_medians_cover_or_are_none(episodes: int) -> None:
    """People of one episode are alike: half of their variance is the episode's."""
    random, trials = np.random.default_rng(episodes), 150
    found = []
    for _ in range(trials):
        value = (random.normal(0, 1, (episodes, 1)) + random.normal(0, 1, (episodes, 3))).ravel()
        number = torch.arange(episodes).repeat_interleave(3)
        found.append(bootstrap_quantile(torch.from_numpy(value), number, episodes, 0.5))
    missed = sum(not low <= 0 <= high for low, high in filter(None, found))
    assert missed < 0.07 * trials + 2 * (0.07 * trials) ** 0.5
    assert (None in found) == (episodes < 6)


def test_intervals_of_shares_and_ratios_by_hand() -> None:
    # 8 of 10: the interval in Brown, Cai and DasGupta's formula
    assert wilson(0.8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert wilson(0.0, 20) == pytest.approx((0.0, 3.8415 / 23.8415), abs=1e-4)
    value = torch.randn(400, generator=torch.Generator().manual_seed(0)).double()
    half = 1.966 * float(value.std()) / 20
    mean = float(value.mean())
    assert ratio_interval(value, torch.ones(400)) == pytest.approx((mean - half, mean + half), abs=1e-3)
    # 1, 2 and 6: the jackknife's error is the root of (4 + 1 + 9) / 4 = 1.8708, t of three is 4.3027
    low, high = ratio_interval(torch.tensor([1.0, 2.0, 6.0]), torch.ones(3)) or (0.0, 0.0)
    assert low == 0.0 and high == pytest.approx(3 * math.exp(4.3027 * 1.8708 / 3), rel=1e-3)
    assert ratio_interval(3 * torch.arange(1.0, 6.0), torch.arange(1.0, 6.0)) is None
    assert ratio_interval(torch.tensor([4.0, 2.0, 0.0]), torch.tensor([2, 2, 0])) is None
    steps = torch.full((5,), 100.0)
    low, high = ratio_interval(torch.tensor([99.0, 90.0, 98.0, 99.0, 97.0]), steps, part=True) or (0.0, 0.0)
    assert low < 0.966 - 0.04 and high == 1.0


@pytest.mark.parametrize("episodes", [3, 5, 10, 20, 50])
def test_intervals_cover_few_episodes_and_rare_events(episodes: int) -> None:
    """Of rare, clustered and skewed values, and of ratios of sums, 93 of 100 intervals hold the truth."""
    random, trials = np.random.default_rng(episodes), 400
    size, once = (trials, episodes), np.ones((trials, episodes))
    minutes, people = random.gamma(4, 1, size), random.integers(0, 6, size)
    kinds = {
        **{f"Poisson {rate}": (random.poisson(rate, size), once, rate) for rate in (0.02, 0.1, 0.5, 2.0)},
        "contacts per minute": (random.poisson(0.1 * minutes), minutes, 0.1),
        "touches in clusters": ((random.random(size) < 0.1) * random.poisson(5, size), once, 0.5),
        "negative binomial": (random.negative_binomial(0.5, 0.2, size), once, 2.0),
        "exponential": (random.exponential(1, size), once, 1.0),
        "normal": (random.normal(3, 1, size), once, 3.0),
        "mean over people": (random.gamma(2 * np.maximum(people, 1e-9), 0.5), people, 1.0),
    }
    missed = {}
    for kind, (above, below, truth) in kinds.items():
        rows = zip(torch.from_numpy(above).double(), torch.from_numpy(below).double(), strict=True)
        ratios = [summarised({"x": Ratio(*sums)})[1].get("x", (-math.inf, math.inf)) for sums in rows]
        missed[kind] = sum(not low <= truth <= high for low, high in ratios) / trials
    assert max(missed.values()) < 0.07 + 2 * math.sqrt(0.07 * 0.93 / trials), missed
