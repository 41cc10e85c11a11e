"""A planner without learning: of some constant velocities the best, while people walk on as they do.

The velocity is chosen anew at every step, as in model predictive control. B robots, S samples, N people.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.errors import check_range
from pedzoo.core.geometry import direction_of, rotate
from pedzoo.policies.robots._base import Clearance, ObservedPeople, Robot

ROUNDING = 1e-5
"""Metres by which a distance may be wrong in single precision."""


@dataclass
class Sampling:
    """The planner with settings of about 100 that did best on 500 cases of CrowdNav's validation (.998).

    Attributes:
        directions: Tried, the first one straight to the goal.
        speeds: Tried in each direction, up to the top speed; standing still is tried once more.
        horizon: Steps for which a velocity is held.
        margin: Metres of clearance from people that cost nothing.
        discount: Of each further step.
        margin_cost: Of each metre less than the margin for one second, in metres of progress.
        collision_cost: In metres of progress.
        time_step: Seconds of a step.
    """

    directions: int = 24
    speeds: int = 4
    horizon: int = 14
    margin: float = 0.25
    discount: float = 0.9
    margin_cost: float = 16.0
    collision_cost: float = 10.0
    time_step: float = 0.25

    def __post_init__(self) -> None:
        """Check the values."""
        check_range(self, "sampling", "directions speeds horizon", "1 or more", least=1)
        check_range(self, "sampling", "margin margin_cost collision_cost", "0 or more")
        check_range(self, "sampling", "discount", "above 0 and at most 1", most=1, above=True)

    def __call__(self, robot: Robot, people: ObservedPeople, walls: Clearance | None = None) -> Tensor:
        """Return the best of the sampled velocities (B, 2), m/s.

        A sample earns the distance by which the robot comes nearer to its goal, step by step, until it
        arrives or touches something. It pays for contacts, and for every moment nearer to people than the
        margin. A robot already in contact pays for going deeper. Without ``walls`` there are none.
        """
        samples = self.velocities(robot)
        steps = torch.arange(self.horizon + 1, device=samples.device, dtype=samples.dtype)
        place = robot.position[:, None, None] + samples[:, :, None] * (steps * self.time_step)[:, None]
        left = (robot.goal[:, None, None] - place).norm(dim=-1)
        gap = people_gap(robot, people, samples, self.time_step, self.horizon)
        allowed = people_gap(robot, people, torch.zeros_like(samples[:, :1]), 0.0, 1).clamp_max(0)
        near = (self.margin - gap).clamp_min(0)
        if walls is not None:
            wall_gap = walls(place.flatten(1, 2)).view(left.shape) - robot.radius[:, None, None]
            gap = gap.minimum(wall_gap[..., 1:].minimum(wall_gap[..., :-1]))
            allowed = allowed.minimum(wall_gap[:, :1, :1])
        there = left < robot.radius[:, None, None]
        touched = gap < allowed - ROUNDING
        over = (touched | there[..., 1:]).long().cumsum(-1)
        on = torch.cat((torch.zeros_like(over[..., :1]), over[..., :-1]), dim=-1) == 0
        worth = left[..., :-1] - left[..., 1:] - self.margin_cost * self.time_step * near
        worth = torch.where(touched, -self.collision_cost, worth) * self.discount ** steps[:-1]
        best = (worth * on).sum(-1).argmax(1)
        return samples[torch.arange(len(best), device=best.device), best]

    def velocities(self, robot: Robot) -> Tensor:
        """Return the sampled velocities (B, S, 2), m/s, S = directions * speeds + 1."""
        like = robot.position
        number = torch.arange(self.directions, device=like.device, dtype=like.dtype)
        angle = number * (2 * math.pi / self.directions)
        ahead = rotate(normalize(robot.goal - robot.position, dim=-1)[:, None], direction_of(angle))
        share = torch.arange(self.speeds, 0, -1, device=like.device, dtype=like.dtype) / self.speeds
        moving = (ahead[:, :, None] * share[:, None]).flatten(1, 2) * robot.v_pref[:, None, None]
        return torch.cat((moving, torch.zeros_like(moving[:, :1])), dim=1)


def people_gap(
    robot: Robot, people: ObservedPeople, samples: Tensor, time_step: float, horizon: int
) -> Tensor:
    """Return the least distances of bodies in each step (B, S, H), metres; infinite without people.

    Robots go at the velocities ``samples`` (B, S, 2), m/s, people at theirs, for ``horizon`` steps of
    ``time_step`` seconds.
    """
    if not people.mask.shape[1]:
        return samples.new_full((*samples.shape[:2], horizon), torch.inf)
    away = (people.position - robot.position[:, None])[:, None]
    move = people.velocity[:, None] - samples[:, :, None]
    speed2 = move.square().sum(-1)
    nearest = -(away * move).sum(-1) / speed2.clamp_min(1e-9)
    begin = torch.arange(horizon, device=samples.device, dtype=samples.dtype) * time_step
    at = nearest[..., None].clamp(begin, begin + time_step)
    least2 = away.square().sum(-1) - nearest.square() * speed2
    apart = (least2[..., None] + (at - nearest[..., None]).square() * speed2[..., None]).clamp_min(0).sqrt()
    bodies = (robot.radius[:, None] + people.radius)[:, None, :, None]
    return torch.where(people.mask[:, None, :, None], apart - bodies, torch.inf).amin(2)
