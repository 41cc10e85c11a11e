"""Several robots among people as a PettingZoo environment."""

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike
from pettingzoo import ParallelEnv

from pedzoo.core.spec import Spec
from pedzoo.sim.gym.batched import Step
from pedzoo.sim.gym.env import OneScene, RobotGymEnv, robot_of

Dicts = dict[str, Any]


class RobotParallelEnv(OneScene, ParallelEnv[str, Any, Any]):
    """One scene with R robots, ``robot_0`` and so on; observations are those of `RobotGymEnv`.

    ``people`` has other robots, too. A robot whose episode is over stands, and is no agent any more.
    """

    metadata: ClassVar[dict[str, Any]] = RobotGymEnv.metadata | {
        "name": "pedzoo_robots_v0",
        "is_parallelizable": True,
    }
    several = "one parallel_env for each scene, or pedzoo.make_robot_env"
    several_robots = True

    def __init__(self, scenario: str | Spec, **settings: Any) -> None:
        """Make the scene; arguments as of `OneScene`. ``robot`` is a list of names here."""
        super().__init__(scenario, **settings)
        self.possible_agents = [f"robot_{number}" for number in range(self.batched.env.robots)]
        self.agents, self._chance = [], np.random.default_rng()
        self.action_spaces = dict(zip(self.possible_agents, self.batched.actions, strict=True))
        space = self.batched.observations.space
        self.observation_spaces = {agent: spaces.Dict(space.spaces) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return what an agent observes."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return what an agent does."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Dicts | None = None) -> tuple[Dicts, Dicts]:
        """Begin the first scene of a seed, or else the next one; there are no options."""
        self.agents = self.possible_agents[:]
        observation, *_, info = self._by_agent(self.batched.reset(seed, self._chance))
        return observation, info

    def step(self, actions: dict[str, ArrayLike]) -> tuple[Dicts, Dicts, Dicts, Dicts, Dicts]:
        """Take the decisions of all agents; one without an action stands."""
        nothing = np.zeros(2, dtype=np.float32)
        given = [np.asarray(actions.get(agent, nothing), np.float32) for agent in self.possible_agents]
        _, _, terminated, truncated, _ = result = self._by_agent(self.batched.step(np.stack(given)))
        self.agents = [agent for agent in self.agents if not (terminated[agent] or truncated[agent])]
        return result

    def _by_agent(self, step: Step) -> tuple[Dicts, Dicts, Dicts, Dicts, Dicts]:
        robots = {agent: robot_of(step, self.possible_agents.index(agent)) for agent in self.agents}
        one, two, three, four, five = ({agent: part[i] for agent, part in robots.items()} for i in range(5))
        return one, two, three, four, five


def parallel_env(
    scenario: str | Spec = "goals:map=apartment.7,people=4", **settings: Any
) -> RobotParallelEnv:
    """Return a PettingZoo environment; ``settings`` as of `RobotParallelEnv`, two discs by default.

    Raises:
        UserError: An unknown name or setting.
    """
    return RobotParallelEnv(scenario, **{"robot": ["disc", "disc"], **settings})
