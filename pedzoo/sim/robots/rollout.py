"""The rollout of robots: episodes with robots, and the same ones without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.bodies import Fleet
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.rollout import Rollout, grown, joined


@dataclass(frozen=True, eq=False)
class RobotRollout:
    """E episodes of N people and R robots, on a trace of T points every 0.1 s.

    Attributes:
        walked: All agents, robots in the last R slots, until the last robot's episode ends. ``controlled``
            says when a robot was on its way.
        alone: The same scenes of the same seed without robots, for as long.
        heading: Where robots face (E, R, 1 + T), radians, from where the episode begins.
        person_contact: A robot touched a person in that 0.1 s (E, R, T) bool.
        robot_contact: Another robot (E, R, T) bool.
        wall_contact: A wall (E, R, T) bool.
        success: The robot reached all its goals (E, R) bool.
        timeout: Its time was up (E, R) bool.
        failed: Its action, or that of a person, was no number (E, R) bool.
        progress: Metres of the planner's ways that each agent had covered at the end (E, N + R).
        progress_alone: Likewise without robots.
        goals: That each robot had to reach.
        bodies: The limits of the robots.
    """

    walked: Rollout
    alone: Rollout
    heading: Tensor
    person_contact: Tensor
    robot_contact: Tensor
    wall_contact: Tensor
    success: Tensor
    timeout: Tensor
    failed: Tensor
    progress: Tensor
    progress_alone: Tensor
    goals: int
    bodies: Fleet

    @property
    def robots(self) -> int:
        """R."""
        return self.heading.shape[1]

    @property
    def there(self) -> Tensor:
        """When robots were on their way (E, R, T) bool: not after arriving, until their decision ends."""
        reached, scored = (value[:, -self.robots :] for value in (self.walked.reached, self.walked.scored))
        before = torch.cat((torch.zeros_like(reached[..., :1]), reached[..., :-1]), dim=2)
        return scored & (before < self.goals)

    @property
    def seconds(self) -> Tensor:
        """How long each episode took (E,), seconds."""
        return self.walked.length * TRACE_SECONDS

    def episodes(self, index: slice) -> RobotRollout:
        """Return some of the episodes."""
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        some = {name: value[index] for name, value in values.items() if isinstance(value, Tensor)}
        walks = {name: values[name].episodes(index) for name in ("walked", "alone")}
        return replace(self, **some, **walks)


def joined_robots(parts: Sequence[RobotRollout]) -> RobotRollout:
    """Join rollouts of the same robots; shorter ones stand still until the longest ends."""
    longest = max(part.walked.trace.shape[2] for part in parts)
    result: dict[str, Any] = {}
    for name in (field.name for field in fields(RobotRollout)):
        values = [getattr(part, name) for part in parts]
        if isinstance(values[0], Rollout):
            result[name] = joined(values)
        elif isinstance(values[0], Tensor):
            points, over_time = longest + (name == "heading"), values[0].dim() == 3
            result[name] = torch.cat([grown(v, points) if over_time else v for v in values])
    return replace(parts[0], **result)
