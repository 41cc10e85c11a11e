"""A planar lidar: how far it is to walls and bodies all around a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of
from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


class Lidar(Sensor):
    """``lidar`` (B, R, N): metres from the robot's centre, at most ``reach``; counterclockwise.

    Beams are spread evenly over the field of view. With 360 degrees the first one points ahead; with less it
    points to the right end of the field, the last one to the left end.
    """

    def __init__(
        self,
        beams: int = 64,
        reach: float = 5.0,
        field_of_view: float = 360.0,
        noise: float = 0.0,
        dropout: float = 0.0,
        delay: float = 0.0,
    ) -> None:
        """Say where it looks.

        Args:
            beams: N.
            reach: Metres.
            field_of_view: Degrees.
            noise: See `Sensor`; metres.
            dropout: See `Sensor`.
            delay: See `Sensor`.

        Raises:
            UserError: A value is out of range.
        """
        super().__init__(noise, dropout, delay)
        if beams < 1 or not reach > 0 or not 0 < field_of_view <= 360:
            raise UserError(
                f"sensor lidar: beams {beams}, reach {reach}, field_of_view {field_of_view}: expected "
                "at least 1, metres above 0, and degrees up to 360"
            )
        self.beams, self.reach = beams, reach
        angle = math.radians(field_of_view)
        if field_of_view == 360:
            self._angles = torch.arange(beams) * (angle / beams)
        else:
            self._angles = torch.linspace(-angle / 2, angle / 2, beams)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"lidar": Reading((self.beams,), low=0.0, high=self.reach)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        angle = view.heading.unsqueeze(-1) + self._angles.to(view.heading.device)
        return {"lidar": view.rays(direction_of(angle), self.reach)}
