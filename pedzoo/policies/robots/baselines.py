"""Robots' policies without learning, and the planners with which CrowdNav's tables compare. All are drop-ins.

B robots, S samples, N people.
"""

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.errors import check_range
from pedzoo.core.geometry import direction_of, heading_of, limit_speed, rotate
from pedzoo.policies.robots._base import Clearance, DriveState, ObservedPeople, Robot
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


def arc(heading: Tensor, speed: Tensor, turn_rate: Tensor, seconds: Tensor | float) -> Tensor:
    """Return how far (..., 2) a constant speed, m/s, and turn rate, rad/s, lead in some seconds, metres.

    The ``heading`` (...), radians, is that at the beginning.
    """
    half = 0.5 * turn_rate * seconds
    chord = speed * seconds * torch.sinc(half / math.pi)
    return chord[..., None] * direction_of(heading + half)


@dataclass
class Dwa:
    """The dynamic window approach for differential drives, with people as discs that walk on.

    Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance", IEEE Robotics and Automation
    Magazine 4(1), 1997. A drive faces its goal at first, and its wheels follow the commands at once. It
    remembers where it faces and how it moves. Its velocities lead to the ends of its arcs.

    Attributes:
        acceleration: Forwards and backwards, m/s^2.
        turn_acceleration: Of the turn rate, rad/s^2.
        top_turn_rate: To either side, rad/s.
        speeds: Tried, from the least to the greatest that the next step can reach.
        turn_rates: Tried, likewise.
        step: Seconds between the places of an arc that are looked at.
        horizon: So many places.
        margin: Metres that are kept clear of everything.
        heading_weight: Of facing the goal after the next step (alpha in the paper).
        clearance_weight: Of the share of the horizon that is clear (beta).
        speed_weight: Of the speed (gamma).
        time_step: Seconds for which a command is held.
    """

    acceleration: float = 1.0
    turn_acceleration: float = 3.0
    top_turn_rate: float = 1.5
    speeds: int = 7
    turn_rates: int = 15
    step: float = 0.1
    horizon: int = 30
    margin: float = 0.1
    heading_weight: float = 0.8
    clearance_weight: float = 0.8
    speed_weight: float = 0.4
    time_step: float = 0.25
    _drive: DriveState | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Raise a `UserError` for a value out of range."""
        check_range(self, "dwa", "speeds turn_rates horizon", "1 or more", least=1)
        limits = "acceleration turn_acceleration top_turn_rate step time_step"
        check_range(self, "dwa", limits, "a number above 0", above=True)
        check_range(self, "dwa", "margin heading_weight clearance_weight speed_weight", "0 or more")

    def command(
        self, robot: Robot, drive: DriveState, people: ObservedPeople, walls: Clearance | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the speeds and turn rates (B,) for the next step, m/s and rad/s.

        An arc is admissible if the robot can stop before it comes nearer to anything than the margin. The
        best of these by the sum of heading, clearance and speed is taken. Without any, the robot brakes.

        Velocities of robots are ignored; people go on at theirs. Without ``walls`` there are none.
        """
        speed, turn_rate = self.window(drive, robot.v_pref)
        free = self.free_seconds(robot, drive, people, speed, turn_rate, walls)
        facing = drive.heading[:, None] + turn_rate * self.time_step
        end = robot.position[:, None] + arc(drive.heading[:, None], speed, turn_rate, self.time_step)
        off = heading_of(robot.goal[:, None] - end) - facing
        off = torch.remainder(off + math.pi, 2 * math.pi) - math.pi
        pace = speed / robot.v_pref[:, None].clamp_min(1e-9)
        clear = free / (self.horizon * self.step)
        score = self.heading_weight * (1 - off.abs() / math.pi) + self.clearance_weight * clear
        score = score + self.speed_weight * pace
        admissible = speed <= self.acceleration * free
        best = torch.where(admissible, score, clear - pace - 1e3).argmax(1, keepdim=True)
        return speed.gather(1, best)[:, 0], turn_rate.gather(1, best)[:, 0]

    def window(self, drive: DriveState, top_speed: Tensor) -> tuple[Tensor, Tensor]:
        """Return the speeds and turn rates (B, S) that can be reached in one step, S = speeds * turn_rates.

        They do not go backwards, nor faster than the ``top_speed`` (B,), m/s.
        """
        more, turn_more = (self.time_step * most for most in (self.acceleration, self.turn_acceleration))
        low, high = (drive.speed - more).clamp_min(0), (drive.speed + more).minimum(top_speed)
        left = (drive.turn_rate + turn_more).clamp_max(self.top_turn_rate)
        right = (drive.turn_rate - turn_more).clamp_min(-self.top_turn_rate)
        spans = ((low.minimum(high), high, self.speeds), (right.minimum(left), left, self.turn_rates))
        speed, turn_rate = (
            least[:, None]
            + (most - least)[:, None] * torch.linspace(0, 1, count, device=low.device, dtype=low.dtype)
            for least, most, count in spans
        )
        shape = (len(low), self.speeds, self.turn_rates)
        return speed[:, :, None].expand(shape).flatten(1), turn_rate[:, None].expand(shape).flatten(1)

    def free_seconds(
        self,
        robot: Robot,
        drive: DriveState,
        people: ObservedPeople,
        speed: Tensor,
        turn_rate: Tensor,
        walls: Clearance | None = None,
    ) -> Tensor:
        """Return for how long arcs are clear (B, S), seconds, up to the horizon.

        The other arguments are those of `command`, and the speeds (B, S), m/s, and turn rates (B, S), rad/s.
        """
        seconds = torch.arange(self.horizon + 1, device=speed.device, dtype=speed.dtype) * self.step
        moved = arc(drive.heading[:, None, None], speed[..., None], turn_rate[..., None], seconds)
        place = robot.position[:, None, None] + moved
        gap = torch.full_like(place[..., 0], torch.inf)
        if people.mask.shape[1]:
            there = people.position[:, :, None] + people.velocity[:, :, None] * seconds[:, None]
            apart = (place[:, :, None] - there[:, None]).norm(dim=-1) - people.radius[:, None, :, None]
            gap = torch.where(people.mask[:, None, :, None], apart, torch.inf).amin(2)
        if walls is not None:
            gap = gap.minimum(walls(place.flatten(1, 2)).view(gap.shape))
        gap = gap - robot.radius[:, None, None]
        least = gap[..., :1].clamp_max(self.margin)  # a robot that is nearer already may go away
        return (gap[..., 1:] >= least).to(seconds.dtype).cumprod(-1).sum(-1) * self.step

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        drive = self._drive
        if drive is None:
            still = torch.zeros_like(robot.v_pref)
            drive = DriveState(heading_of(robot.goal - robot.position), still, still)
        speed, turn_rate = self.command(robot, drive, people)
        self._drive = DriveState(drive.heading + turn_rate * self.time_step, speed, turn_rate)
        return arc(drive.heading, speed, turn_rate, self.time_step) / self.time_step
