"""A square of floor around a robot, seen from above: walls, and bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pedzoo.core.batch import other_agents
from pedzoo.core.errors import UserError
from pedzoo.sim.robot_parts.sensor import Reading, Sensor
from pedzoo.sim.robot_parts.view import RobotView


@dataclass(eq=False)
class Patch(Sensor):
    """``patch`` (B, R, 2, N, N): 1 where the centre of a cell is in a wall (layer 0) or in a body (layer 1).

    The robot is in the middle and faces up: rows go from ahead to behind, columns from left to right. Its own
    body is not drawn.

    Attributes:
        cells: N.
        side: Length of the square's side, metres.
    """

    cells: int = 32
    side: float = 6.4

    def __post_init__(self) -> None:
        """See `Sensor.__post_init__`."""
        super().__post_init__()
        cells, side = self.cells, self.side
        if cells < 1 or not side > 0:
            raise UserError(
                f"sensor patch: cells {cells}, side {side}: expected at least 1, and metres above 0"
            )
        across = (torch.arange(cells) + 0.5) * (side / cells) - side / 2
        self._centres = torch.stack(torch.meshgrid(-across, -across, indexing="ij"), dim=-1)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {"patch": Reading((2, self.cells, self.cells), low=0.0, high=1.0)}

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        state, robots = view.state, view.robots
        scenes, agents = state.mask.shape
        own = self._centres.to(state.past).expand(scenes, robots, self.cells, self.cells, 2)
        points = (view.world(own) + view.position[:, :, None, None]).flatten(2, 3)
        gap, _ = view.physics.bank.closest_wall(points, state.map_id, state.pose)
        away = torch.cdist(points.flatten(1, 2), state.position).view(scenes, robots, -1, agents)
        there = other_agents(state.mask, robots).unsqueeze(2)
        bodies = ((away < state.radius[:, None, None]) & there).any(-1)
        layers = torch.stack((gap <= 0, bodies), dim=2).to(points.dtype)
        return {"patch": layers.unflatten(3, (self.cells, self.cells))}
