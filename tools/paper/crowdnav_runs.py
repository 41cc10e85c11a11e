"""All cases with one robot's policy, from their start to their ends."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.policies.robots._base import LocalPlanner, ObservedPeople, Robot
from pedzoo.sim.crowdnav import GOES_ON, Setting, State, step

DISCOUNT = 0.9
"""Of rewards per second at 1 m/s: CrowdNav's."""


class CaseResults(NamedTuple):
    """How B cases went.

    Attributes:
        outcome: How they ended (B,) long, one of `pedzoo.sim.crowdnav`.
        seconds: When they did (B,).
        steps: How many steps they had (B,).
        path: Metres that the robot went (B,).
        reward: Discounted sum (B,).
        disturbed: Steps in which a body was nearer than the discomfort distance, at the end none (B,).
        gap: Sum of the distances in these (B,), metres.
        intruded: Steps in which the robot stood where a person would be, at the end none (B,).
        intrusion: Sum of the distances between centres in these (B,), metres.
    """

    outcome: Tensor
    seconds: Tensor
    steps: Tensor
    path: Tensor
    reward: Tensor
    disturbed: Tensor
    gap: Tensor
    intruded: Tensor
    intrusion: Tensor


@torch.no_grad()
def run(policy: LocalPlanner, setting: Setting, cases: State) -> CaseResults:
    """Return how cases go with a policy; they stay as they were.

    Args:
        policy: A new one for each call. It is asked in single precision.
        setting: The rules.
        cases: Where every person starts.

    Raises:
        ValueError: The policy's answer is not of the shape (B, 2).
    """
    state = cases.copy()
    scenes = len(cases.goal)
    outcome, seconds = torch.full((scenes,), GOES_ON), torch.zeros(scenes).double()
    sums = {name: torch.zeros_like(seconds) for name in CaseResults._fields[2:]}
    while bool((going := state.going).any()):
        robot = Robot(*(part.float() for part in state.robot))
        place, moving, radius, mask = state.known
        known = ObservedPeople(place.float(), moving.float(), radius.float(), mask)
        velocity = policy(robot, known)
        if velocity.shape != (scenes, 2):
            raise ValueError(f"the robot's policy gave velocities {tuple(velocity.shape)}, not {(scenes, 2)}")
        before, (state, events) = state, step(setting, state, velocity)
        on = state.going
        disturbed = on & (events.clearance < setting.discomfort_dist)
        intruded = on & events.intruded.isfinite()
        added = {
            "steps": torch.ones_like(seconds),
            "path": (state.robot.position - before.robot.position).norm(dim=-1),
            "reward": DISCOUNT**before.seconds * events.reward,
            "disturbed": disturbed,
            "gap": events.clearance.where(disturbed, 0),
            "intruded": intruded,
            "intrusion": events.intruded.where(intruded, 0),
        }
        sums = {name: total + torch.where(going, added[name], 0) for name, total in sums.items()}
        seconds = torch.where(going, events.seconds, seconds)
        outcome = torch.where(going, events.outcome, outcome)
    return CaseResults(outcome, seconds, **sums)
