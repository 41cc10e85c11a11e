"""Baseline: optimal reciprocal collision avoidance with CrowdNav's constants."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.policies.orca import OrcaSettings, agent_lines, solve
from pedzoo.policies.robots._base import ObservedPeople, Robot


class CrowdnavOrca:
    """Does half of the avoidance, even if people do not see it and do nothing."""

    def __init__(
        self,
        time_step: float = 0.25,
        neighbor_dist: float = 10.0,
        max_neighbors: int = 10,
        time_horizon: float = 5.0,
        margin: float = 0.01,
        safety_space: float = 0.0,
    ) -> None:
        """Set the constants; the defaults are those of CrowdNav's ``ORCA``.

        Args:
            time_step: Seconds for which the velocities are held.
            neighbor_dist: Metres between centres from which on people are ignored.
            max_neighbors: So many nearest people count.
            time_horizon: Seconds for which velocities are safe.
            margin: Metres by which all radii are longer than they are.
            safety_space: Further metres, which CrowdNav's users tune.

        Raises:
            UserError: A setting is out of range.
        """
        self.settings = OrcaSettings(
            dt=time_step,
            neighbor_dist=neighbor_dist,
            max_neighbors=max_neighbors,
            time_horizon=time_horizon,
        )
        self.wider = margin + safety_space

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        scenes, slots = people.mask.shape
        position = _beside(robot.position, people.position)
        velocity = _beside(robot.velocity, people.velocity)
        radius = torch.cat((robot.radius[:, None], people.radius), dim=1).float() + self.wider
        mask = torch.cat((people.mask.new_ones(scenes, 1), people.mask), dim=1)
        position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
        rows = torch.arange(scenes, device=mask.device) * (slots + 1)
        share = torch.full_like(radius, 0.5)
        lines = agent_lines(position, velocity, radius, share, mask, rows, self.settings)
        wanted = toward(robot.goal - robot.position).float().T.contiguous()
        return solve(lines, 0, wanted, robot.v_pref.float()).T.to(robot.position)


def toward(way: Tensor) -> Tensor:
    """Return CrowdNav's preferred velocities (..., 2): the vectors to goals, cut at 1 m/s."""
    return way / way.norm(dim=-1, keepdim=True).clamp_min(1)


def _beside(robot: Tensor, people: Tensor) -> Tensor:
    return torch.cat((robot[:, None], people), dim=1).float()
