"""Environments take actions of the right shape alone, in any precision."""

from collections.abc import Callable
from typing import Any, ClassVar

import pytest
import torch
from tensordict import TensorDictBase

import pedzoo
import pedzoo.sim.gym
from pedzoo.core.errors import UserError
from pedzoo.policies.policy import Policy
from pedzoo.policies.teams import Teams


class Made(Policy):
    """Returns what a function makes of the batch."""

    out_keys: ClassVar[list[Any]] = [("agents", "action")]

    def __init__(self, result: Callable[[TensorDictBase], Any]) -> None:
        super().__init__(0.4)
        self.result = result

    def forward(self, tensordict: TensorDictBase) -> Any:
        return self.result(tensordict)


def wide(width: int = 2) -> Made:
    """Return a policy that walks as the planner says, in double precision and numbers of another width."""

    def write(batch: TensorDictBase) -> TensorDictBase:
        desired = batch["agents", "desired_velocity"]
        batch["agents", "action"] = desired[..., :1].expand(*desired.shape[:2], width).double()
        return batch

    return Made(write)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (wide(1), r"action of shape \({scenes}, 1\): expected \({scenes}, 2\)"),
        (wide(3), r"action of shape \({scenes}, 3\): expected \({scenes}, 2\)"),
        (Made(lambda batch: batch), "'Made'.* wrote no velocities: set tensordict"),
        (Made(lambda batch: None), "returned NoneType: write `return tensordict` at its end"),
        (Made(lambda batch: batch["agents", "velocity"]), "returned Tensor: write `return tensordict`"),
    ],
)
def test_policies_that_return_something_else_are_told(policy: Made, message: str) -> None:
    env = pedzoo.make_env("circle:people=3", 2)
    with pytest.raises(UserError, match=message.replace("{scenes}", "2, 3")):
        env.step(policy(env.reset()))
    with pytest.raises(UserError, match=message.replace("{scenes}", "1, 1")):
        pedzoo.controller(policy).step({1: (0, 0)}, {1: (0, -5)})


@pytest.mark.parametrize("scenario", ["door", "circle:people=4"])
def test_double_precision_walks_as_single(scenario: str) -> None:
    env = pedzoo.make_env(scenario, 2)
    for policy in (wide(), Teams([(wide(), 0.5), (pedzoo.load("go_to_goal"), 0.5)])):
        after = env.step(policy(env.reset()))["next"]
        assert after["agents", "history"].dtype == torch.float32
        assert after["agents", "velocity"].norm(dim=-1).max() > 0.1
