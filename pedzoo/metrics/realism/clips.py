"""Clips of people's walks as rows of numbers: what a classifier sees that tells crowds apart.

A clip is `LENGTH` scored steps in a row of one person. Positions and velocities are in the frame of their
way: x points from where the policy took over to the exit. W clips, C = len(CHANNELS) numbers in every step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.contacts import HORIZON, collision_seconds
from pedzoo.metrics.realism.features import LINE, SampledRollout

LENGTH = 8
"""Steps of a clip: 3.2 s."""

CHANNELS = (
    *("velocity along the way", "velocity across the way"),
    *("acceleration along the way", "acceleration across the way"),
    *("nearest person ahead", "nearest person aside", "second person ahead", "second person aside"),
    *("nearest person's relative velocity along", "nearest person's relative velocity across"),
    *("second person's relative velocity along", "second person's relative velocity across"),
    *("time to collision", "distance to the exit"),
)
"""The numbers of a step, m, m/s, m/s^2 and s."""

FAR = 20.0
"""Metres ahead: the place of people who are missing."""

_AT_ONCE = 250_000
"""Pairs of people that are looked at at once."""


class Clips(NamedTuple):
    """W clips.

    Attributes:
        value: (W, LENGTH x C) float32, step after step.
        person: Whose they are (W,) long.
    """

    value: Tensor
    person: Tensor


def clips(steps: SampledRollout, start: Tensor, goal: Tensor) -> Clips:
    """Return the clips of people's walks; one begins with every scored step that has enough after it.

    Args:
        steps: Every 0.4 s.
        start: Where the policy took each person over (P, 2), metres.
        goal: Their exits (P, 2), metres.
    """
    episode, slot, step = steps.scored.nonzero().unbind(1)
    if not len(step):
        return Clips(torch.zeros(0, LENGTH * len(CHANNELS)), step)
    person = steps.person[episode, slot, step]
    value = _step_values(steps, start, goal, episode, slot, step)
    row = torch.arange(len(step))  # rows of one slot are in the order of time
    begins = torch.ones_like(row, dtype=torch.bool)
    begins[1:] = (person.diff() != 0) | (step.diff() != 1) | (slot.diff() != 0) | (episode.diff() != 0)
    since = row - torch.where(begins, row, 0).cummax(0).values
    last = row[since >= LENGTH - 1]
    rows = last.unsqueeze(1) + torch.arange(1 - LENGTH, 1)
    return Clips(value[rows].flatten(1), person[last])


def _step_values(
    steps: SampledRollout, start: Tensor, goal: Tensor, episode: Tensor, slot: Tensor, step: Tensor
) -> Tensor:
    """Return the numbers of scored steps (N, C)."""
    person = steps.person[episode, slot, step]
    way = goal - start
    away = goal[person] - steps.xy[episode, slot, step]
    has_line = (way.norm(dim=1) >= LINE)[person].unsqueeze(1)
    ahead = torch.nn.functional.normalize(torch.where(has_line, way[person], away), dim=1)
    velocity = steps.velocity[episode, slot, step]
    earlier = (step - 1).clamp_min(0)
    change = (velocity - steps.velocity[episode, slot, earlier]) / STEP_SECONDS
    change = change.where(steps.known[episode, slot, earlier].unsqueeze(1), 0.0)
    others = _others(steps, episode, slot, step)
    vectors = torch.stack((velocity, change, *others[:, :8].unflatten(1, (4, 2)).unbind(1)), 1)
    along = (vectors * ahead.unsqueeze(1)).sum(2)
    across = ahead[:, None, 0] * vectors[..., 1] - ahead[:, None, 1] * vectors[..., 0]
    turned = torch.stack((along, across), 2)
    missing = others[:, :4].unflatten(1, (2, 2)).isinf().any(2)
    nothing = torch.tensor([[FAR, 0.0], [0.0, 0.0]])
    for one in range(2):  # no such person: far ahead, at rest beside oneself
        for place, instead in zip((2 + one, 4 + one), nothing, strict=True):
            turned[:, place] = torch.where(missing[:, one : one + 1], instead, turned[:, place])
    return torch.cat((turned.flatten(1), others[:, 8:], away.norm(dim=1, keepdim=True)), 1).float()


def _others(steps: SampledRollout, episode: Tensor, slot: Tensor, step: Tensor) -> Tensor:
    """Return the nearest two and the time to a collision (N, 9).

    Relative places of the nearest two, relative velocities, and seconds; an absent one is infinitely far.
    """
    people = steps.xy.shape[1]
    place = (*steps.xy.unbind(-1), *steps.velocity.unbind(-1), steps.person >= 0, steps.known)
    place = (*place, steps.radius.unsqueeze(2).expand_as(steps.person))
    rows = [value.transpose(1, 2).flatten(0, 1) for value in place]  # (E x S, A): people present at once
    moments = episode * steps.person.shape[2] + step
    size, two, result = max(1, _AT_ONCE // people), min(2, people), []
    for moment, own in zip(moments.split(size), slot.unsqueeze(1).split(size), strict=True):
        x, y, vx, vy, there, known, radius = (value[moment] for value in rows)
        x, y, vx, vy = (value - value.gather(1, own) for value in (x, y, vx, vy))
        absent = ~there.scatter(1, own, False)
        apart, nearest = torch.hypot(x, y).masked_fill(absent, math.inf).topk(two, largest=False)
        gone = apart.isinf()
        pairs = [
            torch.stack((a.gather(1, nearest).masked_fill(gone, fill), b.gather(1, nearest)), 2).flatten(1)
            for a, b, fill in ((x, y, math.inf), (vx, vy, 0.0))
        ]
        if two < 2:  # no slot for a second person
            pairs = [
                torch.nn.functional.pad(pairs[0], (0, 2), value=math.inf),
                torch.nn.functional.pad(pairs[1], (0, 2)),
            ]
        reach = (radius + radius.gather(1, own)).to(x)
        seconds = collision_seconds(x, y, vx, vy, reach).masked_fill(absent | ~known, HORIZON).amin(1)
        result.append(torch.cat((*pairs, seconds.unsqueeze(1)), 1))
    return torch.cat(result)
