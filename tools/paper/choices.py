"""What two people settle between them, and how often noise settles it the other way.

E episodes of A people, D draws of noise of the same scenes. A choice is 0 or 1, NaN where it is not settled.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.metrics import door
from pedzoo.metrics.ratios import Ratio, finite, ratio, share
from pedzoo.sim.rollout import Rollout


def first_through(rollout: Rollout) -> Tensor:
    """Return which of the pair at a door passes it first (E,) float64, NaN where not both do.

    0: who comes from the side that the door's normal points away from, however people are numbered.

    Raises:
        ValueError: The scenario has no door.
    """
    if rollout.gate is None:
        raise ValueError("who goes first is about a door, and this scenario has none")
    pair, met = door.pair(rollout.path[:, :, 0], rollout.mask, rollout.gate)
    seconds = door.of_pair(door.passing_seconds(rollout.path, rollout.scored, rollout.gate), pair)
    both = seconds.isfinite().all(1) & met & (seconds[:, 0] != seconds[:, 1])
    return (seconds[:, 1] < seconds[:, 0]).double().where(both, torch.nan)


def passing_side(rollout: Rollout) -> Tensor:
    """Return on which side the first two agents pass each other (E,) float64: 1 if each has the other left.

    By where the bearing of the second from the first turns until the first of them arrives, whatever frame
    they walk in. NaN where it turns by less than 90 degrees: they are not past each other.
    """
    both = (rollout.scored & rollout.underway)[:, :2].all(1)
    both = torch.cat((both[:, :1], both), dim=1)
    apart = (rollout.path[:, 1] - rollout.path[:, 0]).double()
    bearing = torch.atan2(apart[..., 1], apart[..., 0]).diff(dim=1)
    turn = torch.remainder(bearing + math.pi, 2 * math.pi) - math.pi
    total = turn.where(both[:, 1:] & both[:, :-1], 0.0).sum(1)
    return (total > 0).double().where(total.abs() > math.pi / 2, torch.nan)


def varied(settled: Tensor) -> dict[str, Ratio]:
    """Return how often draws of noise settle a choice in different ways.

    * ``varied``: share of scenes in which not all draws settle it the same way. ``disagreement``: the mean
      over scenes of the share of pairs of draws that do not agree. Both of scenes in which at least two draws
      settle it.
    * ``settled``: share of all walks in which it is settled.

    Args:
        settled: The choice in every scene and draw (E, D).
    """
    known = ~settled.isnan()
    draws, ones = known.sum(1).double(), settled.nansum(1)
    compared = draws >= 2
    pairs = draws * (draws - 1)
    apart = 2 * ones * (draws - ones) / pairs.clamp_min(1)
    return {
        "varied": share((ones > 0) & (ones < draws) & compared, compared),
        "disagreement": finite(apart.where(compared, torch.inf)),
        "settled": ratio(known, torch.ones_like(known)),
    }
