"""Several robots among people as a PettingZoo environment."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv

from pedzoo.core.spec import Spec
from pedzoo.sim.gym.batched import Step
from pedzoo.sim.gym.env import FPS, OneScene
from pedzoo.sim.gym.render import MODES

Dicts = dict[str, Any]

CROWD = "goals:map=apartment.7,people=4"
"""The scenario where nothing else is said."""


class RobotParallelEnv(OneScene, ParallelEnv[str, Any, Any]):
    """One scene with R robots, ``robot_0`` and so on; observations are those of `RobotGymEnv`.

    ``people`` has other robots, too. A robot whose episode is over stands where it is, and is no agent
    any more.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "pedzoo_robots_v0",
        "render_modes": list(MODES),
        "render_fps": FPS,
        "is_parallelizable": True,
    }

    several = "one parallel_env for each scene, or pedzoo.make_robot_env"

    def set_spaces(self) -> None:
        """See `OneScene.set_spaces`; ``robot`` is a list of names here."""
        self.possible_agents = [f"robot_{number}" for number in range(self.batched.env.robots)]
        self.agents = []
        self.action_spaces = dict(zip(self.possible_agents, self.batched.actions, strict=True))
        space = self.batched.observations.space
        self.observation_spaces = {agent: spaces.Dict(space.spaces) for agent in self.possible_agents}
        self._chance = np.random.default_rng()

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return what an agent observes."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return what an agent does."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Dicts | None = None) -> tuple[Dicts, Dicts]:
        """Begin the first scene of a seed, or else the next one; there are no options."""
        self.agents = self.possible_agents[:]
        said = self._of_agents(self.batched.reset(seed, self._chance))
        return said[0], said[-1]

    def step(self, actions: dict[str, ArrayLike]) -> tuple[Dicts, Dicts, Dicts, Dicts, Dicts]:
        """Take the decisions of all agents; one without an action stands."""
        nothing = np.zeros(2, dtype=np.float32)
        given = [np.asarray(actions.get(agent, nothing), np.float32) for agent in self.possible_agents]
        said = self._of_agents(self.batched.step(np.stack(given)))
        self.agents = [agent for agent in self.agents if not (said[2][agent] or said[3][agent])]
        return said

    def _of_agents(self, step: Step) -> tuple[Dicts, Dicts, Dicts, Dicts, Dicts]:
        mine = {agent: self.possible_agents.index(agent) for agent in self.agents}

        def split(values: dict[str, NDArray[Any]]) -> Dicts:
            return {agent: {name: value[0, i] for name, value in values.items()} for agent, i in mine.items()}

        info = {
            agent: {name: value.item() for name, value in said.items()}
            for agent, said in split(step.info).items()
        }
        reward = {agent: float(step.reward[0, i]) for agent, i in mine.items()}
        terminated, truncated = (
            {agent: bool(value[0, i]) for agent, i in mine.items()}
            for value in (step.terminated, step.truncated)
        )
        return split(step.observation), reward, terminated, truncated, info


def parallel_env(scenario: str | Spec = CROWD, **settings: Any) -> RobotParallelEnv:
    """Return a PettingZoo environment; ``settings`` as of `RobotParallelEnv`, two discs by default.

    Raises:
        UserError: An unknown name or setting.
    """
    settings.setdefault("robot", ["disc", "disc"])
    return RobotParallelEnv(scenario, **settings)
