"""A colour camera with depth on a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.sim.physics_parts.camera import Lens
from pedzoo.sim.physics_parts.state_picture import bodies_seen
from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


@dataclass(eq=False)
class Camera(Sensor):
    """``rgb`` (B, R, H, W, 3) uint8, and ``depth`` (B, R, H, W), metres along the optical axis.

    It stands above the robot's centre and looks ahead, level; a robot does not see itself. Walls and people
    are seen as `bullet` has them, the only backend with such pictures.

    Attributes:
        width: W, pixels.
        height: H, pixels.
        field_of_view: From left to right, degrees.
        eye_height: Metres above the floor.
        reach: Greatest depth, metres: where nothing is nearer.
        noise: Of depths, see `Sensor`; metres.
    """

    width: int = 64
    height: int = 48
    field_of_view: float = 70.0
    eye_height: float = 0.5
    reach: float = 10.0

    def __post_init__(self) -> None:
        """See `Sensor.__post_init__`."""
        super().__post_init__()
        width, height, angle, reach = self.width, self.height, self.field_of_view, self.reach
        if min(width, height) < 1 or not 0 < angle < 180 or not (self.eye_height > 0 and reach > 0):
            raise UserError(
                f"sensor camera: width {width}, height {height}, field_of_view {angle}, eye_height "
                f"{self.eye_height}, reach {reach}: expected pixels, degrees below 180, and metres above 0"
            )
        self.lens = Lens(width, height, math.radians(angle), self.eye_height, reach)

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
        pictures = view.physics.onboard(bodies_seen(view.state), view.heading, self.lens)
        rgb, depth = (torch.from_numpy(values).to(view.heading.device) for values in pictures)
        return {"rgb": rgb, "depth": depth}
