"""VMAS' scenario ``navigation`` as a peer of `pedzoo bench`: with lidar and collisions, and without both.

    python -m venv ../venv_peers && ../venv_peers/bin/pip install torch vmas pyrvo
    pedzoo bench environment --peer tools/bench/peers/vmas_navigation.py --peer_python PYTHON

Every person gets random forces, drawn beforehand; observations and rewards are computed in each step of 0.1 s
(two sub-steps). After 100 steps all scenes are reset at once, which is counted and the cheapest way to do it.
The area in which people start grows with their number; VMAS' own is 2 x 2 m for four.

In the section ``robots`` the last agent alone has a lidar, of 64 rays and 5 m, among `WALLS` lines that
agents and rays run into. Ours walk among 192 edges; so many take VMAS 0.2 s per step of 64 scenes.

VMAS is licensed under the GPL: it is run here, in a process of its own, and imported by nothing of pedzoo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from typing import Any

import torch
from answering import Sizes, Step, TimedCase, serve
from vmas import make_env  # pyright: ignore[reportMissingImports]
from vmas.scenarios.navigation import Scenario  # pyright: ignore[reportMissingImports]
from vmas.simulator.core import Landmark, Line  # pyright: ignore[reportMissingImports]
from vmas.simulator.sensors import Lidar  # pyright: ignore[reportMissingImports]

STEPS, DRAWS = 100, 16
MOST = 100
"""More people than this take VMAS minutes per step."""

KINDS = {"lidar": (True, "12 rays each and collisions"), "no lidar": (False, "neither rays nor collisions")}

RAYS, REACH, WALLS = 64, 5.0, 16
HALF, LONG = 8.0, 4.0
"""Metres: half the side of the floor, and a wall."""

ROBOTS = {
    "lidar and walls": (True, f"{RAYS} rays of one robot among {WALLS} walls"),
    "lidar": (False, f"{RAYS} rays of one robot, no walls"),
}

ABOUT = f"navigation, {{about}}, random actions, all scenes reset at once after {STEPS} steps"


def cases(asked: Sizes) -> list[TimedCase]:
    """Return what can be done of every size that is asked about."""
    torch.set_num_threads(1)
    result = []
    for section, kinds in (("environment", KINDS), ("robots", ROBOTS)):
        for scenes, people in asked.get(section, []):
            for name, (flag, about) in kinds.items() if people <= MOST else ():
                make = navigation if section == "environment" else with_robot
                build = partial(make, scenes, people, flag)
                name, note = f"VMAS navigation, {name}", ABOUT.format(about=about)
                result.append(TimedCase(section, name, build, scenes, people, note))
    return result


def navigation(scenes: int, people: int, collisions: bool) -> Step:
    """Return the scenario as it is."""
    half = math.sqrt(max(people, 4) / 4)
    area = {"world_spawning_x": half, "world_spawning_y": half}
    return built(scenes, people, "navigation", collisions=collisions, **area)


def with_robot(scenes: int, people: int, walled: bool) -> Step:
    """Return the scenario with a lidar of one agent."""
    area = {"world_spawning_x": HALF, "world_spawning_y": HALF}
    lidar = {"n_lidar_rays": RAYS, "lidar_range": REACH}
    return built(scenes, people + 1, WithRobot(WALLS if walled else 0), agent_radius=0.15, **lidar, **area)


class WithRobot(Scenario):
    """The last agent has a lidar, others have none; walls stand at random."""

    def __init__(self, walls: int) -> None:
        """Draw middles (W, 2) and angles (W, 1) of walls."""
        super().__init__()
        draws = torch.Generator().manual_seed(0)
        self.middle = HALF * (2 * torch.rand(walls, 2, generator=draws) - 1)
        self.angle = math.pi * torch.rand(walls, 1, generator=draws)

    def make_world(self, batch_dim: int, device: torch.device, **settings: Any) -> Any:
        """Add walls, and move the lidar to all bodies and walls."""
        world = super().make_world(batch_dim, device, **settings)
        self.walls = []
        for number in range(len(self.middle)):
            wall = Landmark(name=f"wall {number}", collide=True, movable=False, shape=Line(LONG))
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
        for wall, middle, angle in zip(self.walls, self.middle, self.angle, strict=True):
            wall.set_pos(middle, batch_index=env_index)
            wall.set_rot(angle, batch_index=env_index)

    def observation(self, agent: Any) -> torch.Tensor:
        """Return place, velocity, the way to the goal, and the lidar where there is one."""
        parts = [agent.state.pos, agent.state.vel, agent.state.pos - agent.goal.state.pos]
        return torch.cat([*parts, *(self.lidar_range - one.measure() for one in agent.sensors)], dim=-1)


def built(scenes: int, people: int, scenario: Any, **settings: Any) -> Step:
    """Return what makes one step of all scenes, and resets them when their time is over."""
    env = make_env(scenario, num_envs=scenes, device="cpu", seed=0, n_agents=people, **settings)
    actions = [env.get_random_actions() for _ in range(DRAWS)]
    done = 0

    def step() -> None:
        nonlocal done
        if done and done % STEPS == 0:
            env.reset()
        env.step(actions[done % DRAWS])
        done += 1

    return step


if __name__ == "__main__":
    serve("VMAS", {"vmas": version("vmas"), "vmas' torch": version("torch")}, cases)
