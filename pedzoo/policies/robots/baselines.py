"""Baselines of robots, and the planners with which CrowdNav's tables compare. All are drop-ins."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.errors import check_range
from pedzoo.core.geometry import limit_speed
from pedzoo.policies.robots._base import ObservedPeople, Robot
from pedzoo.policies.rule_based.orca import OrcaSettings, agent_lines, solve


class Stop:
    """Baseline: the robot stands still."""

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return zeros (B, 2)."""
        return torch.zeros_like(robot.position)


class Straight:
    """Baseline: straight to the goal at the preferred speed, through all obstacles."""

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        return normalize(robot.goal - robot.position, dim=-1) * robot.v_pref[:, None]


@dataclass
class CrowdnavOrca:
    """Baseline: optimal reciprocal collision avoidance with CrowdNav's constants.

    It does half of the avoidance, even if people do not see it and do nothing.

    Attributes:
        time_step: Seconds for which the velocities are held.
        neighbor_dist: Metres between centres from which on people are ignored.
        max_neighbors: So many nearest people count.
        time_horizon: Seconds for which velocities are safe.
        margin: Metres by which all radii are longer than they are.
        safety_space: Further metres, which CrowdNav's users tune.
    """

    time_step: float = 0.25
    neighbor_dist: float = 10.0
    max_neighbors: int = 10
    time_horizon: float = 5.0
    margin: float = 0.01
    safety_space: float = 0.0

    def __post_init__(self) -> None:
        """Check the constants, as those of people."""
        self.settings = OrcaSettings(
            dt=self.time_step,
            neighbor_dist=self.neighbor_dist,
            max_neighbors=self.max_neighbors,
            time_horizon=self.time_horizon,
        )

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        scenes, slots = people.mask.shape
        position, velocity, radius = (
            torch.cat((own[:, None], others), dim=1).float()
            for own, others in zip((*robot[:2], robot.radius), people[:3], strict=True)
        )
        mask = torch.cat((people.mask.new_ones(scenes, 1), people.mask), dim=1)
        position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
        rows = torch.arange(scenes, device=mask.device) * (slots + 1)
        share = torch.full_like(radius, 0.5)
        lines = agent_lines(
            position, velocity, radius + (self.margin + self.safety_space), share, mask, rows, self.settings
        )
        wanted = toward(robot.goal - robot.position).float().T.contiguous()
        return solve(lines, 0, wanted, robot.v_pref.float()).T.to(robot.position)


def toward(way: Tensor) -> Tensor:
    """Return CrowdNav's preferred velocities (..., 2): the vectors to goals, cut at 1 m/s."""
    return way / way.norm(dim=-1, keepdim=True).clamp_min(1)


@dataclass
class CrowdnavSocialForce:
    """Baseline: social forces of circles with CrowdNav++'s constants.

    The robot is driven to the goal, and pushed away from people independent of their velocities, as in
    ``crowd_nav/policy/social_force.py``. Forces of ellipses are in `pedzoo.policies.rule_based.social_force`.

    Attributes:
        time_step: Seconds for which the velocities are held.
        strength: Acceleration by a person who is touched, m/s^2 (A).
        reach: Metres in which it falls to a share of 1 / e (B).
        tau: Seconds in which the robot takes up its preferred velocity (1 / KI).
    """

    time_step: float = 0.25
    strength: float = 2.0
    reach: float = 1.0
    tau: float = 1.0

    def __post_init__(self) -> None:
        """Check the constants, which are to be above 0."""
        names = "time_step strength reach tau"
        check_range(self, "crowdnav_social_force", names, "a number above 0", above=True)

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        wanted = normalize(robot.goal - robot.position, dim=-1) * robot.v_pref[:, None]
        away = robot.position[:, None] - people.position
        gap = away.norm(dim=-1) - robot.radius[:, None] - people.radius
        force = self.strength * (-gap / self.reach).exp()[..., None] * normalize(away, dim=-1)
        pushed = torch.where(people.mask[..., None], force, 0).sum(1)
        velocity = robot.velocity + self.time_step * ((wanted - robot.velocity) / self.tau + pushed)
        return limit_speed(velocity, robot.v_pref)
