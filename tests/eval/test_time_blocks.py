"""Intervals of forecasts: blocks of time, and the sums of scenes that they are made of."""

from __future__ import annotations

import math

import pytest
import torch

from pedzoo.core.batch import agents_of
from pedzoo.data.datamodule import Loading, TrajectoryDataModule
from pedzoo.eval.forecast import BlockSums, blocks, forecast_row
from pedzoo.metrics.forecast import ForecastScore, NegativeLogLikelihood
from pedzoo.metrics.statistics import ratio_interval
from pedzoo.models.base import known_displacements, true_displacements
from pedzoo.models.zoo.loading import load
from tools.paper.forecast_pages import NATS
from tools.paper.forecasts import line_likelihood, log_density, strayed


def test_blocks_are_as_long_as_a_window_and_within_a_recording() -> None:
    """Seven windows are two blocks of three with the last one added, three are one, none are none."""
    assert blocks([7, 3, 0, 2], 3).tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3, 3]


def test_interval_of_three_blocks_is_that_of_their_sums() -> None:
    """Windows come in any order, and in two updates."""
    data = TrajectoryDataModule(pred_len=8)
    data.setup("test")
    sums = BlockSums(data.sets["test"])
    sums.block = torch.tensor([0, 0, 1, 2])
    sums.add(torch.tensor([3, 0]), {"ade_m": (torch.tensor([6.0, 1.0]), torch.tensor([2, 1]))})
    sums.add(torch.tensor([1, 2]), {"ade_m": (torch.tensor([3.0, 6.0]), torch.tensor([3, 2]))})
    expected = ratio_interval(torch.tensor([4.0, 6.0, 6.0]), torch.tensor([4, 2, 2]))
    assert expected and sums.intervals()["ade_m"] == pytest.approx(expected)


def test_two_blocks_have_no_interval() -> None:
    data = TrajectoryDataModule()
    data.setup("test")
    sums = BlockSums(data.sets["test"])
    sums.block = torch.tensor([0, 0, 0, 1, 1])
    sums.add(torch.arange(5), {"ade_m": (torch.rand(5), torch.ones(5))})
    assert sums.intervals() == {}


def test_every_error_of_a_forecast_lies_in_its_interval() -> None:
    row = forecast_row("bent_line", load("bent_line"), TrajectoryDataModule(goal="window_end"), samples=3)
    assert set(row["ci95"]) >= {"ade_m", "min_ade_3_scene_m", "min_ade_3_agent_m", "next_step_m"}
    for name, (low, high) in row["ci95"].items():
        assert low < row["metrics"][name] < high, name


def test_sums_of_scenes_add_up_to_the_mean() -> None:
    data = TrajectoryDataModule(loading=Loading(batch_size=16))
    data.setup("test")
    score, total, people = ForecastScore(0), 0.0, 0
    for batch in data.test_dataloader():
        score.update(load("constant_velocity"), batch)
        errors, counts = score.latest()["ade_m"]
        assert errors.shape == counts.shape == batch.batch_size
        total, people = total + float(errors.sum()), people + int(counts.sum())
    assert people == len(data.sets["test"].rows)
    assert score.compute()["ade_m"] == pytest.approx(total / people)


def test_sums_of_likelihoods_by_hand() -> None:
    """Over two steps each: -1 and 2 nats in one scene, 3 in the other, whose second person is absent."""
    metric = NegativeLogLikelihood()
    known = torch.tensor([[[True, True], [True, True]], [[True, True], [False, False]]])
    metric.update(torch.tensor([[1.0, -2.0], [-3.0, math.nan]]), known)
    assert [values.tolist() for values in metric.latest] == [[1.0, 3.0], [4, 2]]
    assert float(metric.compute()) == pytest.approx(4 / 6)


def test_density_around_constant_velocity_is_that_of_torch() -> None:
    data = TrajectoryDataModule(pred_len=4)
    data.setup()
    scale, total, people = strayed(data), torch.zeros(4), 0
    for batch in data.train_dataloader():
        agents = agents_of(batch)
        last = agents["history"][:, :, -1:] - agents["history"][:, :, -2:-1]
        there = known_displacements(batch).all(-1)
        total += (true_displacements(batch) - last)[there].square().sum((0, 2))
        people += int(there.sum())
        oracle = torch.distributions.Normal(last.expand(-1, -1, 4, -1), scale.unsqueeze(-1))
        nats = oracle.log_prob(true_displacements(batch)).sum((2, 3))
        torch.testing.assert_close(log_density(batch, scale)[there], nats[there])
    torch.testing.assert_close(scale, (total / people / 2).sqrt().clamp_min(0.02))
    value, ends = line_likelihood(data)
    assert ends[NATS][0] < value < ends[NATS][1]
