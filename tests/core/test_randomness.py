"""Random numbers by counter: the same for every batch, and as random as they must be."""

import json
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.core.bodies import RobotBody
from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws, join, mix, normal, uniform
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import Spec, build, build_ungrouped
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.models.zoo.loading import untrained
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy
from pedzoo.sim.make import make_env, prepare_scenario
from pedzoo.sim.robots.env import make_robot_env
from pedzoo.sim.robots.scenes import with_robots
from pedzoo.sim.scenario import Scenario
from pedzoo.sim.scenarios.goals import Goals


def test_a_scene_and_its_people_draw_the_same_in_every_batch() -> None:
    draws = Draws.for_episodes(7, torch.arange(100))
    alone = Draws.for_episodes(7, torch.tensor([42])).normal("start", 5, 2)
    assert torch.equal(draws.normal("start", 5, 2)[42], alone[0])
    assert torch.equal(draws.uniform("speed", 9)[:, :4], draws.uniform("speed", 4))
    assert torch.equal(draws.uniform("place", 9, 2)[:, :4], draws.uniform("place", 4, 2))


def test_seed_episode_purpose_and_index_all_matter() -> None:
    base = Draws.for_episodes(0, torch.tensor([0])).uniform("a", 1)
    others = [
        Draws.for_episodes(1, torch.tensor([0])).uniform("a", 1),
        Draws.for_episodes(0, torch.tensor([1])).uniform("a", 1),
        Draws.for_episodes(0, torch.tensor([0])).uniform("b", 1),
        Draws.for_episodes(0, torch.tensor([0])).uniform("a", 2)[:, 1:],
        Draws.for_episodes(-1, torch.tensor([0])).uniform("a", 1),
        Draws.for_episodes(2**63, torch.tensor([0])).uniform("a", 1),
    ]
    assert len({float(value) for value in [base, *others]}) == len(others) + 1


KINDS: list[Callable[[int], Any]] = [np.int8, np.uint8, np.int64, np.uint64, np.array, torch.tensor]
"""Whole numbers of other libraries."""


@pytest.mark.parametrize("seed", [0, 3, 127, -3, -128, 2**63, 2**64 - 1])
def test_a_whole_number_of_any_library_is_that_number(seed: int) -> None:
    expected = Draws.for_episodes(seed, torch.arange(3)).key
    for kind in (np.uint64,) if seed > 127 else KINDS if seed >= 0 else (np.int8, *KINDS[2:3], *KINDS[4:]):
        assert torch.equal(Draws.for_episodes(cast("Any", kind(seed)), torch.arange(3)).key, expected)


def test_seeds_of_other_libraries_choose_the_same_scenes() -> None:
    walks, prepared = load_policy("go_to_goal"), prepare_scenario("circle:people=2")
    robots = make_robot_env("circle:people=2", warm_start="static")

    def scenes(seed: Any) -> list[Tensor]:
        controller, env = (
            Controller(walks, dt=0.1, seed=seed),
            make_env(prepared, seed=seed, warm_start="static"),
        )
        keys = [controller._key, cast("Tensor", env.reset()["scene_key"])]
        controller.reset(seed)
        env.set_seed(seed)
        robots.set_seed(seed)
        return [*keys, controller._key, *(cast("Tensor", one.reset()["scene_key"]) for one in (env, robots))]

    for seed in (np.int64(3), np.uint8(200), np.int64(-3), torch.tensor(3)):
        assert all(map(torch.equal, scenes(seed), scenes(int(seed)))), seed
    for wrong in (3.0, np.float32(3), "3", [3], np.array([3.0])):
        with pytest.raises(UserError, match="expected a whole number"):
            robots.set_seed(wrong)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("kind", KINDS)
def test_counts_of_any_library_are_counts(kind: Callable[[int], Any]) -> None:
    four = kind(4)
    env = make_env("circle:people=2", four, first_episode=four, stride=four, warm_start="static")
    other = make_env("circle:people=2", 4, first_episode=4, stride=4, warm_start="static")
    assert torch.equal(*(cast("Tensor", one.reset()["scene_key"]) for one in (env, other)))
    for name in ("door", "standing", "queue", "groups"):
        given = {"people": four}
        made = build_ungrouped(SCENARIOS.get(name, Scenario), given)
        scenes = build(SCENARIOS, Spec(name, given), Scenario), made
        assert all(type(scene.people) is int and scene.people == 4 for scene in scenes)
    goals = (
        Goals("flat", people=(kind(2), four)),
        build(SCENARIOS, Spec("goals", {"people": [2, four]}), Goals),
    )
    assert all((scene.fewest, scene.people) == (2, 4) for scene in goals)
    assert with_robots("hallway", [RobotBody()], kind(2)).robot_goals == 2
    assert untrained("sgan", noise_dim=four).config["noise_dim"] == 4
    options = EvaluationOptions(episodes=four, rollouts=None, keep_episodes=four)
    report = Evaluation(["go_to_goal"], ["door"], options, seeds=[four, 4, kind(5)]).report()
    assert json.loads(json.dumps(report))["seeds"] == [4, 5] and report["protocol"]["episodes"] == 4


def test_splitmix_by_hand() -> None:
    """The hash of 64-bit integers in Python, which have no sign and no overflow."""
    for value in (1, 12345, 2**63 + 17, 2**64 - 1):
        x = value
        x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) % 2**64
        x ^= x >> 31
        signed = value - 2**64 if value >= 2**63 else value
        assert int(mix(torch.tensor([signed]))) % 2**64 == x


def test_distributions() -> None:
    key = join(torch.zeros(200_000, dtype=torch.long), torch.arange(200_000))
    u, n = uniform(key), normal(key)
    assert 0 < float(u.min()) < float(u.max()) < 1
    bins = torch.histc(u, 20, 0, 1)
    chi_squared = float(((bins - 10_000) ** 2 / 10_000).sum())
    assert chi_squared < 50  # 19 degrees of freedom: 1 in 10,000
    assert abs(float(n.mean())) < 0.01
    assert abs(float(n.std()) - 1) < 0.01
    neighbours = torch.stack((u[:-1], u[1:]))
    assert abs(float(torch.corrcoef(neighbours)[0, 1])) < 0.01
    counts = Draws.for_episodes(3, torch.arange(6000)).integers("die", 6).bincount(minlength=6)
    assert len(counts) == 6
    assert int(counts.min()) > 850
