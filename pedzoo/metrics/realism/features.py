"""Features of steps and clips (3.2 s pieces of a walk), by which scores and losses compare crowds.

Recorded people are annotated every 0.4 s, so simulated ones are sampled every 0.4 s, too. E episodes of A
slots, S steps, P people numbered as in ``person``. Every scored step of a person is one of M rows.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from pedzoo.core.geometry import unrotate
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.contacts import HORIZON, collision_seconds, touch_seconds
from pedzoo.metrics.realism.distances import Samples
from pedzoo.metrics.smoothness import STANDS, WINDOW
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
"""The C numbers of a step of a clip, m, m/s, m/s^2 and s."""

FAR = 20.0
"""Metres ahead: the place in clips of people who are missing."""

_AT_ONCE = 250_000
"""Pairs of people that are compared at once: several such tensors fit a cache."""


class SampledRollout(NamedTuple):
    """A rollout every 0.4 s, from its begin and with the step before, for people controlled at once."""

    xy: Tensor  # positions (E, A, S, 2), metres
    person: Tensor  # which person is there (E, A, S) long, -1 for none
    velocity: Tensor  # over the 0.4 s until then (E, A, S, 2), m/s
    known: Tensor  # whether the same person was there at their begin (E, A, S) bool
    scored: Tensor  # where known, if the policy controlled them meanwhile and they have not arrived; bool
    radius: Tensor  # of the bodies (E, A), metres


class Surroundings(NamedTuple):
    """The others around people in M rows."""

    place: Tensor  # of the nearest two less one's own (M, 2, 2), metres; infinite for absent ones
    velocity: Tensor  # theirs less one's own (M, 2, 2), m/s; 0 for absent ones
    collision: Tensor  # least time to a collision (M,), at most 10 s, see `collision_seconds`
    close: Tensor  # others within `CLOSE` (M,) long

    @property
    def company(self) -> Tensor:
        """Which people are not alone (M,) bool."""
        return self.place[:, 0, 0].isfinite()


class Clips(NamedTuple):
    """W clips of `LENGTH` scored steps in a row of one person, by which a classifier tells crowds apart.

    Values are (W, LENGTH x C) float32, in the frame of a person's way: x points from where the policy took
    over to the exit. ``person`` (W,) long is whose they are.
    """

    value: Tensor
    person: Tensor


def every_step(rollout: Rollout) -> SampledRollout:
    """Return the steps of a rollout."""
    last = WINDOW - 1
    first, person = (
        rollout.person[..., points].where(rollout.present[..., points], -1)
        for points in (slice(1), slice(last, None, WINDOW))
    )
    person = torch.cat((first.where(rollout.controlled[..., :1], -1), first, person), dim=2)
    xy = torch.cat((rollout.past[:, :, -1 - WINDOW :: WINDOW], rollout.trace[:, :, last::WINDOW]), dim=2)
    known = _later((person[..., 1:] == person[..., :-1]) & (person[..., 1:] >= 0))
    walks = (rollout.controlled & (rollout.reached < rollout.goals))[..., last::WINDOW]
    return SampledRollout(xy, person, _velocity(xy), known, _later(walks, 2) & known, rollout.radius)


def coarse(steps: SampledRollout) -> SampledRollout:
    """Return the steps with every position averaged over three of them, so that annotation jitter is out.

    A person's first and last steps have no such mean: others see them as they are, and they are not scored.
    """
    person, same, xy = steps.person, torch.zeros_like(steps.known), steps.xy.clone()
    same[..., 1:-1] = steps.known[..., 1:-1] & steps.known[..., 2:]
    xy[:, :, 1:-1] = (steps.xy[:, :, :-2] + steps.xy[:, :, 1:-1] + steps.xy[:, :, 2:]) / 3
    xy = torch.where(same.unsqueeze(3), xy, steps.xy)
    known = _later(same[..., 1:] & same[..., :-1] & (person[..., 1:] == person[..., :-1]))
    return steps._replace(xy=xy, velocity=_velocity(xy), known=known, scored=steps.scored & known)


def to_millimetres(steps: SampledRollout) -> SampledRollout:
    """Return the steps with positions rounded to 1 mm: else a file's decimals tell two crowds apart."""
    xy = (steps.xy.double() * 1000).round().div(1000).float()
    return steps._replace(xy=xy, velocity=_velocity(xy))


def _velocity(xy: Tensor) -> Tensor:
    return functional.pad(xy.diff(dim=2) / STEP_SECONDS, (0, 0, 1, 0))


def _later(flags: Tensor, steps: int = 1) -> Tensor:
    return functional.pad(flags, (steps, 0))


def surroundings(steps: SampledRollout) -> Surroundings:
    """Return the surroundings of every scored step; others count whether scored or played back."""
    episode, slot, step = steps.scored.nonzero().unbind(1)
    xy, velocity, there, known = (
        value.transpose(1, 2).flatten(0, 1)  # (E x S, A): people present at once
        for value in (steps.xy, steps.velocity, steps.person >= 0, steps.known)
    )
    length = steps.xy.shape[2]
    radius = steps.radius.repeat_interleave(length, 0)
    return others_of(xy, velocity, there, known, radius, episode * length + step, slot)


def others_of(
    xy: Tensor,
    velocity: Tensor,
    there: Tensor,
    known: Tensor,
    radius: Tensor,
    moment: Tensor,
    slot: Tensor,
    smooth: bool = False,
) -> Surroundings:
    """Return the surroundings of M rows, each a slot at a moment (M,) long, with gradients.

    Positions and velocities are (N, A, 2), metres and m/s, radii (N, A), metres, of people who are ``there``
    and whose velocity is ``known`` (N, A) bool. No gradient flows through the choice of who is nearest; times
    between 0 and 10 s have some if they are ``smooth``, see `touch_seconds`.
    """
    people, parts = xy.shape[1], []
    size = max(1, _AT_ONCE // people)
    for now, me in zip(moment.split(size), slot.split(size), strict=True):
        own, body = me.unsqueeze(1), radius[now].to(xy)
        reach = body + body.gather(1, own)
        with torch.no_grad():
            away, moves = (value[now] - value[now, me].unsqueeze(1) for value in (xy, velocity))
            others = there[now].scatter(1, own, False)
            apart = torch.hypot(away[..., 0], away[..., 1]).masked_fill(~others, math.inf)
            padded = functional.pad(apart, (0, max(0, 2 - people)), value=math.inf)
            distance, two = padded.topk(2, largest=False)
            seconds = collision_seconds(away, moves, reach).masked_fill(~(others & known[now]), HORIZON)
            seconds, first = seconds.min(1)
        absent, at = distance.isinf().unsqueeze(2), (now.unsqueeze(1), two.clamp_max(people - 1))
        place = (xy[at] - xy[now, me].unsqueeze(1)).masked_fill(absent, math.inf)
        moving = (velocity[at] - velocity[now, me].unsqueeze(1)).masked_fill(absent, 0.0)
        if smooth:
            meets = ((seconds > 0) & (seconds < HORIZON)).nonzero()[:, 0]
            mine, them = (now[meets], me[meets]), (now[meets], first[meets])
            reached = reach[meets, first[meets]]
            touch = touch_seconds(xy[them] - xy[mine], velocity[them] - velocity[mine], reached)
            seconds = seconds.to(xy).index_put((meets,), touch)
        parts.append(Surroundings(place, moving, seconds, (apart < CLOSE).sum(1)))
    return Surroundings(*(torch.cat(values) for values in zip(*parts, strict=True)))


def step_features(
    now: Tensor, before: Tensor, around: Surroundings, offset: Tensor, way: Tensor
) -> dict[str, tuple[Tensor, Tensor]]:
    """Return the values of every feature of `FEATURES`, with gradients, and which rows have it (M,) bool.

    * ``speed`` and ``acceleration``, the amount of the change of velocity since the step before.
    * ``heading_rate``, to either side, of people faster than 0.1 m/s in both steps.
    * ``nearest_distance`` between centres, and ``time_to_collision``, at most 10 s; of people not alone.
    * ``lateral_deviation``, to the left of the line between start and goal, if that is long enough.

    Velocities now and the step ``before`` are (M, 2), m/s, NaN where not known; places less the line's start
    and the ``way`` to its end (M, 2), metres.
    """
    length = way.norm(dim=1)
    known, company, has_line = ~before[:, 0].isnan(), around.company, length >= LINE
    walks = (now.detach().norm(dim=1) > STANDS) & (before.detach().norm(dim=1) > STANDS)
    aside = (way[:, 0] * offset[:, 1] - way[:, 1] * offset[:, 0])[has_line] / length[has_line]
    return {
        "speed": (now.norm(dim=1), torch.ones_like(known)),
        "acceleration": ((now - before)[known].norm(dim=1) / STEP_SECONDS, known),
        "heading_rate": (turns(before[walks], now[walks]) / STEP_SECONDS, walks),
        "nearest_distance": (around.place[company, 0].norm(dim=1), company),
        "time_to_collision": (around.collision[company], company),
        "lateral_deviation": (aside, has_line),
    }


def features(steps: SampledRollout, around: Surroundings, start: Tensor, goal: Tensor) -> dict[str, Samples]:
    """Return the samples of `step_features` of a rollout, of lines from ``start`` to ``goal`` (P, 2)."""
    person, before, known = steps.person[steps.scored], *_before(steps)
    before = before.where(known.unsqueeze(1), math.nan)
    offset = steps.xy[steps.scored] - start[person]
    values = step_features(steps.velocity[steps.scored], before, around, offset, (goal - start)[person])
    return {name: Samples(value, person[which]) for name, (value, which) in values.items()}


def _before(steps: SampledRollout) -> tuple[Tensor, Tensor]:
    """Return the velocities one step before the scored ones (M, 2), and which are known (M,) bool."""
    episode, slot, step = steps.scored.nonzero().unbind(1)
    at = episode, slot, (step - 1).clamp_min(0)
    return steps.velocity[at], steps.known[at]


def turns(before: Tensor, now: Tensor) -> Tensor:
    """Return by how much headings turn to either side (M,), radians, from velocities (M, 2) to others."""
    across = before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]
    return torch.atan2(across.abs(), (before * now).sum(1))


def clips(steps: SampledRollout, around: Surroundings, start: Tensor, goal: Tensor) -> Clips:
    """Return the clips of people's walks; one begins with every scored step that has enough after it.

    ``start`` and ``goal`` (P, 2) are where the policy took each person over, and their exits, metres.
    """
    episode, slot, step = steps.scored.nonzero().unbind(1)
    person, now = steps.person[steps.scored], steps.velocity[steps.scored]
    if not len(person):
        return Clips(torch.zeros(0, LENGTH * len(CHANNELS)), person)
    way, away = (goal - start)[person], goal[person] - steps.xy[steps.scored]
    before, known = _before(steps)
    change = ((now - before) / STEP_SECONDS).where(known.unsqueeze(1), 0.0)
    value = clip_steps(now, change, around, way, away)
    row = torch.arange(len(person))  # rows of one slot are in the order of time
    begins = torch.ones_like(row, dtype=torch.bool)
    begins[1:] = torch.stack([of.diff() for of in (person, slot, episode)]).any(0) | (step.diff() != 1)
    since = row - torch.where(begins, row, 0).cummax(0).values
    last = row[since >= LENGTH - 1]
    return Clips(value[last.unsqueeze(1) + torch.arange(1 - LENGTH, 1)].flatten(1), person[last])


def clip_steps(now: Tensor, change: Tensor, around: Surroundings, way: Tensor, away: Tensor) -> Tensor:
    """Return the numbers of steps (M, C) of `CHANNELS`, with gradients.

    Of velocities and their ``change`` (M, 2), m/s and m/s^2, and the ways to the exits from where the policy
    took people over, and from where they are (M, 2), metres. Who is missing is `FAR` ahead.
    """
    has_line = (way.norm(dim=1) >= LINE).unsqueeze(1)
    ahead = functional.normalize(torch.where(has_line, way, away), dim=1).unsqueeze(1)
    missing = around.place.isinf().any(2, keepdim=True)
    place = unrotate(around.place.masked_fill(missing, 0.0), ahead)
    place = torch.where(missing, place.new_tensor([FAR, 0.0]), place)
    vectors = (unrotate(torch.stack((now, change), 1), ahead), place, unrotate(around.velocity, ahead))
    more = around.collision.unsqueeze(1), away.norm(dim=1, keepdim=True)
    return torch.cat((torch.cat(vectors, 1).flatten(1), *more), 1).float()
