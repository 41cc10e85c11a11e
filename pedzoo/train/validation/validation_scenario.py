"""The episodes that a process walks to validate weights in training, apart from that training."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.rollout import walk
from pedzoo.models.base import Forecaster
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env, physics_class
from pedzoo.sim.rollout import joined
from pedzoo.sim.scenario import PreparedScenario, Scenario


class ValidationScenario:
    """Consecutive episodes of a scenario, the same whenever they are walked.

    Attributes:
        name: The scenario as it was given.
    """

    def __init__(
        self,
        name: str,
        scenario: Scenario | PreparedScenario,
        physics: str,
        seed: int,
        first: int,
        episodes: int,
    ) -> None:
        """Make the environment of ``episodes`` scenes from number ``first`` on.

        There are none where there are more processes than episodes. Scenarios may share their scenes.
        """
        self.name, self._seed, self._episodes = name, seed, episodes
        rounds = -(-episodes // physics_class(physics).scenes_at_once)
        at_once = -(-episodes // max(rounds, 1))
        self._env = make_env(scenario, at_once, physics, seed=seed, first_episode=first) if episodes else None
        if self._env is not None:
            self._env.policy_name = "the model in training"

    def walk(self, walker: Walker, deterministic: bool) -> PolicyRollout | None:
        """Return the rollout of ``walker`` in the episodes; None where there are none."""
        if self._env is None:
            return None
        self._env.set_seed(self._seed)
        rollout = joined(list(walk(walker, self._env, self._episodes, deterministic)))
        return PolicyRollout(type(walker.model).__name__, rollout, self._env)

    def close(self) -> None:
        """Let go of the physics."""
        if self._env is not None:
            self._env.physics.close()


def share(episodes: int, rank: int, processes: int) -> tuple[int, int]:
    """Return the first episode of the process ``rank``, and how many it has, as equal as can be."""
    each, more = divmod(episodes, processes)
    return rank * each + min(rank, more), each + (rank < more)


def walking_copy(model: Forecaster) -> Walker:
    """Return a copy that walks: on the CPU, where environments are, and in eval mode."""
    return Walker(copy.deepcopy(model).cpu().eval())


@contextmanager
def isolated(seed: int) -> Iterator[None]:
    """Leave the state of a training as it is.

    Outside of inference mode, in which Lightning validates: environments keep what they make from one
    validation to the next. Random numbers that are not drawn by scene come from a state of their own.
    """
    with torch.inference_mode(False), torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield
