"""Baseline: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009), walls or not."""

from typing import Any

import torch
from tensordict import TensorDictBase

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, ids_of, maps_of
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.bank import FASTEST, WallSegments
from pedzoo.policies.neighbours import separation_push
from pedzoo.policies.orca import OrcaSettings, orca_velocity
from pedzoo.policies.policy import Policy, deterministic, drawn_vectors

OFF_SPOT = 0.05
"""Of the way by which people leave the spot of others: so far off it they are seen."""


class Orca(Policy):
    """Agents take half of the avoidance, and all of it for agents that this policy does not move.

    The preferred velocity is the planner's desired one. Robots, and other bodies that the policy does not
    move, count with their own radius.

    Mirror-image people with the same preferred velocity stop for ever. A small ``jitter`` of the preferred
    velocity, usual with RVO2, frees most of them. Deterministic policies draw it once for each person.
    """

    def __init__(self, settings: OrcaSettings = OrcaSettings()) -> None:
        """Take the settings."""
        super().__init__(settings.dt)
        self.settings = settings

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the velocities of all agents."""
        agents: Any = tensordict["agents"]
        mask = agents["mask"]
        position = agents["history"][:, :, -1] + OFF_SPOT * separation_push(tensordict)
        scenes, slots = mask.shape
        top_speed = agents["pref_speed"][..., 0] * self.settings.top_speed_ratio
        wanted = agents["desired_velocity"]
        if self.settings.jitter:
            scene, step = tensordict["scene_key"], (tensordict["time"] / TRACE_SECONDS).round().long()
            if deterministic():  # what is drawn for people once, whatever the scene
                scene, step = torch.zeros_like(scene), torch.zeros_like(step)
            key = randomness.join(scene, "orca", step, ids_of(tensordict))
            wanted = wanted + self.settings.jitter * drawn_vectors(tensordict, key)
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
