"""A planar lidar: how far it is to walls and bodies all around a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pedzoo.core.geometry import direction_of
from pedzoo.sim.robot_parts.sensor import Reading, Sensor, check_view
from pedzoo.sim.robot_parts.view import RobotView


@dataclass(eq=False)
class Lidar(Sensor):
    """``lidar`` (B, R, N): metres from the robot's centre, at most ``reach``; counterclockwise.

    Beams are spread evenly over the field of view. With 360 degrees the first one points ahead; with less it
    points to the right end of the field, the last one to the left end.

    Attributes:
        beams: N.
        reach: Metres.
        field_of_view: Degrees.
    """

    beams: int = 64
    reach: float = 5.0
    field_of_view: float = 360.0

    def __post_init__(self) -> None:
        """See `Sensor.__post_init__`."""
        super().__post_init__()
        check_view("lidar: beams", self.beams, self.reach, self.field_of_view)
        angle = math.radians(self.field_of_view)
        if self.field_of_view == 360:
            self._angles = torch.arange(self.beams) * (angle / self.beams)
        else:
            self._angles = torch.linspace(-angle / 2, angle / 2, self.beams)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"lidar": Reading((self.beams,), low=0.0, high=self.reach)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        angle = view.heading.unsqueeze(-1) + self._angles.to(view.heading.device)
        return {"lidar": view.rays(direction_of(angle), self.reach)}
