"""Losses on a segment of an episode, differentiable all the way to the network.

Each term is a mean over the people that the policy moves: it means the same in every scenario. A hinge x
counts x + x^2, so that neither small nor large contacts have a small gradient.
"""

from functools import partial

import torch
from torch import Tensor
from torch.nn import functional

from pedzoo.core.errors import at_least_zero
from pedzoo.core.geometry import are_opposed, closest_fraction
from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.train.closed_loop.segments import Segment

_SOON = 6.0  # seconds of delay that count 1
_FAR = 1e3  # metres to the nearest other where there is no other agent
_MEETING = 2.0  # m/s relative to each other: two people who come from the front at an easy pace

_MEET, _BESIDE, _APART = 4.0, 1.2, 0.5
"""Metres ahead and beside within which people meet others from the front, and to the side that is enough."""


class LoopLosses:
    """The terms and their weights."""

    def __init__(
        self,
        progress: float = 1.0,
        person_distance: float = 10.0,
        people_margin: float = 0.2,
        meeting_margin: float = 0.0,
        walls: float = 20.0,
        wall_margin: float = 0.08,
        overspeed: float = 2.0,
        overspeed_from: float = 1.02,
        effort: float = 0.05,
        safety_correction: float = 0.0,
        assertiveness: float = 0.5,
        passing_side: float = 0.0,
    ) -> None:
        """Weigh the terms.

        A metre too near must cost more than some seconds of waiting, or agents squeeze past each other.

        Args:
            progress: Time that people lose on their paths to goals, mean over the segment, in units of 6 s.
            person_distance: Distance to others, metres short of ``2 * body_radius + people_margin``, least
                of a step.
            people_margin: Metres.
            meeting_margin: Metres more between two who pass each other at 2 m/s or faster, and in proportion
                less at lower speeds: people who walk together come closer than people who meet.
            walls: Distance to walls, metres short of ``body_radius + wall_margin``, at four places of a step.
            wall_margin: Metres.
            overspeed: m/s above ``overspeed_from`` times the preferred speed.
            overspeed_from: Share of the preferred speed.
            effort: Squared change of velocity from step to step, (m/s)^2.
            safety_correction: Change by a safety layer, m/s.
            assertiveness: An agent's lost time counts ``exp(assertiveness * z)`` times as much, where z is
                the first number of its noise. 0: no effect of the noise.
            passing_side: Metres that agents from the front are off the side that the second number z of an
                agent's noise prefers, times abs(tanh(z)), see `wrong_side`.

        Raises:
            UserError: A negative weight.
        """
        weights = {key: value for key, value in locals().items() if key != "self"}
        at_least_zero("losses of walking: ", **weights)
        self.progress, self.walls, self.effort = progress, walls, effort
        self.person_distance, self.people_margin = person_distance, people_margin
        self.safety_correction, self.meeting_margin = safety_correction, meeting_margin
        self.wall_margin, self.passing_side = wall_margin, passing_side
        self.overspeed, self.overspeed_from = overspeed, overspeed_from
        self.assertiveness = assertiveness

    def __call__(self, segment: Segment, bank: MapBank, noise: Tensor | None = None) -> dict[str, Tensor]:
        """Return the weighted terms of a walk on floor plans, scalars.

        ``noise`` is that of each person when the segment begins (B, A, Z): how assertive they are, and on
        which side they like to pass.
        """
        mean = partial(mean_cost, moved=segment.moved)

        speed = segment.asked.square().sum(-1).clamp_min(1e-12).sqrt()
        short = self.people_margin - least_gaps(segment, self.meeting_margin)
        weight = None if noise is None else torch.exp(self.assertiveness * noise[..., 0].clamp(-2, 2))
        terms = {
            "progress": self.progress * lost_seconds(segment, weight) / _SOON,
            "person_distance": self.person_distance * mean(_hinge(short)),
            "overspeed": self.overspeed * mean(_hinge(speed - self.overspeed_from * segment.pref_speed)),
            "effort": self.effort * mean((segment.action - segment.velocity).square().sum(-1)),
        }
        if self.safety_correction:
            change = (segment.asked - segment.action).square().sum(-1).clamp_min(1e-8).sqrt()
            terms["safety_correction"] = self.safety_correction * mean(change)
        if bank.grids:
            near = segment.radius.unsqueeze(-1) + self.wall_margin - wall_distances(segment, bank)
            terms["walls"] = self.walls * mean(_hinge(near).mean(-1))
        if self.passing_side and noise is not None and noise.shape[-1] > 1:
            terms["passing_side"] = self.passing_side * mean(wrong_side(segment, noise[..., 1]))
        return terms


def mean_cost(cost: Tensor, moved: Tensor) -> Tensor:
    """Return the mean cost of decisions (T, B, A), a scalar: over the segment and the ``moved`` people."""
    # by people and not by their steps: people who dawdle must not dilute contacts
    count = (moved.any(0).sum() * len(moved)).clamp_min(1)
    return torch.where(moved, cost, 0.0).sum() / count


def _hinge(short: Tensor) -> Tensor:
    short = short.clamp_min(0)
    return short + short.square()


def lost_seconds(segment: Segment, weight: Tensor | None = None) -> Tensor:
    """Return how late people are, seconds, a scalar: mean over the segment and the people, by weight (B, A).

    The time for the path that they made, at their preferred speed, is taken off. Agents that arrive early get
    credit for the rest of the segment.
    """
    took_part = segment.moved.any(0)
    gained = (segment.progress / segment.pref_speed.clamp_min(0.1)).where(segment.moved, 0.0).cumsum(0)
    steps = torch.arange(1, len(gained) + 1, device=gained.device, dtype=gained.dtype)
    late = (STEP_SECONDS * steps.view(-1, 1, 1) - gained).mean(0)
    if weight is not None:
        late = late * weight
    return torch.where(took_part, late, 0.0).sum() / took_part.sum().clamp_min(1)


def wrong_side(segment: Segment, side: Tensor) -> Tensor:
    """Return the cost of people from the front on the side that a person does not prefer (T, B, A).

    People with a positive ``side`` (B, A) prefer to pass others on the left: these are on their right.
    """
    here, present = segment.trace[..., 0, :], segment.present
    ahead = functional.normalize(segment.goal - here, dim=-1)
    away = here.unsqueeze(-3) - here.unsqueeze(-2)  # (T, B, A, A, 2): from each to each other
    mine = ahead.unsqueeze(-2)
    before = (away * mine).sum(-1)
    left = mine[..., 0] * away[..., 1] - mine[..., 1] * away[..., 0]
    meet = are_opposed(ahead) & (before > 0) & (before < _MEET) & (left.abs() < _BESIDE)
    meet &= present.unsqueeze(-1) & present.unsqueeze(-2)
    like = side.tanh().unsqueeze(-1)
    cost = like.abs() * (_APART + like.sign() * left).clamp_min(0)
    return torch.where(meet, cost, 0.0).amax(-1)


def least_gaps(segment: Segment, meeting_margin: float = 0.0) -> Tensor:
    """Return how close the nearest other's body comes in every step (T, B, A), metres; far without others.

    Along the straight steps that the policy asks for: behind the safety layer the network would not learn to
    give way. Two people who pass each other at 2 m/s or faster need ``meeting_margin`` metres more.
    """
    here, present = segment.trace[..., 0, :], segment.present
    people = here.shape[2]
    if people < 2:
        return here.new_full(here.shape[:3], _FAR)
    way = torch.where(
        segment.moved.unsqueeze(-1), segment.asked * STEP_SECONDS, segment.trace[..., -1, :] - here
    )
    begin, move = (values.unsqueeze(2) - values.unsqueeze(3) for values in (here, way))  # (T, B, A, A, 2)
    closest = begin + closest_fraction(begin, move).unsqueeze(-1) * move
    bodies = segment.radius.unsqueeze(2) + segment.radius.unsqueeze(3)
    gap = (closest.square().sum(-1) + 1e-8).sqrt() - bodies
    if meeting_margin:
        speed = move.detach().norm(dim=-1) / STEP_SECONDS
        gap = gap - meeting_margin * (speed / _MEETING).clamp_max(1)
    absent = ~(present.unsqueeze(2) & present.unsqueeze(3)) | torch.eye(
        people, dtype=torch.bool, device=here.device
    )
    return gap.masked_fill(absent, _FAR).amin(-1)


def wall_distances(segment: Segment, bank: MapBank, points: int = 4) -> Tensor:
    """Return the distances to walls (T, B, A, points) along the ways that people ask for, metres.

    Not where walls let them: agents that slide along a wall still get a direction.
    """
    steps, scenes, people = segment.moved.shape
    part = torch.arange(1, points + 1, device=segment.asked.device) * (STEP_SECONDS / points)
    here = segment.trace[..., :1, :]
    way = here + segment.asked.unsqueeze(-2) * part.view(-1, 1)
    rows = way.transpose(0, 1).reshape(scenes, -1, 2)
    result = bank.signed_distance(rows, segment.map_id, segment.pose)
    return result.view(scenes, steps, people, points).transpose(0, 1)
