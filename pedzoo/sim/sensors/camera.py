"""A colour camera with depth on a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.sim.physics_parts.camera import Lens
from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


class Camera(Sensor):
    """``rgb`` (B, R, H, W, 3) uint8, and ``depth`` (B, R, H, W), metres along the optical axis.

    It stands above the robot's centre and looks ahead, level; a robot does not see itself. Walls and people
    are seen as `bullet` has them, the only backend with such pictures.
    """

    def __init__(
        self,
        width: int = 64,
        height: int = 48,
        field_of_view: float = 70.0,
        eye_height: float = 0.5,
        reach: float = 10.0,
        noise: float = 0.0,
        dropout: float = 0.0,
        delay: float = 0.0,
    ) -> None:
        """Say what it sees.

        Args:
            width: W, pixels.
            height: H, pixels.
            field_of_view: From left to right, degrees.
            eye_height: Metres above the floor.
            reach: Greatest depth, metres: where nothing is nearer.
            noise: Of depths; see `Sensor`; metres.
            dropout: See `Sensor`.
            delay: See `Sensor`.

        Raises:
            UserError: A value is out of range.
        """
        super().__init__(noise, dropout, delay)
        if min(width, height) < 1 or not 0 < field_of_view < 180 or not (eye_height > 0 and reach > 0):
            raise UserError(
                f"sensor camera: width {width}, height {height}, field_of_view {field_of_view}, eye_height "
                f"{eye_height}, reach {reach}: expected pixels, degrees below 180, and metres above 0"
            )
        self.lens = Lens(width, height, math.radians(field_of_view), eye_height, reach)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        size = self.lens.height, self.lens.width
        return {
            "rgb": Reading((*size, 3), torch.uint8, low=0, high=255),
            "depth": Reading(size, low=0.0, high=self.lens.reach),
        }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        pictures = view.physics.onboard(view.bodies, view.heading, self.lens)
        rgb, depth = (torch.from_numpy(values).to(view.heading.device) for values in pictures)
        return {"rgb": rgb, "depth": depth}
