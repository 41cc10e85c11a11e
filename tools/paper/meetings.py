"""How two people meet: how they get past each other at a door, and what they settle between them.

Pure functions over the 0.1 s trace of closed-loop episodes: E episodes of A people (padded), T trace points;
gates and pairs as in `pedzoo.metrics.door`. Every episode at a door has exactly one outcome:

* ``blocked``: not both arrive in time, and one of them was deadlocked.
* ``lost``: not both arrive in time, though no person stood still.
* ``through``: both arrive, but their centres came closer than the radius of a body (0.15 m): no avoidance.
* ``circle``: both arrive, and while they were closer than 0.6 m the bearing of the other turned by 90 degrees
  or more: they turn around each other.
* ``pass``: both arrive at a distance, or one after the other.

A choice is 0 or 1, NaN where it is not settled.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics import arrival, contacts, door, smoothness
from pedzoo.metrics.ratios import Ratio, finite, ratio, share
from pedzoo.sim.rollout import Rollout

OUTCOMES = ("blocked", "lost", "through", "circle", "pass")

PAPERS_OUTCOMES = ("both_pass", "no_contact", "one_slows", "as_in_paper")
"""What the paper shows of its own model: both pass the door, no contact, one slows down; and all three."""

SLOWED = 0.5
"""Share of their preferred speed below which people have slowed down."""

ABOUT = 0.6
"""Metres: people farther away are not turned around."""

QUARTER = math.pi / 2
"""Radians that the bearing turns at least where two turn around each other, or are past each other."""


def pair_at_door(rollout: Rollout) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gates, the pair that meets there, and where one does (E,) bool, see `pedzoo.metrics.door`.

    Raises:
        ValueError: The scenario has no door.
    """
    if rollout.gate is None:
        raise ValueError("this is about a door, and this scenario has none")
    return rollout.gate, *door.pair(rollout.path[:, :, 0], rollout.mask, rollout.gate)


def outcome_ratios(rollout: Rollout) -> dict[str, Ratio]:
    """Return ``outcome_blocked`` to ``outcome_pass``, shares of episodes, and ``bearing_sweep_deg``.

    Errors are those of `pair_at_door`.
    """
    _, pair, meets = pair_at_door(rollout)
    arrived = arrival.arrived_in_time(rollout)
    stuck = arrival.stuck(rollout.trace, rollout.goal, rollout.scored).any(2)
    near = contacts.least_distance(rollout).amin(1)
    both = door.of_pair(rollout.scored, pair).all(1) & meets.unsqueeze(1)
    sweep = bearing_sweep(door.of_pair(rollout.trace, pair), both)
    body = door.of_pair(rollout.radius, pair).mean(1)
    result = outcomes((arrived | ~rollout.mask).all(1), stuck.any(1), near, sweep, body)
    papers = dict(zip(PAPERS_OUTCOMES, as_the_paper(rollout), strict=True))
    return {
        **{f"outcome_{name}": share(which) for name, which in result.items()},
        **({name: share(which) for name, which in papers.items()} if bool(meets.any()) else {}),
        "bearing_sweep_deg": finite(torch.rad2deg(sweep)),
    }


def as_the_paper(rollout: Rollout) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return in which episodes what `PAPERS_OUTCOMES` names holds, (E,) bool each. Errors of `pair_at_door`.

    One slows down: before passing the door exactly one of the two is, over some 0.4 s, slower than half of
    the preferred speed. Contacts are those of people and walls.
    """
    gate, pair, met = pair_at_door(rollout)
    seconds = door.of_pair(door.passing_seconds(rollout.path, rollout.scored, gate), pair)
    arrived = (arrival.arrived_in_time(rollout) | ~rollout.mask).all(1)
    both = seconds.isfinite().all(1) & arrived & met
    velocity, known = (door.of_pair(value, pair) for value in smoothness.moves(rollout))
    slow = one_slows(velocity, known, seconds, door.of_pair(rollout.pref_speed, pair))
    free = contacts.untouched(rollout)
    return both, free, slow & met, both & free & slow


def one_slows(velocity: Tensor, known: Tensor, seconds: Tensor, pref_speed: Tensor) -> Tensor:
    """Return where exactly one of a pair slows down before the door (E,) bool, and both get through.

    Velocities (E, 2, S, 2), m/s, over steps of 0.4 s and which are ``known`` (E, 2, S); when each passed
    (E, 2), seconds, infinite for people not through; preferred speeds (E, 2), m/s.
    """
    end = STEP_SECONDS * torch.arange(1, velocity.shape[2] + 1, device=velocity.device)
    before = known & (end <= seconds.unsqueeze(2))
    slow = (velocity.norm(dim=-1) < SLOWED * pref_speed.unsqueeze(2)) & before
    return (slow.any(2).sum(1) == 1) & seconds.isfinite().all(1)


def outcomes(arrived: Tensor, stuck: Tensor, least: Tensor, sweep: Tensor, body: Tensor) -> dict[str, Tensor]:
    """Return which episodes (E,) bool have each of the `OUTCOMES`.

    Whether all arrive in time and anyone was deadlocked (E,) bool; the distance of the nearest two and their
    mean radius (E,), metres; how far their bearing turned (E,), radians. Infinite where there are no two.
    """
    overlapped, turned = least < body, sweep.isfinite() & (sweep >= QUARTER)
    avoided = arrived & ~overlapped
    result = (~arrived & stuck, ~arrived & ~stuck, arrived & overlapped, avoided & turned, avoided & ~turned)
    return dict(zip(OUTCOMES, result, strict=True))


def bearing_sweep(trace: Tensor, both: Tensor) -> Tensor:
    """Return how far the bearing of the second from the first turns while they are close (E,), radians.

    Positions are (E, 2, T, 2), metres; ``both`` are scored (E, T) bool. Infinite if never closer than 0.6 m.
    """
    apart = trace[:, 1] - trace[:, 0]
    close = both & (apart.norm(dim=-1) < ABOUT)
    return torch.where(close.any(1), _turn(apart, close).abs(), torch.inf)


def first_through(rollout: Rollout) -> Tensor:
    """Return which of the pair at a door passes it first (E,) float64, NaN where not both do.

    0: who comes from the side that the door's normal points away from, however people are numbered.
    """
    gate, pair, met = pair_at_door(rollout)
    seconds = door.of_pair(door.passing_seconds(rollout.path, rollout.scored, gate), pair)
    both = seconds.isfinite().all(1) & met & (seconds[:, 0] != seconds[:, 1])
    return (seconds[:, 1] < seconds[:, 0]).double().where(both, torch.nan)


def passing_side(rollout: Rollout) -> Tensor:
    """Return on which side the first two agents pass each other (E,) float64: 1 if each has the other left.

    NaN where their bearing turns by less than 90 degrees until one arrives: they are not past each other.
    """
    both = (rollout.scored & rollout.underway)[:, :2].all(1)
    apart = (rollout.path[:, 1] - rollout.path[:, 0]).double()
    total = _turn(apart, torch.cat((both[:, :1], both), dim=1))
    return (total > 0).double().where(total.abs() > QUARTER, torch.nan)


def _turn(apart: Tensor, counted: Tensor) -> Tensor:
    """Return how far (E,) offsets (E, T, 2) turn to the left between ``counted`` (E, T) bool, radians."""
    step = torch.atan2(apart[..., 1], apart[..., 0]).diff(dim=1)
    turned = torch.atan2(step.sin(), step.cos())
    return turned.where(counted[:, 1:] & counted[:, :-1], 0.0).sum(1)


def varied(settled: Tensor) -> dict[str, Ratio]:
    """Return how often draws of noise settle a choice, in every scene and draw (E, D), in different ways.

    * ``varied``: share of scenes in which not all draws settle it the same way. ``disagreement``: the mean
      share of pairs of draws that do not agree. Both of scenes in which at least two draws settle it.
    * ``settled``: share of all walks in which it is settled.
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
