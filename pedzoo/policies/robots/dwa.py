"""The dynamic window approach for differential drives, with people as discs that walk on.

Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance", IEEE Robotics and Automation
Magazine 4(1), 1997. B robots, S samples, N people.
"""

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from pedzoo.core.errors import check_range
from pedzoo.core.geometry import direction_of, heading_of
from pedzoo.policies.robots._base import Clearance, DriveState, ObservedPeople, Robot


def arc(heading: Tensor, speed: Tensor, turn_rate: Tensor, seconds: Tensor | float) -> Tensor:
    """Return how far (..., 2) a constant speed, m/s, and turn rate, rad/s, lead in some seconds, metres.

    The ``heading`` (...), radians, is that at the beginning.
    """
    half = 0.5 * turn_rate * seconds
    chord = speed * seconds * torch.sinc(half / math.pi)
    return chord[..., None] * direction_of(heading + half)


@dataclass
class Dwa:
    """A drive that faces its goal at first, and whose wheels follow the commands at once.

    It remembers where it faces and how it moves. Its velocities lead to the ends of its arcs.

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
