"""How CrowdNav's people walk: ORCA to their goals, in single precision as RVO2 computes."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.policies.local_planner import ObservedPeople, Robot
from pedzoo.policies.orca.velocity import orca_velocity
from pedzoo.policies.robots.crowdnav_orca import toward
from pedzoo.sim.crowdnav.settings import MARGIN, SPEED, TIME_STEP, Setting


def people_velocity(setting: Setting, robot: Robot | None, people: ObservedPeople, goal: Tensor) -> Tensor:
    """Return the people's next velocities (B, N, 2), m/s.

    Each takes others to want nothing, but that changes no velocity: ORCA looks at those that others have.

    Args:
        setting: ORCA's parameters, and whether people see the robot.
        robot: The robot among them; None: not there.
        people: The people.
        goal: Where they go (B, N, 2), metres.
    """
    position, velocity, radius, mask = people
    wanted = toward(goal - position)
    slots = mask.shape[1]
    if setting.visible and robot is not None:
        position = torch.cat((position, robot.position[:, None]), dim=1)
        velocity = torch.cat((velocity, robot.velocity[:, None]), dim=1)
        wanted = torch.cat((wanted, torch.zeros_like(wanted[:, :1])), dim=1)
        radius = torch.cat((radius, robot.radius[:, None]), dim=1)
        mask = torch.cat((mask, torch.ones_like(mask[:, :1])), dim=1)
    chosen = orca_velocity(
        position.float(),
        velocity.float(),
        wanted.float(),
        torch.full(mask.shape, SPEED),
        mask,
        setting.orca,
        radius=radius.float() + (MARGIN + setting.safety_space),
    )
    return chosen[:, :slots].double()


def places_ahead(setting: Setting, people: ObservedPeople, goal: Tensor) -> Tensor:
    """Return where people will be (F, B, N, 2) in the next steps, if no person is replaced, metres."""
    places = []
    for _ in range(setting.foresight):
        velocity = people_velocity(setting, None, people, goal)
        people = people._replace(position=people.position + TIME_STEP * velocity, velocity=velocity)
        places.append(people.position)
    return torch.stack(places)
