"""Environments take actions of the right shape alone, in any precision."""

from collections.abc import Callable
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

import pedzoo
import pedzoo.sim.gym
from pedzoo.core.errors import UserError
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Teams


class Wide(Policy):
    """Walks as the planner says, in numbers of another kind and another width."""

    out_keys: ClassVar[list[Any]] = [("agents", "action")]

    def __init__(self, width: int = 2) -> None:
        """Say how many numbers every agent gets."""
        super().__init__(0.4)
        self.width = width

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write double precision."""
        desired = tensordict["agents", "desired_velocity"]
        tensordict["agents", "action"] = desired[..., :1].expand(*desired.shape[:2], self.width).double()
        return tensordict


@pytest.mark.parametrize("width", [1, 3])
def test_actions_of_another_width_are_refused(width: int) -> None:
    env = pedzoo.make_env("circle:people=3", 2)
    with pytest.raises(UserError, match=rf"action of shape \(2, 3, {width}\): expected \(2, 3, 2\)"):
        env.step(Wide(width)(env.reset()))
    with pytest.raises(UserError, match=r"expected \(1, 1, 2\)"):
        pedzoo.controller(Wide(width)).step({1: (0, 0)}, {1: (0, -5)})


class Forgetful(Policy):
    """Writes no velocities, or does not return the batch."""

    def __init__(self, result: Callable[[TensorDictBase], Any]) -> None:
        """Take what to return of the batch."""
        super().__init__(0.4)
        self.result = result

    def forward(self, tensordict: TensorDictBase) -> Any:
        """Write nothing."""
        return self.result(tensordict)


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (
            lambda batch: batch,
            "'Forgetful'.* wrote no velocities: set tensordict",
        ),
        (lambda batch: None, "returned NoneType: write `return tensordict` at its end"),
        (lambda batch: batch["agents", "velocity"], "returned Tensor: write `return tensordict`"),
    ],
)
def test_a_policy_that_forgets_the_actions_or_the_batch_is_told(
    result: Callable[[TensorDictBase], Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        Forgetful(result)(pedzoo.make_env("circle:people=2", 2).reset())
    with pytest.raises(UserError, match=message):
        pedzoo.controller(Forgetful(result)).step({1: (0, 0)}, {1: (0, -5)})


@pytest.mark.parametrize("scenario", ["door", "circle:people=4"])
def test_double_precision_walks_as_single(scenario: str) -> None:
    env = pedzoo.make_env(scenario, 2)
    for policy in (Wide(), Teams([(Wide(), 0.5), (pedzoo.load("go_to_goal"), 0.5)])):
        after = env.step(policy(env.reset()))["next"]
        assert after["agents", "history"].dtype == torch.float32
        assert after["agents", "velocity"].norm(dim=-1).max() > 0.1


@pytest.mark.parametrize("shape", [(2, 4), (4, 1), (4, 3), (8,)])
def test_vectors_of_robots_refuse_turned_actions(shape: tuple[int, ...]) -> None:
    robots: Any = gymnasium.make_vec("pedzoo/Crossing-v0", num_envs=4)
    robots.reset(seed=0)
    with pytest.raises(UserError, match=r"expected \(1, 2\) per scene"):
        robots.step(np.zeros(shape))
    robots.step(np.zeros((4, 2)))
    robots.close()
