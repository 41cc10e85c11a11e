"""The people and other robots around a robot, as a set: nearest first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pedzoo.core.batch import other_agents
from pedzoo.sim.robot_parts.sensor import Reading, Sensor, check_view
from pedzoo.sim.robot_parts.view import RobotView


@dataclass(eq=False)
class People(Sensor):
    """``people`` (B, R, N, 5): x, y, vx, vy in the robot's frame, and radius; ``people_mask`` (B, R, N) bool.

    Metres and m/s; velocities are those over the ground. Rows beyond the agents in view are 0 and masked.

    Attributes:
        most: N, the nearest ones.
        reach: Metres between centres.
        field_of_view: Degrees, half of it to either side.
        line_of_sight: Agents behind walls are not seen.
    """

    most: int = 10
    reach: float = 10.0
    field_of_view: float = 360.0
    line_of_sight: bool = False

    def __post_init__(self) -> None:
        """See `Sensor.__post_init__`."""
        super().__post_init__()
        check_view("people: most", self.most, self.reach, self.field_of_view)
        self.half_angle = math.radians(self.field_of_view / 2)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"people": Reading((self.most, 5)), "people_mask": Reading((self.most,), torch.bool)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        state, robots = view.state, view.robots
        scenes, agents = state.mask.shape
        shape = (scenes, robots, agents, 2)
        place = view.own_places(state.position.unsqueeze(1).expand(shape))
        distance = torch.linalg.vector_norm(place, dim=-1)
        seen = other_agents(state.mask, robots) & (distance <= self.reach)
        if self.half_angle < math.pi:
            seen = seen & (torch.atan2(place[..., 1], place[..., 0]).abs() <= self.half_angle)
        if self.line_of_sight:
            direction = view.world(place) / distance.clamp_min(1e-6).unsqueeze(-1)
            free = view.rays(direction, min(self.reach, view.physics.bank.max_distance), people=False)
            seen = seen & (free >= (distance - state.radius.unsqueeze(1)).clamp_max(free.max()))
        count = min(self.most, agents)
        nearest = torch.where(seen, distance, torch.inf).topk(count, largest=False).indices
        velocity = view.own(state.velocity.unsqueeze(1).expand(shape))
        rows = torch.cat((place, velocity, state.radius[:, None, :, None].expand(*shape[:3], 1)), -1)
        mask = seen.gather(2, nearest)
        rows = rows.gather(2, nearest.unsqueeze(-1).expand(*nearest.shape, 5)) * mask.unsqueeze(-1)
        missing = self.most - count
        return {
            "people": torch.nn.functional.pad(rows, (0, 0, 0, missing)),
            "people_mask": torch.nn.functional.pad(mask, (0, missing)),
        }
