"""Crowds of CrowdNav that do not see the robot: computed once, then looked up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.sim.crowdnav.cases import cases
from pedzoo.sim.crowdnav.people import people_velocity
from pedzoo.sim.crowdnav.rules import begin, replaced
from pedzoo.sim.crowdnav.settings import EARLY, TIME_STEP, Setting

_AT_ONCE = 512
"""Crowds that walk together: each keeps 8192 drawn numbers."""


class Crowds(NamedTuple):
    """C crowds of N people for T steps of `TIME_STEP`, until the time is up.

    Attributes:
        place: Where people are (C, T + 1, N, 2), metres.
        velocity: Theirs (C, T + 1, N, 2), m/s.
        start: Of the robot (C, 2), metres.
        goal: Of the robot (C, 2), metres.
    """

    place: Tensor
    velocity: Tensor
    start: Tensor
    goal: Tensor

    @property
    def steps(self) -> int:
        """T."""
        return self.place.shape[1] - 1

    def ahead(self, crowd: Tensor, clock: Tensor, steps: int) -> Tensor:
        """Return where people will be (B, F, N, 2) in the next F ``steps``, metres.

        Args:
            crowd: Which crowds (B,) long.
            clock: How many steps they have walked (B,) long.
            steps: F; 0 for none.
        """
        later = clock.unsqueeze(1) + torch.arange(1, steps + 1)
        return self.place[crowd.unsqueeze(1), later.clamp_max(self.steps)]


def walked(setting: Setting, seeds: Sequence[int]) -> Crowds:
    """Return the crowds that are drawn from seeds.

    Where people who arrive are replaced, new ones keep clear of the robot's start and goal alone.
    """
    parts = []
    for first in range(0, len(seeds), _AT_ONCE):
        state = begin(setting, cases(setting, seeds[first : first + _AT_ONCE]))
        places, velocities = [state.people.position], [state.people.velocity]
        for _ in range(round((setting.time_limit - EARLY) / TIME_STEP)):
            velocity = people_velocity(setting, None, state.people, state.goal)
            place = state.people.position + TIME_STEP * velocity
            state = state._replace(people=state.people._replace(position=place, velocity=velocity))
            if setting.replaced:
                state = replaced(setting, state)
            places.append(state.people.position)
            velocities.append(state.people.velocity)
        errand = state.robot.position.float(), state.robot.goal.float()
        parts.append((torch.stack(places, 1).float(), torch.stack(velocities, 1).float(), *errand))
    return Crowds(*(torch.cat(values) for values in zip(*parts, strict=True)))
