"""Baseline: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009), walls or not."""

from __future__ import annotations

from typing import Any, Literal

import torch
from tensordict import TensorDictBase

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, ids_of, maps_of
from pedzoo.core.errors import UserError
from pedzoo.core.types import TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.walls.segments import FASTEST, WallSegments
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.policies.orca.velocity import orca_velocity
from pedzoo.policies.policy import Policy


class Orca(Policy):
    """Agents take half of the avoidance, and all of it for agents that this policy does not move.

    The preferred velocity is the planner's desired one. Robots, and other bodies that the policy does not
    move, count with their own radius.

    People who have the same preferred velocity and are each other's mirror image stop for ever: a small
    ``jitter`` of the preferred velocity, usual with RVO2, frees most of them.
    """

    def __init__(
        self,
        radius: float | None = None,
        walls: bool = True,
        dt: float = TRACE_SECONDS,
        jitter: float = 0.02,
        preset: Literal["pedzoo", "igibson"] = "pedzoo",
        neighbor_dist: float | None = None,
        max_neighbors: int | None = None,
        time_horizon: float | None = None,
        time_horizon_obst: float | None = None,
        max_obstacles: int | None = None,
        top_speed_ratio: float | None = None,
    ) -> None:
        """Set the constants; what is not given is the preset's.

        Args:
            radius: Of the disk of every person that it moves, metres; others have their own.
            walls: Whether walls are avoided. iGibson's ORCA never sees them.
            dt: Seconds between decisions.
            jitter: Standard deviation of noise on the preferred velocity, m/s.
            preset: ``pedzoo``, or ``igibson`` for the constants of iGibson's social navigation.
            neighbor_dist: Metres from which on others are ignored.
            max_neighbors: So many nearest others are heeded.
            time_horizon: Seconds for which velocities are safe with respect to others.
            time_horizon_obst: And with respect to walls.
            max_obstacles: So many nearest wall segments are heeded.
            top_speed_ratio: Top speed, divided by the preferred one; iGibson's people have no other.

        Raises:
            UserError: A setting is out of range.
        """
        names = OrcaSettings.__dataclass_fields__
        given = {name: value for name, value in locals().items() if name in names and value is not None}
        super().__init__(dt)
        if top_speed_ratio is None:
            top_speed_ratio = 1.0 if preset == "igibson" else TOP_SPEED_RATIO
        if jitter < 0 or top_speed_ratio <= 0:
            raise UserError(f"orca: jitter {jitter}, top_speed_ratio {top_speed_ratio}: expected >= 0, > 0")
        self.settings = OrcaSettings.preset(preset, time_step=dt, **given)
        self.jitter, self.top_speed_ratio = jitter, top_speed_ratio
        self._sees_walls = walls

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the velocities of all agents."""
        agents: Any = tensordict["agents"]
        position, mask = agents["history"][:, :, -1], agents["mask"]
        scenes, slots = mask.shape
        top_speed = agents["pref_speed"][..., 0] * self.top_speed_ratio
        wanted = agents["desired_velocity"]
        if self.jitter:
            step = (tensordict["time"] / TRACE_SECONDS).round().long()
            key = randomness.join(tensordict["scene_key"], "orca", step, ids_of(tensordict))
            key = randomness.join(key.unsqueeze(-1), torch.arange(2, device=key.device))
            wanted = wanted + self.jitter * randomness.normal(key)
        walls = None
        body, controlled = agents["radius"][..., 0], agents["controlled"]
        radius = self.settings.radii(body, agents["kind"] == ROBOT, controlled)
        if self._sees_walls:
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
