"""VMAS' scenario ``navigation`` as a peer of `pedzoo bench`: with lidar and collisions, and without both.

    python -m venv ../venv_peers && ../venv_peers/bin/pip install torch vmas pyrvo
    pedzoo bench loop --peer tools/bench/peers/vmas_navigation.py --peer_python ../venv_peers/bin/python

Every person gets random forces, drawn beforehand; observations and rewards are computed in each step of 0.1 s
(two sub-steps). After 100 steps all scenes are reset at once, which is counted and the cheapest way to do it.
The area in which people start grows with their number; VMAS' own is 2 x 2 m for four.

In the section ``robots`` the last agent alone has a lidar, of 64 rays and 5 m. The walls are the 16 longest
edges of those that ours walk among, as lines that agents and rays run into; agents start anywhere. All 192
edges of ``apartment.7`` take VMAS 0.2 s per step of 64 scenes.

VMAS is licensed under the GPL: it is run here, in a process of its own, and imported by nothing of pedzoo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import torch
from answering import Step, TimedCase, loop_cases, serve
from vmas import make_env  # pyright: ignore[reportMissingImports]
from vmas.scenarios.navigation import Scenario  # pyright: ignore[reportMissingImports]
from vmas.simulator.core import Landmark, Line  # pyright: ignore[reportMissingImports]
from vmas.simulator.sensors import Lidar  # pyright: ignore[reportMissingImports]

STEPS, DRAWS = 100, 16
MOST = 100
"""More people than this take VMAS minutes per step."""

KINDS = {"lidar": (True, "12 rays each and collisions"), "no lidar": (False, "neither rays nor collisions")}

RAYS, REACH, WALLS = 64, 5.0, 16
ROBOTS = {
    "lidar and walls": (True, f"{RAYS} rays of one robot among the {WALLS} longest edges of the same walls"),
    "lidar": (False, f"{RAYS} rays of one robot, no walls"),
}

ABOUT = f"navigation, {{about}}, random actions, all scenes reset at once after {STEPS} steps"


def cases(asked: list[dict[str, Any]], threads: int) -> list[TimedCase]:
    """Return what can be done of every size that is asked about."""
    torch.set_num_threads(threads)
    robots = loop_cases(asked, MOST, ROBOTS, ABOUT, with_robot, "robots")
    return [*loop_cases(asked, MOST, KINDS, ABOUT, navigation), *robots]


def navigation(size: dict[str, Any], collisions: bool) -> tuple[Step, None]:
    """Return the scenario as it is."""
    half = math.sqrt(max(size["people"], 4) / 4)
    return built(size, "navigation", collisions=collisions, world_spawning_x=half, world_spawning_y=half)


def with_robot(size: dict[str, Any], walled: bool) -> tuple[Step, None]:
    """Return the scenario with a lidar of one agent."""
    corners = torch.tensor([point for polygon in size["walls"] for point in polygon])
    middle = (corners.amin(0) + corners.amax(0)) / 2
    half = (corners.amax(0) - corners.amin(0)) / 2
    polygons = [torch.tensor(polygon) - middle for polygon in size["walls"]] if walled else []
    area = {"world_spawning_x": float(half[0]), "world_spawning_y": float(half[1])}
    return built(size, WithRobot(polygons), agent_radius=0.15, n_lidar_rays=RAYS, lidar_range=REACH, **area)


class WithRobot(Scenario):
    """The last agent has a lidar, others have none; walls stand where edges of polygons (V, 2) are."""

    def __init__(self, polygons: list[torch.Tensor]) -> None:
        """Take the polygons, metres."""
        super().__init__()
        edges = [pair for one in polygons for pair in zip(one, one.roll(-1, 0), strict=True)]
        self.edges = sorted(edges, key=lambda edge: -float((edge[1] - edge[0]).norm()))[:WALLS]

    def make_world(self, batch_dim: int, device: torch.device, **settings: Any) -> Any:
        """Add walls, and move the lidar to all bodies and walls."""
        world = super().make_world(batch_dim, device, **settings)
        self.walls = []
        for number, (start, end) in enumerate(self.edges):
            length = float((end - start).norm())
            wall = Landmark(name=f"wall {number}", collide=True, movable=False, shape=Line(length))
            world.add_landmark(wall)
            self.walls.append(wall)
        goals = {agent.goal.name for agent in world.agents}
        bodies: Callable[[Any], bool] = lambda entity: entity.name not in goals  # noqa: E731
        for agent in world.agents:
            agent.sensors.clear()
        lidar = Lidar(world, n_rays=self.n_lidar_rays, max_range=self.lidar_range, entity_filter=bodies)
        world.agents[-1].add_sensor(lidar)
        return world

    def reset_world_at(self, env_index: int | None = None) -> None:
        """Put walls to their places, too."""
        super().reset_world_at(env_index)
        for wall, (start, end) in zip(self.walls, self.edges, strict=True):
            wall.set_pos((start + end) / 2, batch_index=env_index)
            angle = torch.atan2(*(end - start).flip(0)).view(1)
            wall.set_rot(angle, batch_index=env_index)

    def observation(self, agent: Any) -> torch.Tensor:
        """Return place, velocity, the way to the goal, and the lidar where there is one."""
        parts = [agent.state.pos, agent.state.vel, agent.state.pos - agent.goal.state.pos]
        return torch.cat([*parts, *(self.lidar_range - one.measure() for one in agent.sensors)], dim=-1)


def built(size: dict[str, Any], scenario: Any, **settings: Any) -> tuple[Step, None]:
    """Return what makes one step of all scenes, and resets them when their time is over."""
    env = make_env(
        scenario, num_envs=size["scenes"], device="cpu", seed=0, n_agents=size["people"], **settings
    )
    actions = [env.get_random_actions() for _ in range(DRAWS)]
    done = 0

    def step() -> None:
        nonlocal done
        if done and done % STEPS == 0:
            env.reset()
        env.step(actions[done % DRAWS])
        done += 1

    return step, None


if __name__ == "__main__":
    serve("VMAS", {"vmas": version("vmas"), "vmas' torch": version("torch")}, cases)
