"""Robots' policies without learning, and the planners with which CrowdNav's tables compare. All are drop-ins.

B robots, S samples, N people.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.errors import check_range
from pedzoo.core.geometry import direction_of, limit_speed, rotate
from pedzoo.policies.robots._base import Clearance, ObservedPeople, Robot
from pedzoo.policies.rule_based.orca import OrcaSettings, agent_lines, solve

_ROUNDING = 1e-5
"""Metres by which a distance may be wrong in single precision."""


class Stop:
    """Baseline: the robot stands still."""

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return zeros (B, 2)."""
        return torch.zeros_like(robot.position)


class Straight:
    """Baseline: straight to the goal at the preferred speed, through all obstacles."""

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        return normalize(robot.goal - robot.position, dim=-1) * robot.v_pref[:, None]


@dataclass
class CrowdnavOrca:
    """Baseline: optimal reciprocal collision avoidance with CrowdNav's constants.

    It does half of the avoidance, even if people do not see it and do nothing.

    Attributes:
        time_step: Seconds for which the velocities are held.
        neighbor_dist: Metres between centres from which on people are ignored.
        max_neighbors: So many nearest people count.
        time_horizon: Seconds for which velocities are safe.
        margin: Metres by which all radii are longer than they are.
        safety_space: Further metres, which CrowdNav's users tune.
    """

    time_step: float = 0.25
    neighbor_dist: float = 10.0
    max_neighbors: int = 10
    time_horizon: float = 5.0
    margin: float = 0.01
    safety_space: float = 0.0

    def __post_init__(self) -> None:
        """Raise a `UserError` for a value out of range."""
        self.settings = OrcaSettings(
            dt=self.time_step,
            neighbor_dist=self.neighbor_dist,
            max_neighbors=self.max_neighbors,
            time_horizon=self.time_horizon,
        )

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        scenes, slots = people.mask.shape
        position, velocity, radius = (
            torch.cat((own[:, None], others), dim=1).float()
            for own, others in zip((*robot[:2], robot.radius), people[:3], strict=True)
        )
        mask = torch.cat((people.mask.new_ones(scenes, 1), people.mask), dim=1)
        position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
        rows = torch.arange(scenes, device=mask.device) * (slots + 1)
        share = torch.full_like(radius, 0.5)
        lines = agent_lines(
            position, velocity, radius + (self.margin + self.safety_space), share, mask, rows, self.settings
        )
        wanted = toward(robot.goal - robot.position).float().T.contiguous()
        return solve(lines, 0, wanted, robot.v_pref.float()).T.to(robot.position)


def toward(way: Tensor) -> Tensor:
    """Return CrowdNav's preferred velocities (..., 2): the vectors to goals, cut at 1 m/s."""
    return way / way.norm(dim=-1, keepdim=True).clamp_min(1)


@dataclass
class CrowdnavSocialForce:
    """Baseline: social forces of circles with CrowdNav++'s constants.

    The robot is driven to the goal, and pushed away from people independent of their velocities, as in
    ``crowd_nav/policy/social_force.py``. Forces of ellipses are in `pedzoo.policies.rule_based.social_force`.

    Attributes:
        time_step: Seconds for which the velocities are held.
        strength: Acceleration by a person who is touched, m/s^2 (A).
        reach: Metres in which it falls to a share of 1 / e (B).
        tau: Seconds in which the robot takes up its preferred velocity (1 / KI).
    """

    time_step: float = 0.25
    strength: float = 2.0
    reach: float = 1.0
    tau: float = 1.0

    def __post_init__(self) -> None:
        """Raise a `UserError` for a value out of range."""
        names = "time_step strength reach tau"
        check_range(self, "crowdnav_social_force", names, "a number above 0", above=True)

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        wanted = normalize(robot.goal - robot.position, dim=-1) * robot.v_pref[:, None]
        away = robot.position[:, None] - people.position
        gap = away.norm(dim=-1) - robot.radius[:, None] - people.radius
        force = self.strength * (-gap / self.reach).exp()[..., None] * normalize(away, dim=-1)
        pushed = torch.where(people.mask[..., None], force, 0).sum(1)
        velocity = robot.velocity + self.time_step * ((wanted - robot.velocity) / self.tau + pushed)
        return limit_speed(velocity, robot.v_pref)


@dataclass
class Sampling:
    """A planner without learning: of some constant velocities the best, while people walk on as they do.

    The velocity is chosen anew at every step, as in model predictive control. The settings did best of about
    100 on 500 cases of CrowdNav's validation (.998).

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
        """Raise a `UserError` for a value out of range."""
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
        touched = gap < allowed - _ROUNDING
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
