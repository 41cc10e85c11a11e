"""The observation of CrowdNav++ (Liu et al., "Intention Aware Robot Crowd Navigation", ICRA 2023)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.sim.robot_parts.sensor import Reading
from pedzoo.sim.robot_parts.view import RobotView
from pedzoo.sim.sensors.people import People

NOT_SEEN = 15.0
"""Metres: where the rows of people say to be that are not in view."""


class AttnGraph(People):
    """The dictionary by which CrowdNav++ observes, in the frame of the world.

    ``robot_node`` (B, R, 1, 7) is x, y, radius, goal x, goal y, top speed and heading of the robot.
    ``temporal_edges`` (B, R, 1, 2) is its velocity. ``spatial_edges`` (B, R, N, 2 (P + 1)) says for people,
    nearest first, where they are from the robot's place, and where they will be in P steps if they go on as
    they do; all 15 in other rows. ``visible_masks`` (B, R, N) says which rows are people, and
    ``detected_human_num`` (B, R, 1) how many, at least 1.
    """

    def __init__(
        self,
        most: int = 20,
        reach: float = 5.0,
        field_of_view: float = 360.0,
        predicted: int = 5,
        seconds: float = 0.25,
    ) -> None:
        """Say which people are seen, and how far they are predicted.

        Args:
            most: N.
            reach: See `People`.
            field_of_view: See `People`.
            predicted: P, steps ahead; 0 for where people are alone, as in DS-RNN.
            seconds: Of one of them.

        Raises:
            UserError: A value is out of range.
        """
        super().__init__(most, reach, field_of_view)
        if predicted < 0 or not seconds > 0:
            raise UserError(
                f"sensor attn_graph: predicted {predicted}, seconds {seconds}: expected at least 0, above 0"
            )
        self.predicted, self.seconds = predicted, seconds

    @property
    def readings(self) -> Mapping[str, Reading]:
        """See `Sensor.readings`."""
        return {
            "robot_node": Reading((1, 7)),
            "temporal_edges": Reading((1, 2)),
            "spatial_edges": Reading((self.most, 2 * (self.predicted + 1))),
            "visible_masks": Reading((self.most,), torch.bool),
            "detected_human_num": Reading((1,), low=1.0, high=float(self.most)),
        }

    def read(self, view: RobotView) -> dict[str, Tensor]:
        """See `Sensor.read`."""
        seen, last = super().read(view), slice(-view.robots, None)
        rows, mask, state = seen["people"], seen["people_mask"], view.state
        place, velocity = view.world(rows[..., 0:2]), view.world(rows[..., 2:4])
        ahead = self.seconds * torch.arange(self.predicted + 1, device=rows.device)
        edges = place.unsqueeze(3) + velocity.unsqueeze(3) * ahead.view(-1, 1)
        own = (state.radius, state.goal_point, state.top_speed, state.heading)
        own = [value[:, last] if value.dim() == 3 else value[:, last, None] for value in own]
        return {
            "robot_node": torch.cat((view.position, *own), -1).unsqueeze(2),
            "temporal_edges": state.velocity[:, last].unsqueeze(2),
            "spatial_edges": torch.where(mask.unsqueeze(-1), edges.flatten(3), NOT_SEEN),
            "visible_masks": mask,
            "detected_human_num": mask.sum(-1, keepdim=True).clamp_min(1).to(rows.dtype),
        }
