"""Robots among people for Gymnasium and PettingZoo; importing it registers ``pedzoo/Goals-v0`` and more."""

from collections.abc import Mapping
from typing import Any

from pedzoo.core.errors import need

need("gym", "pedzoo.sim.gym")

import gymnasium  # noqa: E402  it has to be there

IDS: Mapping[str, Mapping[str, Any]] = {
    "pedzoo/Goals-v0": {"scenario": "goals:map=apartment.7,people=4"},
    "pedzoo/Door-v0": {"scenario": "door:width=1.0,people=3"},
    "pedzoo/Corridor-v0": {"scenario": "hallway:width=[2.0,3.0],people=3"},
    "pedzoo/Crossing-v0": {"scenario": "perpendicular:people=6"},
    "pedzoo/CrowdNav-v0": {
        "scenario": "circle:radius=4,people=5,speed=1,speed_std=0",
        "robot": "disc:radius=0.3,top_speed=1",
        "people": "orca:radius=0.3,neighbor_dist=10,time_horizon=5,time_horizon_obst=5",
        "sensors": ["goal", "odometry", "people:most=5,reach=30"],
        "body_radius": 0.3,
        "time_limit": 25.0,
    },
    "pedzoo/Replay-v0": {"scenario": "replay:simulated=one", "people": "go_to_goal"},
}
"""Settings of `pedzoo.make_robot_env` by id; `gymnasium.make` takes others in their place.

``CrowdNav`` has the bodies, speeds and time limit of Chen et al., "Crowd-Robot Interaction" (ICRA 2019), in
scenes of pedzoo's own ``circle``. The robot decides every 0.2 s, and people see it.
"""

for _name in IDS.keys() - gymnasium.registry.keys():
    gymnasium.register(
        _name,
        entry_point="pedzoo.sim.gym.env:RobotGymEnv",
        vector_entry_point="pedzoo.sim.gym.vector:RobotVectorEnv",
        kwargs=dict(IDS[_name]),
    )
