"""Quantiles of weighted values against numpy's, and their intervals over episodes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pedzoo.metrics.realism.distances import drawn_people
from pedzoo.metrics.statistics import bootstrap_quantile, quantiles

AT = (0.05, 0.5, 0.95, 1.0)


def test_quantiles_by_hand() -> None:
    value, group = torch.tensor([3.0, 1.0, 2.0, 4.0]), torch.tensor([0, 0, 1, 1])
    weights = torch.tensor([[1.0, 1.0], [1.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    result = quantiles(value, group, weights, (0.5, 0.75))
    assert result[:3].tolist() == [[2.0, 3.0], [1.0, 3.0], [2.0, 4.0]]
    assert result[3].isnan().all()
    assert quantiles(value[:0], group[:0], weights, (0.5,)).isnan().all()


def test_quantiles_of_resamples_are_those_of_the_repeated_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pedzoo.metrics.statistics._AT_ONCE", 700)  # several parts
    generator = torch.Generator().manual_seed(0)
    value = torch.randn(300, generator=generator, dtype=torch.float64)
    group = torch.randint(20, (300,), generator=generator)
    weights = drawn_people(20, resamples=7)
    for mine, result in zip(weights, quantiles(value, group, weights, AT), strict=True):
        repeated = value.repeat_interleave(mine[group].long())
        assert result.tolist() == np.quantile(repeated.numpy(), AT, method="inverted_cdf").tolist()


def test_interval_of_a_median_shrinks_with_episodes_and_holds_it() -> None:
    generator = torch.Generator().manual_seed(1)
    widths = []
    for episodes in (20, 320):
        value = torch.randn(2 * episodes, generator=generator)
        low, high = bootstrap_quantile(value, torch.arange(2 * episodes) // 2, episodes, 0.5) or (0.0, 0.0)
        assert low < float(value.median()) < high
        widths.append(high - low)
    assert widths[1] < widths[0] / 2


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
