"""Every scenario of the registry can be learned from: gradients through 25 decisions of its environment."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytest
import torch
from helpers.scenes import prepared
from torch import Tensor, nn
from torchrl.envs import step_mdp

from pedzoo.core.registry import SCENARIOS
from pedzoo.sim.make import make_env

STEPS = 25

DISCOUNT = 0.95
"""Per decision: the plain sum of the way that was made is the same whenever a person arrives."""

WALK, WANDER, PRESS, STAY = range(4)
"""What people do in each of four scenes: go to their goals; go there and about; all press to the right, where
walls are; not move at all."""


class Crowd(nn.Module):
    """A small network that sees its own goal, velocity and past, and where the others are."""

    def __init__(self) -> None:
        """Make the weights."""
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(22, 8), nn.Tanh(), nn.Linear(8, 2))

    def forward(self, agents: Any) -> Tensor:
        """Return what it adds to every person's velocity (B, A, 2), m/s."""
        here, there = agents["history"][:, :, -1], agents["mask"].unsqueeze(-1)
        past = agents["history"] - here.unsqueeze(2)
        others = (here * there).sum(1, keepdim=True) / there.sum(1, keepdim=True).clamp_min(1) - here
        near = others / (1 + others.norm(dim=-1, keepdim=True))
        seen = (agents["goal"] - here, agents["velocity"], past.flatten(2), near)
        return 0.3 * self.layers(torch.cat(seen, dim=-1))


class Slopes(NamedTuple):
    """Gradients of rewards and of ways by actions (T, B, A, 2), and by a network's weights; who was moved."""

    reward_by_action: Tensor
    reward_by_weights: list[Tensor]
    way_by_action: Tensor
    way_by_weights: list[Tensor]
    moved: Tensor


def slopes(name: str) -> Slopes:
    """Return the gradients of one piece of four episodes."""
    torch.manual_seed(0)
    env = make_env(prepared(name), num_envs=4)
    now: Any = env.reset()
    net = Crowd()
    given = torch.zeros(STEPS, *now["agents", "mask"].shape, 2, requires_grad=True)
    reward, way, moved = torch.zeros(()), torch.zeros(()), []
    for step in range(STEPS):
        wanted = now["agents", "desired_velocity"].clone()
        wanted[WANDER] += torch.randn(wanted[WANDER].shape)
        wanted[PRESS] = torch.tensor([2.0, 0.1])
        wanted[STAY] = 0.0
        now["agents", "action"] = wanted + net(now["agents"]) + given[step]
        moved.append(now["agents", "controlled"])
        now = step_mdp(env.step(now), exclude_reward=False)
        reward = reward + DISCOUNT**step * now["agents", "reward"].sum()
        trace = now["agents", "info", "trace"]
        way = way + trace.square()[now["agents", "mask"]].sum()
    leaves = [given, *net.parameters()]
    by_reward = torch.autograd.grad(reward, leaves, retain_graph=True)
    by_way = torch.autograd.grad(way, leaves)
    return Slopes(by_reward[0], list(by_reward[1:]), by_way[0], list(by_way[1:]), torch.stack(moved))


@pytest.mark.parametrize("name", SCENARIOS.names())
def test_gradients_are_finite_and_reach_all_people(name: str) -> None:
    result = slopes(name)
    actions = (result.reward_by_action, result.way_by_action)
    weights = (result.reward_by_weights, result.way_by_weights)
    assert all(slope.isfinite().all() for slope in (*actions, *weights[0], *weights[1]))
    assert all(slope.abs().sum() > 0 for slope in (*weights[0], *weights[1]))
    for by_action in actions:
        assert by_action[~result.moved].eq(0).all()
        felt = by_action.ne(0).any(-1)
        for scene in (WALK, WANDER, STAY):  # of a last decision nothing is seen after arriving
            assert float(felt[:, scene][result.moved[:, scene]].float().mean()) > 0.75
