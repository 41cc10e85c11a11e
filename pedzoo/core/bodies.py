"""The body of a robot: its size, how it drives, and its limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, limit_speed, rotate

HOLONOMIC, UNICYCLE, DIFF_DRIVE = range(3)
"""How a body moves: in any direction, along its heading, or on two wheels; see `pedzoo.sim.dynamics`."""

DRIVES = {"holonomic": HOLONOMIC, "unicycle": UNICYCLE, "diff_drive": DIFF_DRIVE}
"""How a robot drives, and the number of it in `pedzoo.sim.state.State.drive`."""

LEAST_RADIUS = 0.01
"""Minimum radius of a body, metres: walls are as soft as this."""


@dataclass(frozen=True)
class RobotBody:
    """A robot is a disc with a drive and limits.

    A robot by name is a subclass in `pedzoo.sim.robots.bodies`, or ``file.py:Class``, with other defaults.

    Attributes:
        drive: ``holonomic``: an action is (forward, left), m/s, in the robot's frame. ``unicycle``: (speed,
            turning rate), m/s and rad/s. ``diff_drive``: speeds of the wheels (left, right), m/s.
        source: Where the numbers of a robot that can be bought are from.
        radius: Of the disc around its footprint, metres.
        top_speed: Greatest speed, m/s.
        top_turn: Greatest turning rate, rad/s; it does not concern holonomic robots.
        acceleration: Greatest change of speed, m/s^2; ``inf`` for any.
        turn_acceleration: Greatest change of the turning rate, rad/s^2.
        track: Distance between the wheels, metres.
        reverse: It may drive backwards.
    """

    drive: ClassVar[str] = "holonomic"
    source: ClassVar[str] = ""

    radius: float = 0.3
    top_speed: float = 1.0
    top_turn: float = 2.0
    acceleration: float = math.inf
    turn_acceleration: float = math.inf
    track: float = 0.4
    reverse: bool = True

    def __post_init__(self) -> None:
        """Check the values. Raises UserError: one is out of range."""
        if self.drive not in DRIVES:
            raise UserError(
                f"drive {self.drive!r} of {type(self).__name__}: expected one of {', '.join(DRIVES)}"
            )
        if not LEAST_RADIUS < self.radius < 5:
            raise UserError(f"robot radius {self.radius}: expected metres between {LEAST_RADIUS} and 5")
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, bool) and not value > 0:
                raise UserError(f"robot {field.name} {value}: expected a number above 0")

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The least and the greatest value of both parts of an action."""
        back = -self.top_speed if self.reverse else 0.0
        if self.drive == "holonomic":
            return (-self.top_speed, self.top_speed), (-self.top_speed, self.top_speed)
        if self.drive == "unicycle":
            return (back, self.top_speed), (-self.top_turn, self.top_turn)
        wheel = self.top_speed + 0.5 * self.track * self.top_turn
        return (-wheel, wheel), (-wheel, wheel)


class Fleet(NamedTuple):
    """The bodies of R robots as tensors (R,), or of those of B scenes (B, R); units as of `RobotBody`.

    ``drive`` is `HOLONOMIC`, `UNICYCLE` or `DIFF_DRIVE`, long. ``slowest`` is the least speed, m/s: 0 for
    robots that do not drive backwards.
    """

    drive: Tensor
    radius: Tensor
    top_speed: Tensor
    top_turn: Tensor
    acceleration: Tensor
    turn_acceleration: Tensor
    track: Tensor
    slowest: Tensor

    @classmethod
    def of(cls, bodies: list[RobotBody]) -> Fleet:
        """Return the tensors of some bodies."""
        values = {
            name: torch.tensor([float(getattr(one, name)) for one in bodies]) for name in cls._fields[1:-1]
        }
        slowest = torch.tensor([-body.top_speed if body.reverse else 0.0 for body in bodies])
        drive = torch.tensor([DRIVES[body.drive] for body in bodies])
        return cls(drive=drive, slowest=slowest, **values)

    def to(self, device: torch.device | str) -> Fleet:
        """Return the tensors on a device."""
        return Fleet(*(value.to(device) for value in self))

    def commands(self, action: Tensor, heading: Tensor) -> Tensor:
        """Return what the kernel takes (B, R, 2) for actions (B, R, 2), within the robots' limits.

        The kernel takes world velocities of holonomic robots, (speed, turning rate) of unicycles and wheel
        speeds of differential drives. NaN stays NaN: the kernel ends such a scene as failed.

        Args:
            action: In the robots' frames, see `RobotBody`.
            heading: Of the robots (B, R), radians.
        """
        shortened = torch.where(action.isfinite(), limit_speed(action, self.top_speed), action)
        free = rotate(shortened, direction_of(heading))
        speed, turn = self.speed_of(action)
        driven = self.from_speed(
            speed.clamp(self.slowest, self.top_speed), turn.clamp(-self.top_turn, self.top_turn)
        )
        return torch.where((self.drive == HOLONOMIC).unsqueeze(-1), free, driven)

    def from_speed(self, speed: Tensor, turn: Tensor) -> Tensor:
        """Return actions (..., R, 2) of robots with wheels that drive at ``speed`` and ``turn`` (..., R)."""
        half = 0.5 * self.track * turn
        wheels = torch.stack((speed - half, speed + half), dim=-1)
        return torch.where((self.drive == DIFF_DRIVE).unsqueeze(-1), wheels, torch.stack((speed, turn), -1))

    def speed_of(self, action: Tensor) -> tuple[Tensor, Tensor]:
        """Return speeds and turning rates (..., R) of robots with wheels: the inverse of `from_speed`."""
        return speed_and_turn(action.unbind(-1), self.drive, self.track)


def speed_and_turn(command: Iterable[Tensor], drive: Tensor, track: Tensor) -> tuple[Tensor, Tensor]:
    """Return the speeds and turning rates (...) that the two parts (...) of commands to wheels ask for."""
    first, second = command
    pair, turn = drive == DIFF_DRIVE, (second - first) / track
    return torch.where(pair, 0.5 * (first + second), first), torch.where(pair, turn, second)
