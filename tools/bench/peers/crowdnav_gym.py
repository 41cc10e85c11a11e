"""CrowdNav's own gym as a peer of `pedzoo bench`: one environment, five people with ORCA, no walls, no lidar.

    git clone https://github.com/vita-epfl/CrowdNav ../CrowdNav
    ../venv_peers/bin/pip install pyrvo numpy matplotlib
    CROWDNAV=../CrowdNav pedzoo bench robots --peer tools/bench/peers/crowdnav_gym.py ...

The checkout is imported as it is. It asks for ``rvo2``, which is pyrvo here under the names of Python-RVO2,
and for an old ``gym``, of which it needs two names. The robot goes straight to its goal (``linear``), people
do not see it. An episode that ends is followed by the next one of its cases at once, which is counted.
"""

from __future__ import annotations

import os
import sys
from configparser import RawConfigParser
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

from answering import Sizes, Step, TimedCase, serve

FOLDER = "CROWDNAV"
"""The variable with the checkout."""

MOST = 20
"""People who find room on its circle."""


def cases(asked: Sizes) -> list[TimedCase]:
    """Return the circle crossing for every number of people that is asked about in one scene."""
    note = "circle crossing, neither walls nor lidar, people decide every 0.25 s, a robot that goes straight"
    sizes = [people for scenes, people in asked.get("robots", []) if scenes == 1 and people <= MOST]
    return [TimedCase("robots", "CrowdNav's gym", lambda a=a: built(a), 1, a, note) for a in sizes]


def built(people: int) -> Step:
    """Return what makes one step of its environment, and begins the next episode after the last one."""
    folder = Path(os.environ.get(FOLDER, ""))
    if not (folder / "crowd_sim" / "envs" / "crowd_sim.py").is_file():
        sys.exit(f"{str(folder)!r} is no checkout of CrowdNav: set {FOLDER}=FOLDER")
    sys.modules |= modules()
    sys.path.insert(0, str(folder))
    from crowd_sim.envs.crowd_sim import CrowdSim  # pyright: ignore[reportMissingImports]
    from crowd_sim.envs.policy.linear import Linear  # pyright: ignore[reportMissingImports]
    from crowd_sim.envs.utils.robot import Robot  # pyright: ignore[reportMissingImports]

    config = RawConfigParser()
    config.read(folder / "crowd_nav" / "configs" / "env.config")
    config.set("sim", "human_num", str(people))
    env, robot = CrowdSim(), Robot(config, "robot")
    env.configure(config)
    robot.set_policy(Linear())
    env.set_robot(robot)
    seen = env.reset("test")

    def step() -> None:
        nonlocal seen
        seen, _, done, _ = env.step(robot.act(seen))
        if done:
            seen = env.reset("test")

    return step


def modules() -> dict[str, ModuleType]:
    """Return the modules ``rvo2`` and ``gym`` with what CrowdNav needs of them."""
    rvo2, gym, envs, registration = map(ModuleType, ("rvo2", "gym", "gym.envs", "gym.envs.registration"))
    every = (rvo2, gym, envs, registration)
    rvo2.PyRVOSimulator = PyRVOSimulator  # pyright: ignore[reportAttributeAccessIssue]
    gym.Env = object  # pyright: ignore[reportAttributeAccessIssue]
    registration.register = lambda **about: None  # pyright: ignore[reportAttributeAccessIssue]
    return {module.__name__: module for module in every}


class PyRVOSimulator:
    """pyrvo under the names of Python-RVO2."""

    def __init__(self, *settings: Any) -> None:
        """Take the settings in the order that both have."""
        from pyrvo.pyrvo import RVOSimulator

        own = RVOSimulator(*settings)
        self.addAgent, self.getNumAgents, self.doStep = own.add_agent, own.get_num_agents, own.do_step
        self.setAgentPosition, self.setAgentVelocity = own.set_agent_position, own.set_agent_velocity
        self.setAgentPrefVelocity, self._velocity = own.set_agent_pref_velocity, own.get_agent_velocity

    def getAgentVelocity(self, agent: int) -> tuple[float, float]:  # noqa: N802
        """Return a velocity, m/s."""
        velocity = self._velocity(agent)
        return velocity.x, velocity.y


if __name__ == "__main__":
    serve("CrowdNav", {"pyrvo": version("pyrvo")}, cases)
