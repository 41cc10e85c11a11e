"""Short-term goals: as far ahead for people who walk as for recorded people, whoever asks the planner."""

from typing import Any

import pytest
import torch
from helpers.scenes import Watch, prepared
from torch import Tensor

from pedzoo.core.types import AHEAD_SECONDS
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.rollout import rollout
from pedzoo.maps.plans import load_plan
from pedzoo.metrics.closed_loop import measure
from pedzoo.policies.controller.controller import Controller
from pedzoo.sim.make import make_env

PLANS = ("apartment.0", "apartment.7", "office.7")


def seen_by(env: Any, decisions: int) -> list[Any]:
    """Return the scenes in which people walk along their paths."""
    watch = Watch()
    env.rollout(decisions, watch, break_when_any_done=False)
    return watch.seen


def distances(scenes: list[Any]) -> tuple[Tensor, Tensor, Tensor]:
    """Return of all who walk (N,): distance of the goal, that of training, and of how they start, metres."""
    goal, expected, bends = [], [], []
    for scene in scenes:
        agents = scene["agents"]
        away, desired = agents["goal"] - agents["history"][:, :, -1], agents["desired_velocity"]
        walks = agents["mask"] & desired.any(-1)
        goal.append(away.norm(dim=-1)[walks])
        expected.append(AHEAD_SECONDS * agents["pref_speed"][..., 0][walks])
        bends.append((torch.cosine_similarity(away, desired, dim=-1) < 0.999)[walks])
    return torch.cat(goal), torch.cat(expected), torch.cat(bends)


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("seed", range(2))
def test_goals_of_the_environment_are_as_far_as_in_training(plan: str, seed: int) -> None:
    env = make_env(prepared(f"goals:map={plan},people=5,goals=2,pool=12"), num_envs=4, seed=seed)
    goal, expected, bends = distances(seen_by(env, 25))
    assert int(bends.sum()) > 50  # they go round corners
    assert ((goal - expected).abs() < 0.05).all()


@pytest.mark.parametrize("plan", PLANS)
def test_goals_of_the_controller_are_as_far_as_in_training(plan: str) -> None:
    """The people of an environment's scene, moved by hand."""
    scenario = prepared(f"goals:map={plan},people=5,goals=2,pool=12")
    first = make_env(scenario, seed=3)
    first.reset()
    state, watch = first.state, Watch()
    place = {i: state.position[0, i].numpy() for i in range(5)}
    asked = {i: state.goal_point[0, i].numpy() for i in range(5)}
    controller = Controller(watch, load_plan(plan), dt=0.4)
    for _ in range(25):
        velocity = controller.step(place, asked)
        place, asked = {i: place[i] + 0.4 * velocity[i] for i in place}, {}
    goal, expected, bends = distances(watch.seen)
    assert int(bends.sum()) > 5
    assert ((goal - expected).abs() < 0.05).all()


def test_whoever_waits_has_a_goal_no_farther_than_their_place() -> None:
    """Only goals of people who walk are moved out."""
    scenes = seen_by(make_env("queue", num_envs=2, seed=1), 20)
    for scene in scenes:
        agents = scene["agents"]
        slow = agents["desired_velocity"].norm(dim=-1) < 0.98 * agents["pref_speed"][..., 0]
        away = (agents["goal"] - agents["history"][:, :, -1]).norm(dim=-1)
        assert (away[slow & agents["mask"]] < 0.6).all()
    controller = Controller(watch := Watch(), load_plan("flat"), dt=0.4)
    for _ in range(10):
        controller.step({"a": (1.5, 1.5), "b": (1.5, 3.0)}, {"a": (1.6, 1.5), "b": (3.5, 3.0)})
    away = (watch.seen[-1]["agents", "goal"] - watch.seen[-1]["agents", "history"][:, :, -1]).norm(dim=-1)
    assert sorted(away[0].tolist()) == pytest.approx([0.0, AHEAD_SECONDS * 1.3], abs=0.1)


def test_distances_are_those_of_recordings() -> None:
    """Of ``window_end`` goals, in metres and in what people walk in that time at the speed they like."""
    data = TrajectoryDataModule(fold="embedded", goal="window_end")
    data.setup("fit")
    recorded, reach, _ = distances(list(data.train_dataloader()))
    env = make_env(prepared("goals:map=apartment.0,people=5,goals=2,pool=12"), num_envs=16)
    walked, ahead, bends = distances(seen_by(env, 20))
    assert float((recorded / reach).median()) == pytest.approx(float((walked / ahead).median()), abs=0.02)
    shares = [torch.histc(of, 16, 0.0, 8.0) / len(of) for of in (recorded, walked[bends])]
    assert float(torch.minimum(*shares).sum()) > 0.55  # that both have in common


@pytest.mark.parametrize("name", ["approach_net_goal_map.controller_open", "anchor_net_goal.zara1"])
def test_models_of_recordings_do_not_creep_round_corners(name: str) -> None:
    """Alone in an apartment they are about as fast as they like to be."""
    scenario = prepared("goals:map=apartment.0,people=1,goals=1,pool=6")
    speed = measure(rollout(name, scenario, "compiled", episodes=6)[0])[0]["speed_m_per_s"]
    assert speed > 0.9
