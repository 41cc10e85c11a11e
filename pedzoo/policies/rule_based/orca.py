"""Baseline: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009), walls or not."""

from typing import Any

import torch
from tensordict import TensorDictBase

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, ids_of, maps_of
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.walls.segments import FASTEST, WallSegments
from pedzoo.policies.base import deterministic
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.policies.orca.velocity import orca_velocity
from pedzoo.policies.policy import Policy


class Orca(Policy):
    """Agents take half of the avoidance, and all of it for agents that this policy does not move.

    The preferred velocity is the planner's desired one. Robots, and other bodies that the policy does not
    move, count with their own radius.

    Mirror-image people with the same preferred velocity stop for ever. A small ``jitter`` of the preferred
    velocity, usual with RVO2, frees most of them. Deterministic policies have none.
    """

    def __init__(self, settings: OrcaSettings = OrcaSettings()) -> None:
        """Take the settings."""
        super().__init__(settings.dt)
        self.settings = settings

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the velocities of all agents."""
        agents: Any = tensordict["agents"]
        position, mask = agents["history"][:, :, -1], agents["mask"]
        scenes, slots = mask.shape
        top_speed = agents["pref_speed"][..., 0] * self.settings.top_speed_ratio
        wanted = agents["desired_velocity"]
        if self.settings.jitter and not deterministic():
            step = (tensordict["time"] / TRACE_SECONDS).round().long()
            key = randomness.join(tensordict["scene_key"], "orca", step, ids_of(tensordict))
            key = randomness.join(key.unsqueeze(-1), torch.arange(2, device=key.device))
            wanted = wanted + self.settings.jitter * randomness.normal(key)
        walls = None
        body, controlled = agents["radius"][..., 0], agents["controlled"]
        radius = self.settings.radii(body, agents["kind"] == ROBOT, controlled)
        if self.settings.walls:
            map_id = tensordict["map_id"].expand(scenes, slots).flatten()
            pose = tensordict["scene_pose"].repeat_interleave(slots, 0)
            reach = self.settings.wall_reach(top_speed, radius).flatten()
            farthest = self.settings.time_horizon_obst * FASTEST
            segments = WallSegments(maps_of(tensordict), self.settings.max_obstacles, farthest)
            walls = segments.near(position.flatten(0, 1), map_id, pose, reach)
        velocity = orca_velocity(
            position,
            agents["velocity"],
            wanted,
            top_speed,
            mask,
            self.settings,
            walls,
            passive=mask & ~controlled,
            radius=radius,
        )
        tensordict["agents", "action"] = velocity
        return tensordict
