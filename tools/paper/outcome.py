"""How two people get past each other at a door: pure functions over the 0.1 s trace of closed-loop episodes.

E episodes of A people (padded), T trace points; gates and pairs as in `pedzoo.metrics.door`. Every episode
has exactly one outcome:

* ``blocked``: not both arrive in time, and one of them was deadlocked.
* ``lost``: not both arrive in time, though no person stood still.
* ``through``: both arrive, but their centres came closer than the radius of a body (0.15 m): no avoidance.
* ``circle``: both arrive, and while they were closer than 0.6 m the bearing of the other turned by 90 degrees
  or more: they turn around each other.
* ``pass``: both arrive at a distance, or one after the other.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.metrics import arrival, contacts, door
from pedzoo.metrics.ratios import Ratio, finite, share
from pedzoo.sim.rollout import Rollout

OUTCOMES = ("blocked", "lost", "through", "circle", "pass")

ABOUT = 0.6
"""Metres: people farther away are not turned around."""

QUARTER = math.pi / 2
"""Radians that the bearing turns at least where two turn around each other."""


def outcome_ratios(rollout: Rollout) -> dict[str, Ratio]:
    """Return ``outcome_blocked`` to ``outcome_pass``, shares of episodes, and ``bearing_sweep_deg``.

    Raises:
        ValueError: The scenario has no door.
    """
    if rollout.gate is None:
        raise ValueError("outcomes are about a door, and this scenario has none")
    pair, meets = door.pair(rollout.path[:, :, 0], rollout.mask, rollout.gate)
    arrived = arrival.arrived_in_time(
        rollout.reached, rollout.goals, rollout.overdue, rollout.failed, rollout.mask
    )
    stuck = arrival.deadlocked(rollout.trace, rollout.goal, rollout.scored)
    near = contacts.least_distance(contacts.nearest(rollout.trace, rollout.present), rollout.scored).amin(1)
    both = door.of_pair(rollout.scored, pair).all(1) & meets.unsqueeze(1)
    sweep = bearing_sweep(door.of_pair(rollout.trace, pair), both)
    body = door.of_pair(rollout.radius, pair).mean(1)
    result = outcomes((arrived | ~rollout.mask).all(1), stuck.any(1), near, sweep, body)
    return {
        **{f"outcome_{name}": share(which) for name, which in result.items()},
        "bearing_sweep_deg": finite(torch.rad2deg(sweep)),
    }


def outcomes(arrived: Tensor, stuck: Tensor, least: Tensor, sweep: Tensor, body: Tensor) -> dict[str, Tensor]:
    """Return which episodes (E,) bool have each of the `OUTCOMES`.

    Args:
        arrived: Whether all arrive in time (E,) bool.
        stuck: Whether any person was deadlocked (E,) bool.
        least: Distance of the nearest two (E,), metres; infinite for a lone person.
        sweep: How far their bearing turned (E,), radians; infinite where they never came close.
        body: Mean radius of the two bodies (E,), metres.
    """
    overlapped, turned = least < body, sweep.isfinite() & (sweep >= QUARTER)
    avoided = arrived & ~overlapped
    result = (~arrived & stuck, ~arrived & ~stuck, arrived & overlapped, avoided & turned, avoided & ~turned)
    return dict(zip(OUTCOMES, result, strict=True))


def bearing_sweep(trace: Tensor, both: Tensor) -> Tensor:
    """Return how far the bearing of the second from the first turns while they are close (E,), radians.

    Turns to the left and to the right cancel each other. Infinite where they never come closer than 0.6 m.

    Args:
        trace: Positions of the two (E, 2, T, 2), metres.
        both: Whether both are scored (E, T) bool.
    """
    apart = trace[:, 1] - trace[:, 0]
    bearing = torch.atan2(apart[..., 1], apart[..., 0])
    close = both & (apart.norm(dim=-1) < ABOUT)
    turned = torch.atan2(bearing.diff(dim=1).sin(), bearing.diff(dim=1).cos())
    total = turned.where(close[:, 1:] & close[:, :-1], 0.0).sum(1).abs()
    return torch.where(close.any(1), total, torch.inf)
