"""Baseline: social forces of circles with CrowdNav++'s constants."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import limit_speed
from pedzoo.policies.robots._base import ObservedPeople, Robot


class CrowdnavSocialForce:
    """Is driven to the goal, and pushed away from people independent of their velocities.

    Forces of circles as in CrowdNav++ (``crowd_nav/policy/social_force.py``); those of ellipses are in
    `pedzoo.policies.rule_based.social_force`.
    """

    def __init__(
        self, time_step: float = 0.25, strength: float = 2.0, reach: float = 1.0, tau: float = 1.0
    ) -> None:
        """Set the constants; the defaults are CrowdNav++'s.

        Args:
            time_step: Seconds for which the velocities are held.
            strength: Acceleration by a person who is touched, m/s^2 (A).
            reach: Metres in which it falls to a share of 1 / e (B).
            tau: Seconds in which the robot takes up its preferred velocity (1 / KI).

        Raises:
            UserError: A constant is not above 0.
        """
        if not min(time_step, strength, reach, tau) > 0:
            given = f"time_step {time_step}, strength {strength}, reach {reach}, tau {tau}"
            raise UserError(f"crowdnav_social_force: {given}: expected numbers above 0")
        self.time_step, self.strength, self.reach, self.tau = time_step, strength, reach, tau

    def __call__(self, robot: Robot, people: ObservedPeople) -> Tensor:
        """Return the velocities (B, 2), m/s."""
        wanted = normalize(robot.goal - robot.position, dim=-1) * robot.v_pref[:, None]
        away = robot.position[:, None] - people.position
        gap = away.norm(dim=-1) - robot.radius[:, None] - people.radius
        force = self.strength * (-gap / self.reach).exp()[..., None] * normalize(away, dim=-1)
        pushed = torch.where(people.mask[..., None], force, 0).sum(1)
        velocity = robot.velocity + self.time_step * ((wanted - robot.velocity) / self.tau + pushed)
        return limit_speed(velocity, robot.v_pref)
