"""Every scenario of the registry can be learned from: gradients through 25 decisions of its environment."""

from typing import Any

import pytest
import torch
from helpers.scenes import prepared
from torchrl.envs import step_mdp

from pedzoo.core.registry import SCENARIOS
from pedzoo.sim.make import make_env

STEPS = 25

DISCOUNT = 0.95
"""Per decision: the plain sum of the way that was made is the same whenever a person arrives."""

WALK, WANDER, PRESS, STAY = range(4)
"""What people do in each of four scenes: go to their goals; go there and about; all press to the right, where
walls are; not move at all."""


@pytest.mark.parametrize("name", SCENARIOS.names())
def test_gradients_are_finite_and_reach_all_people(name: str) -> None:
    """Of rewards and of ways, by every action, and by the gain of what people see of others."""
    torch.manual_seed(0)
    env = make_env(prepared(name), num_envs=4)
    now: Any = env.reset()
    given = torch.zeros(STEPS, *now["agents", "mask"].shape, 2, requires_grad=True)
    gain = torch.tensor(0.1, requires_grad=True)
    reward, way, who = torch.zeros(()), torch.zeros(()), []
    for step in range(STEPS):
        agents = now["agents"]
        wanted = agents["desired_velocity"].clone()
        wanted[WANDER] += torch.randn(wanted[WANDER].shape)
        wanted[PRESS] = torch.tensor([2.0, 0.1])
        wanted[STAY] = 0.0
        here, there = agents["history"][:, :, -1], agents["mask"].unsqueeze(-1)
        others = (here * there).sum(1, keepdim=True) / there.sum(1, keepdim=True).clamp_min(1) - here
        seen = agents["velocity"] + agents["goal"] - here + others
        agents["action"] = wanted + gain * seen.tanh() + given[step]
        who.append(agents["controlled"])
        now = step_mdp(env.step(now), exclude_reward=False)
        reward = reward + DISCOUNT**step * now["agents", "reward"].sum()
        way = way + now["agents", "info", "trace"].square()[now["agents", "mask"]].sum()
    moved = torch.stack(who)
    for value in (reward, way):
        by_action, by_gain = torch.autograd.grad(value, (given, gain), retain_graph=True)
        assert by_action.isfinite().all() and by_gain.isfinite() and by_gain != 0
        assert by_action[~moved].eq(0).all()
        felt = by_action.ne(0).any(-1)
        for scene in (WALK, WANDER, STAY):  # of a last decision nothing is seen after arriving
            assert float(felt[:, scene][moved[:, scene]].float().mean()) > 0.75
