"""A trivial density for likelihoods to stand beside: constant velocity, and how far people stray from it."""

from __future__ import annotations

import math
from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import BlockSums
from pedzoo.metrics.forecast import NegativeLogLikelihood
from pedzoo.metrics.statistics import Interval
from pedzoo.models.base import known_displacements, true_displacements

LEAST = 0.02
"""Metres per step: the smallest standard deviation, for people who stand at exactly one place."""

NATS = "nll_nats_per_step"


def line_likelihood(data: TrajectoryDataModule) -> tuple[float, dict[str, Interval]]:
    """Return minus the log density of the test windows, nats per person and step, and its 95 % interval.

    Every displacement is Gaussian around the last observed one, alike in all directions and independent of
    other steps, with the standard deviation that the training windows have at that step.
    """
    data.setup("fit")
    data.setup("test")
    scale = strayed(data)
    metric, sums, loader = NegativeLogLikelihood(), BlockSums(data.sets["test"]), data.test_dataloader()
    for draw, batch in zip(loader.sampler, loader, strict=True):
        metric.update(log_density(batch, scale), known_displacements(batch))
        sums.add(draw.scenes, {NATS: metric.latest})
    return float(metric.compute()), sums.intervals()


def strayed(data: TrajectoryDataModule) -> Tensor:
    """Return the standard deviation (T,) of training windows' displacements from the last observed one."""
    square = count = torch.zeros(data.pred_len)
    for batch in data.train_dataloader():
        known = known_displacements(batch)
        square = square + _off(batch).square().mean(-1).where(known, 0).sum((0, 1))
        count = count + known.sum((0, 1))
    return (square / count).sqrt().clamp_min(LEAST)


def log_density(batch: TensorDict, scale: Tensor) -> Tensor:
    """Return every person's log density (B, A), nats, for standard deviations (T,), metres per step."""
    nats = (
        -0.5 * (_off(batch) / scale.unsqueeze(-1)).square().sum(-1) - 2 * scale.log() - math.log(2 * math.pi)
    )
    return nats.where(known_displacements(batch), 0).sum(-1)


def _off(batch: TensorDict) -> Tensor:
    """Return true displacements (B, A, T, 2) minus the last observed one."""
    history = cast("Tensor", agents_of(batch)["history"])
    return true_displacements(batch) - (history[:, :, -1:] - history[:, :, -2:-1])
