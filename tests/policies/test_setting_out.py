"""Every shipped policy sets out within a second of a goal that a host or a scenario gives, from any start."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from helpers.walks import hosted
from torchrl.envs import step_mdp

import pedzoo
from pedzoo.core.batch import agents_of
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import with_walked_history
from pedzoo.sim.make import make_env
from tests.helpers.batches import make_batch

MOVED = 0.25
"""Metres that people have walked after a second."""

KINDS = (
    *("orca", "social_force", "bent_line", "sgan_goal.zara1", "approach_net_goal_map.indoor"),
    *("anchor_net_goal.eth_destination", "social_vrnn.eth", "social_walker.indoor", "social_walker.styled"),
)


def test_all_policies_set_out_from_a_static_start() -> None:
    """Those that know a goal go there; the others go where they are shown to have gone."""
    late, names = [], pedzoo.list_policies()
    settings: Any = {"warm_start": "static", "physics": "compiled"}
    envs = {dt: make_env("circle:people=2,speed_std=0", 2, decision_dt=dt, **settings) for dt in (0.1, 0.4)}
    for name in names:
        policy = load_policy(name)
        env = envs[policy.decision_dt]
        now: Any = env.reset()
        begin, way = env.state.position, env.state.goal_point - env.state.position
        with torch.no_grad():
            for _ in range(round(0.8 / policy.decision_dt)):
                now = step_mdp(env.step(policy(now)))
        moved = ((env.state.position - begin) * way / way.norm(dim=-1, keepdim=True)).sum(-1).min()
        model = getattr(policy, "model", None)
        if moved < (MOVED if model is None or "goal" in model.needs else MOVED / 4):
            late.append((name, round(float(moved), 2)))
    assert len(names) > 100 and not late


@pytest.mark.parametrize("name", KINDS)
def test_people_of_a_host_set_out_again(name: str) -> None:
    """They were placed without a goal, have arrived, or were stopped, for a short or a long time."""
    policy = load_policy(name)
    dt = policy.decision_dt
    for number, (begin, stood, way) in enumerate(
        (("placed", 3.6, 2.5), ("arrived", 0.8, -1.9), ("arrived", 3.6, 3.0), ("stopped", 0.8, 0.4))
    ):
        controller = Controller(policy, dt=dt, seed=number, pref_speed=1.2)
        here = np.array([[0.3, 0.2], [30.0, 0.0]])
        if begin != "placed":
            first = (1.1, 0.2) if begin == "arrived" else (9.0, 0.2)
            here = hosted(controller, here, {0: {0: first, 1: None}}, 2.0)[0][-1]
        here = hosted(controller, here, {} if begin == "arrived" else {0: {0: None, 1: None}}, stood)[0][-1]
        goal = here[0] + 6.0 * np.array([math.cos(way), math.sin(way)])
        there = hosted(controller, here, {0: {0: goal}}, 0.8)[0][-1]
        assert np.linalg.norm(there - here, axis=1)[0] > MOVED, (begin, stood)


@pytest.mark.parametrize(
    "scenario", ["waiting:people=3,waiting=2,stay=0,seconds=1.5", "standing:seconds=1.5"]
)
def test_people_who_waited_in_a_scenario_set_out(scenario: str) -> None:
    env = make_env(scenario, 2, "compiled")
    for name in ("social_walker.styled", "sgan_goal.zara1", "approach_net_goal_map.indoor"):
        policy, begin = load_policy(name), None
        now: Any = env.reset()
        with torch.no_grad():
            for _ in range(6):
                begin = env.state.position if env.state.goal_since.amax() > 0 and begin is None else begin
                now = step_mdp(env.step(policy(now)))
        assert begin is not None
        moved = (env.state.position - begin).norm(dim=-1)[env.state.goal_since > 0]
        assert len(moved) >= 2 and moved.min() > MOVED


def test_what_people_see_of_themselves_when_they_set_out() -> None:
    """Of four one is on the way, one just got a goal, one 0.8 s ago, and one walked when it did."""
    batch = make_batch((4,), padding=0.0)
    agents = agents_of(batch)
    here = torch.zeros(1, 4, 8, 2)
    here[0, 2, 6:, 1] = torch.tensor([0.3, 0.7])
    here[0, 3, :, 0] = 0.5 * torch.arange(8.0)
    agents["history"], agents["pref_speed"] = here, torch.ones(1, 4, 1)
    agents["desired_velocity"] = torch.tensor([1.0, 0.0]).expand(1, 4, 2)
    agents["goal_since"] = torch.tensor([-torch.inf, 4.0, 3.2, 3.6]).view(1, 4, 1)
    batch["time"] = torch.full((1, 1), 4.0)
    result = agents_of(with_walked_history(batch))
    came = 0.4 * torch.arange(-7.0, 1.0)
    assert torch.equal(result["history"][0, [0, 3]], here[0, [0, 3]])
    torch.testing.assert_close(result["history"][0, 1], torch.stack((came, torch.zeros(8)), 1))
    ended = torch.stack((0.4 * torch.arange(-5.0, 1.0), torch.zeros(6)), 1)
    torch.testing.assert_close(result["history"][0, 2], torch.cat((ended, here[0, 2, 6:])))
    assert result["sets_out"][0, :, 0].tolist() == [False, True, True, False]
    agents["goal_since"] -= 3.0
    assert with_walked_history(batch) is batch


def test_recorded_people_who_stand_have_no_new_goal() -> None:
    env = make_env("replay:fold=embedded", 2, "compiled")
    now: Any = env.reset()
    for _ in range(4):
        assert env.state.goal_since.isneginf().all()
        now["agents", "action"] = now["agents", "desired_velocity"]
        now = step_mdp(env.step(now))
