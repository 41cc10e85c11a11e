"""A person who stands at a door and then walks on."""

from typing import Any

import pytest
import torch
from torchrl.envs import step_mdp

from pedzoo.core.randomness import Draws
from pedzoo.eval.comparison import row
from pedzoo.eval.rollout import rollout
from pedzoo.sim.make import make_env, make_scenario
from pedzoo.sim.scenario import Layout
from pedzoo.sim.scenarios.standing import Standing

STANDS = "standing:people=3,at=0,seconds=2.1,speed_std=0,jitter=0"


def layout(spec: str, scenes: int = 300) -> Layout:
    scenario = make_scenario(spec)
    assert isinstance(scenario, Standing)
    return scenario.prepare(0.25).layout(Draws.for_episodes(0, torch.arange(scenes)))


@pytest.mark.parametrize("physics", ["compiled", "bullet"])
def test_they_stand_until_their_time_is_up(physics: str) -> None:
    env = make_env(STANDS, num_envs=3, physics=physics)
    now: Any = env.reset()
    begins = now["agents", "history"][:, 2, 0]
    for step in range(1, 9):
        # 2.1 s: until the decision at 2.4 s the policy is not asked
        stands = step <= 6
        assert (now["agents", "controlled"][:, 2] == (not stands)).all()
        assert now["agents", "mask"][:, 2].all() and now["agents", "valid"][:, 2].all()
        if stands:
            assert torch.equal(now["agents", "history"][:, 2], begins.unsqueeze(1).expand(3, 8, 2))
            assert now["agents", "velocity"][:, 2].eq(0).all()
        now["agents", "action"] = now["agents", "desired_velocity"]
        now = step_mdp(env.step(now), exclude_reward=False)
    moved = (now["agents", "history"][:, 2, -1] - begins).norm(dim=-1)
    assert torch.allclose(moved, torch.full((3,), 0.8 * 1.3), atol=0.05)
    env.physics.close()


def test_their_way_and_its_time_begin_when_they_set_out() -> None:
    env = make_env(STANDS, num_envs=2)
    now: Any = env.reset()
    assert env.state.planned[:, 2].eq(0).all() and env.state.planned[:, 0].gt(2).all()
    for _ in range(6):
        now["agents", "action"] = torch.zeros(2, 3, 2)
        now = step_mdp(env.step(now))
    # 3 m less the goal's radius of 0.3 m
    assert torch.allclose(env.state.planned[:, 2], torch.tensor(2.7), atol=0.1)
    assert torch.allclose(env.state.deadline[:, 2], torch.tensor(22.4))
    assert torch.allclose(env.state.deadline[:, 0], torch.tensor(20.0))


def test_a_metric_row_is_that_of_an_ordinary_scene() -> None:
    result, _ = rollout(
        "go_to_goal", "standing:width=1.2,at=[-1,-0.8],from_right=1,speed_std=0", "compiled", 12
    )
    assert not result.replayed
    metrics = row("go_to_goal", result)["metrics"]
    assert metrics["success"] == metrics["episode_success"] == 1
    # standing still is no delay of theirs
    assert 0.9 < metrics["time_ratio"] < 1.1
    alone = result.episodes(slice(1))
    assert 20 <= int((alone.present & ~alone.controlled)[0, -1].sum()) <= 52


def test_where_they_stand_is_drawn() -> None:
    made = layout("standing")
    assert made.stand is not None
    place, seconds = made.start[:, -1], made.stand[:, -1]
    assert made.stand[:, 0].eq(0).all()
    assert 2 < float(seconds.min()) < 2.1 and 4.9 < float(seconds.max()) < 5
    assert -1 < float(place[:, 0].min()) < -0.95 and 0.95 < float(place[:, 0].max()) < 1
    # some in the door, some on either side of it
    inside = place[:, 0].abs() < 0.15
    assert 20 < int(inside.sum()) < 80 and 90 < int((place[:, 0] > 0).sum()) < 210
    assert len(made.goal[:, -1].unique()) == 2 * 4  # the two of every width


def test_no_person_stands_in_a_wall() -> None:
    env = make_env("standing:width=[0.7,1.2],thickness=[0.1,0.3],at=[-0.3,0.3]", num_envs=60)
    env.reset()
    distance, _ = env.bank.closest_wall(env.state.position, env.state.map_id, env.state.pose)
    assert float(distance[:, -1].min()) > 0.19
