"""Any forecaster walks: whose noise it gets, and how much of a prediction is walked."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.types import PRED_LEN
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import load
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env


class Echo(Forecaster):
    """Walks its own noise, and counts how often it is asked."""

    noise_dim = 2

    def __init__(self) -> None:
        super().__init__()
        self.asked = 0
        self.config = {}

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the noise as the first step, twice that as the second, and so on."""
        self.asked += 1
        assert horizon == PRED_LEN
        shape: Any = batch["agents", "mask"].shape
        z = torch.zeros(*shape, 2) if noise is None else noise
        return z.unsqueeze(2) * torch.arange(1, steps + 1).view(1, 1, -1, 1)


def scene(scenes: int = 3, people: int = 4, time: float = 0.0, key: int = 7) -> Any:
    """Return what noise depends on, and where people are: each on a spot of their own."""
    people_there = torch.ones(scenes, people, dtype=torch.bool)
    slots = torch.arange(people).expand(scenes, people)
    apart = slots.view(scenes, people, 1, 1) * torch.ones(8, 2)
    agents = TensorDict(
        {"mask": people_there, "id": slots, "controlled": people_there, "history": apart}, [scenes, people]
    )
    keys = key + torch.arange(scenes).unsqueeze(1)
    return TensorDict({"agents": agents, "scene_key": keys, "time": torch.full((scenes, 1), time)}, [scenes])


def drawn(walker: Walker, **where: Any) -> Tensor:
    """Return what the noise was (B, A, 2)."""
    with set_exploration_type(ExplorationType.RANDOM):
        return walker(scene(**where))["agents", "action"] * 0.4


@pytest.mark.parametrize("noise", ["episode", "step", "scene", "mixed"])
def test_noise_goes_by_scene_person_time_and_seed(noise: Any) -> None:
    """That of an episode stays, that of a step changes, one of a scene is the same for all in it."""
    first = drawn(Walker(Echo(), noise), time=0.4)
    assert torch.equal(drawn(Walker(Echo(), noise, noise_seed=0), time=0.4), first)
    assert len(first.flatten(0, 1).unique(dim=0)) == (3 if noise == "scene" else 12)
    assert torch.equal(first, first[:, :1].expand_as(first)) == (noise == "scene")
    assert torch.equal(drawn(Walker(Echo(), noise), time=4.0), first) == (noise in ("episode", "scene"))
    seeds = [drawn(Walker(Echo(), noise, noise_seed=seed), time=0.4) for seed in (1, 2)]
    for other in (*seeds, drawn(Walker(Echo(), noise), time=0.4, key=100)):
        assert not (other == first).any()
    assert not (seeds[0] == seeds[1]).any()


@pytest.mark.parametrize(("numbers", "stay"), [(2, 1), (5, 3), (8, 4), (1, 1)])
def test_mixed_noise_is_half_of_the_episode_half_of_the_step(numbers: int, stay: int) -> None:
    """The first half of the numbers stays for an episode as `episode` has it, the rest is that of `step`."""
    model = Echo()
    model.noise_dim = numbers
    cases: Any = (("mixed", 0.4), ("mixed", 4.0), ("episode", 4.0), ("step", 4.0))
    with set_exploration_type(ExplorationType.RANDOM):
        noises: Any = [Walker(model, noise=noise).noise_of(scene(time=time)) for noise, time in cases]
    early, late, always, now = noises
    assert late.shape == (3, 4, numbers)
    assert torch.equal(late[..., :stay], early[..., :stay])
    assert torch.equal(late[..., :stay], always[..., :stay])
    assert torch.equal(late[..., stay:], now[..., stay:])
    assert not (late[..., stay:] == early[..., stay:]).any()


EARLIER = [2.02319288, 0.02603248, -1.06847107, 0.15305239]


def test_noise_is_what_it_was_in_earlier_versions() -> None:
    """Tables and cards rest on it: numbers of 2026-11 for seed 0."""
    result = drawn(Walker(Echo()), scenes=1, people=2)
    assert result.flatten().tolist() == pytest.approx(EARLIER, abs=1e-5)


def test_noise_does_not_depend_on_who_else_is_there() -> None:
    walker = Walker(Echo())
    assert torch.equal(drawn(walker, people=9)[:, :4], drawn(walker, people=4))
    assert torch.equal(drawn(walker, scenes=5)[:3], drawn(walker, scenes=3))


def test_noise_follows_who_people_are_not_where_they_stand() -> None:
    walker, first, turned = Walker(Echo()), scene(), scene()
    first["agents", "id"] = torch.tensor([5, 6, 7, 8]).expand(3, 4)
    turned["agents", "id"] = torch.tensor([8, 7, 6, 5]).expand(3, 4)
    with set_exploration_type(ExplorationType.RANDOM):
        one, other = (walker(batch)["agents", "action"] for batch in (first, turned))
    assert torch.equal(one, other.flip(1))


@pytest.mark.parametrize("kind", [ExplorationType.DETERMINISTIC, ExplorationType.MODE, ExplorationType.MEAN])
def test_deterministic_exploration_is_noise_zero(kind: ExplorationType) -> None:
    with set_exploration_type(kind):
        assert (Walker(Echo())(scene())["agents", "action"] == 0).all()


def test_execute_steps_walks_a_prediction_before_the_next() -> None:
    model = Echo()
    walker = Walker(model, execute_steps=3)
    actions = [drawn(walker, time=0.4 * step) for step in range(6)]
    assert model.asked == 2
    for step, action in enumerate(actions):
        assert torch.allclose(action, actions[0] * (step % 3 + 1))
    # another batch begins: nothing of the old plan is left
    assert drawn(walker, scenes=2).shape == (2, 4, 2)


def test_a_scene_that_begins_anew_gets_a_plan_of_its_own() -> None:
    walker = Walker(Echo(), execute_steps=4)
    drawn(walker)
    later = scene(time=0.8)
    later["time"][1] = 0.0
    with set_exploration_type(ExplorationType.RANDOM):
        action = walker(later)["agents", "action"] * 0.4
    first = drawn(Walker(Echo()))
    assert torch.allclose(action, first * torch.tensor([3.0, 1.0, 3.0]).view(3, 1, 1))


def test_displacement_over_0_4_s_is_the_velocity() -> None:
    env = make_env("door:people=2", num_envs=3)
    now = env.reset()
    model = load("sgan_goal.zara1")
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        action = pedzoo.policy(model)(now)["agents", "action"]
        expected = model.mode(now, PRED_LEN)[:, 0, :, 0] / 0.4
    assert torch.allclose(action, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"noise": "epsiode"}, "did you mean 'episode'"), ({"execute_steps": 9}, "expected 1 to 8")],
)
def test_wrong_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        Walker(Echo(), **settings)


def test_plans_belong_to_scenes() -> None:
    walker = Walker(Echo(), execute_steps=4)
    first = drawn(walker)
    drawn(walker, key=50)  # three other scenes
    drawn(walker, scenes=5)
    assert torch.allclose(drawn(walker, time=0.4), first)  # a new plan, at its first step
    assert torch.allclose(drawn(walker, time=0.8), 2 * first)
