"""Features that compare walks: speed, acceleration, heading, nearness and deviation, every 0.4 s.

Recorded people are annotated every 0.4 s, so simulated ones are sampled every 0.4 s, too: a shorter step
would compare interpolations. E episodes of A slots, S steps, P people numbered as in ``person``, N samples.
Every scored step of a person is one sample, if it has the feature. The change when a policy takes a person
over counts: the velocity before is the recorded one.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.contacts import HORIZON, collision_seconds
from pedzoo.metrics.realism.distances import Samples
from pedzoo.metrics.smoothness import WINDOW, acceleration, heading_rate
from pedzoo.sim.rollout import Rollout

FEATURES = {
    "speed": "m_per_s",
    "acceleration": "m_per_s2",
    "heading_rate": "rad_per_s",
    "nearest_distance": "m",
    "time_to_collision": "s",
    "lateral_deviation": "m",
}
"""Names and units, of which ``realism`` is the mean."""

LINE = 1.0
"""Metres: people who begin nearer to their goal have no line from which to deviate."""

CLOSE = 2.0
"""Metres: others within this distance make a place dense."""

_AT_ONCE = 250_000
"""Pairs of people that are compared at once: several such tensors fit a cache."""


class SampledRollout(NamedTuple):
    """A rollout every 0.4 s, from its begin and with the step before, for people controlled at once.

    Attributes:
        xy: Positions (E, A, S, 2), metres.
        person: Which person is there (E, A, S) long, -1 for none.
        velocity: Over the 0.4 s until then (E, A, S, 2), m/s.
        known: Whether the same person was there at their begin (E, A, S) bool.
        scored: Whether the policy controlled them meanwhile (E, A, S) bool; only where known. Not the step
            in which they arrive: policies that decide every 0.1 s leave in the middle of it.
        radius: Radii of the bodies (E, A), metres.
    """

    xy: Tensor
    person: Tensor
    velocity: Tensor
    known: Tensor
    scored: Tensor
    radius: Tensor


class Surroundings(NamedTuple):
    """The surroundings of each of N scored steps.

    Attributes:
        person: Person of each step (N,) long.
        speed: Theirs (N,), m/s.
        nearest: Distance to the nearest other (N,), metres between centres; infinite for a person alone.
        collision: Least time to a collision (N,), seconds, as of `pedzoo.metrics.contacts.time_to_collision`.
        close: Others within `CLOSE` (N,) long.
    """

    person: Tensor
    speed: Tensor
    nearest: Tensor
    collision: Tensor
    close: Tensor


def every_step(rollout: Rollout) -> SampledRollout:
    """Return the steps of a rollout."""
    last = WINDOW - 1
    first, person = (
        rollout.person[..., points].where(rollout.present[..., points], -1)
        for points in (slice(1), slice(last, None, WINDOW))
    )
    before = first.where(rollout.controlled[..., :1], -1)
    person = torch.cat((before, first, person), dim=2)
    xy = torch.cat((rollout.past[:, :, -1 - WINDOW :: WINDOW], rollout.trace[:, :, last::WINDOW]), dim=2)
    known = torch.zeros_like(person, dtype=torch.bool)
    known[..., 1:] = (person[..., 1:] == person[..., :-1]) & (person[..., 1:] >= 0)
    velocity = torch.zeros_like(xy)
    velocity[:, :, 1:] = xy.diff(dim=2) / STEP_SECONDS
    scored = torch.zeros_like(known)
    walks = rollout.controlled & (rollout.reached < rollout.goals)
    scored[..., 2:] = walks[..., last::WINDOW]
    return SampledRollout(xy, person, velocity, known, scored & known, rollout.radius)


def coarse(steps: SampledRollout) -> SampledRollout:
    """Return the steps with every position averaged over three of them, so that annotation jitter is out.

    A position is the mean of those before, at and after its step, of the same person. Steps next to a
    person's first or last one have no such mean: others see them as they are, and they are not scored.
    """
    person = steps.person
    same = torch.zeros_like(steps.known)
    same[..., 1:-1] = steps.known[..., 1:-1] & steps.known[..., 2:]
    mean = steps.xy.clone()
    mean[:, :, 1:-1] = (steps.xy[:, :, :-2] + steps.xy[:, :, 1:-1] + steps.xy[:, :, 2:]) / 3
    xy = torch.where(same.unsqueeze(3), mean, steps.xy)
    known = torch.zeros_like(same)
    known[..., 1:] = same[..., 1:] & same[..., :-1] & (person[..., 1:] == person[..., :-1])
    return _moved(steps, xy)._replace(known=known, scored=steps.scored & known)


def to_millimetres(steps: SampledRollout) -> SampledRollout:
    """Return the steps with positions rounded to 1 mm: else a file's decimals tell two crowds apart."""
    return _moved(steps, (steps.xy.double() * 1000).round().div(1000).float())


def _moved(steps: SampledRollout, xy: Tensor) -> SampledRollout:
    """Return the steps at other positions (E, A, S, 2)."""
    velocity = torch.zeros_like(xy)
    velocity[:, :, 1:] = xy.diff(dim=2) / STEP_SECONDS
    return steps._replace(xy=xy, velocity=velocity)


def features(steps: SampledRollout, around: Surroundings, start: Tensor, goal: Tensor) -> dict[str, Samples]:
    """Return the samples of every feature of `FEATURES`.

    * ``speed`` and ``acceleration``, the amount of the change of velocity since the step before.
    * ``heading_rate``, to either side, of people faster than 0.1 m/s in both steps: standing people have no
      heading.
    * ``nearest_distance`` to the centre of any other person, and ``time_to_collision``, at most 10 s; of
      people who are not alone.
    * ``lateral_deviation`` from the straight line between start and goal (P, 2), positive to the left of it;
      of people with `LINE` or more between them.
    """
    change, has_change = acceleration(steps.velocity, steps.known)
    turn, has_turn = heading_rate(steps.velocity, steps.known)
    scored, person = steps.scored[..., 1:], steps.person[..., 1:]
    company = around.nearest.isfinite()
    line = goal - start
    length = line.norm(dim=-1)
    along = line / length.clamp_min(LINE).unsqueeze(-1)
    of = steps.person.clamp_min(0)
    offset = steps.xy - start[of]
    aside = along[of][..., 0] * offset[..., 1] - along[of][..., 1] * offset[..., 0]
    return {
        "speed": Samples(around.speed, around.person),
        "acceleration": _samples(change, scored & has_change, person),
        "heading_rate": _samples(turn, scored & has_turn, person),
        "nearest_distance": Samples(around.nearest[company], around.person[company]),
        "time_to_collision": Samples(around.collision[company], around.person[company]),
        "lateral_deviation": _samples(aside, steps.scored & (length[of] >= LINE), steps.person),
    }


def surroundings(steps: SampledRollout) -> Surroundings:
    """Return the surroundings of every scored step; others count whether scored or played back."""
    episode, slot, step = steps.scored.nonzero().unbind(1)
    place = (*steps.xy.unbind(-1), *steps.velocity.unbind(-1), steps.person >= 0, steps.known)
    place = (*place, steps.radius.unsqueeze(2).expand_as(steps.person))
    rows = [value.transpose(1, 2).flatten(0, 1) for value in place]  # (E x S, A): people present at once
    moments = episode * steps.person.shape[2] + step
    size = max(1, _AT_ONCE // steps.xy.shape[1])
    result = []
    for moment, own in zip(moments.split(size), slot.split(size), strict=True):
        x, y, vx, vy, there, known, radius = (value[moment] for value in rows)
        result.append(_around(x, y, vx, vy, there, known, radius, own))
    nearest, collision, close = (torch.cat(values) for values in zip(*result, strict=True))
    speed = steps.velocity[episode, slot, step].norm(dim=-1)
    return Surroundings(steps.person[episode, slot, step], speed, nearest, collision, close)


def _around(
    x: Tensor,
    y: Tensor,
    vx: Tensor,
    vy: Tensor,
    there: Tensor,
    known: Tensor,
    radius: Tensor,
    slot: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return distance, time to collision and number of others close to the person in each ``slot`` (N,).

    All else is of the A slots (N, A): places, velocities, whether there is a person with a known one, radii.
    """
    own = slot.unsqueeze(1)
    x, y, vx, vy = (value - value.gather(1, own) for value in (x, y, vx, vy))
    others = there.scatter(1, own, False)
    apart = x.square().addcmul_(y, y).sqrt_().masked_fill_(~others, math.inf)
    reach = (radius + radius.gather(1, own)).to(x)
    when = collision_seconds(x, y, vx, vy, reach).masked_fill_(~(others & known), HORIZON)
    return apart.amin(1), when.amin(1), (apart < CLOSE).sum(1)


def _samples(value: Tensor, there: Tensor, person: Tensor) -> Samples:
    return Samples(value[there], person[there])
