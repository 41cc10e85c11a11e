"""Any forecaster walks: its noise, and how people began."""

from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

import pedzoo
from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError
from pedzoo.core.types import PRED_LEN
from pedzoo.eval.rollout import prepare, run
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import load
from pedzoo.policies.memory import FirstSeenMemory
from pedzoo.policies.walker import Walker
from pedzoo.sim.make import make_env
from tests.helpers.batches import make_batch


class Echo(Forecaster):
    """Walks its own noise."""

    noise_dim = 2

    def __init__(self) -> None:
        super().__init__()
        self.config = {}

    def next_steps(self, batch: TensorDict, noise: Tensor | None, steps: int, horizon: int) -> Tensor:
        """Return the noise as the first step, twice that as the second, and so on."""
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


def test_displacement_over_0_4_s_is_the_velocity() -> None:
    env = make_env("door:people=2", num_envs=3)
    now = env.reset()
    model = load("sgan_goal.zara1")
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        action = pedzoo.policy(model)(now)["agents", "action"]
        expected = model.mode(now, PRED_LEN)[:, 0, :, 0] / 0.4
    assert torch.allclose(action, expected, atol=1e-6)


def test_misspelt_noise_is_refused() -> None:
    with pytest.raises(UserError, match="did you mean 'episode'"):
        Walker(Echo(), "epsiode")  # pyright: ignore[reportArgumentType]


@pytest.mark.usefixtures("alexnet")
@pytest.mark.parametrize("blind", [None, "pooling", "map"])
def test_the_papers_network_taught_in_the_loop_keeps_clear_of_what_it_sees(blind: str | None) -> None:
    """No safety layer: blind to people it touches people, blind to walls it touches walls."""
    tool = Path(__file__).parents[2] / "tools" / "zoo" / "ablations.py"
    policy = f"{tool}:Blind:taken={blind}" if blind else "sgan_goal_map.indoor:safety=false"
    walker, env = prepare(policy, "door:width=[0.7, 0.8, 0.9, 1.0, 1.2]", "compiled", 24)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        walk = run(walker, env)
    people, walls = (
        float(touch.flatten(1).any(1).double().mean()) for touch in (walk.agent_contact, walk.wall_contact)
    )
    assert people > 0.5 if blind == "pooling" else people < 0.2
    assert walls > 0.5 if blind == "map" else walls < 0.2


# What a policy remembers of how people began


FIRST = make_batch((2, 2), padding=0.0)


def scenes(step: int, left: Tensor, key: int = 5, ids: tuple[int, int] = (0, 1)) -> TensorDict:
    """Return two scenes of two people, who have walked one metre along x per step."""
    batch = FIRST.clone()
    agents = agents_of(batch)
    order = torch.tensor(ids)
    agents["id"] = order.expand(2, -1)
    agents["history"] = agents["history"][:, order] + torch.tensor([float(step), 0.0])
    agents["remaining_path"] = left[order].view(1, 2, 1).expand(2, -1, -1).clone()
    batch["scene_key"] = torch.tensor([[key], [key + 1]])
    batch["time"] = torch.full((2, 1), 0.4 * step)
    return batch


def test_the_first_history_stays_and_progress_adds_up() -> None:
    """Also where people change their slots, and other scenes are seen in between."""
    memory, left = FirstSeenMemory(), torch.tensor([9.0, 6.0])
    begun = agents_of(memory.add(scenes(0, left)))
    assert torch.equal(begun["first_history"], agents_of(FIRST)["history"])
    assert not begun["elapsed"].any() and not begun["progress"].any()
    swapped = agents_of(memory.add(scenes(1, left - 0.5, ids=(1, 0))))
    assert torch.equal(swapped["first_history"], begun["first_history"][:, [1, 0]])
    memory.add(scenes(7, left, key=90))
    later = agents_of(memory.add(scenes(2, left - 1.2)))
    assert torch.equal(later["first_history"], begun["first_history"])
    torch.testing.assert_close(later["elapsed"], torch.full((2, 2, 1), 0.8))
    torch.testing.assert_close(later["progress"], torch.full((2, 2, 1), 1.2))


def test_a_new_goal_begins_a_new_way_but_not_a_new_style() -> None:
    memory, left = FirstSeenMemory(), torch.tensor([3.0, 6.0])
    begun = agents_of(memory.add(scenes(0, left)))
    later = agents_of(memory.add(scenes(1, torch.tensor([12.0, 5.0]))))
    assert torch.equal(later["first_history"], begun["first_history"])
    assert later["elapsed"][0, :, 0].tolist() == [0.0, torch.tensor(0.4).item()]
    assert later["progress"][0, :, 0].tolist() == [0.0, 1.0]
    assert not begun["called"].any() and later["called"][0, :, 0].tolist() == [True, False]


def test_people_who_are_not_known_for_eight_rows_wait_for_them() -> None:
    memory, left = FirstSeenMemory(), torch.tensor([9.0, 6.0])
    new = scenes(0, left)
    agents_of(new)["valid"][:, 0, :3] = False
    memory.add(new)
    later = agents_of(memory.add(scenes(1, left)))
    history = agents_of(scenes(1, left))["history"]
    assert torch.equal(later["first_history"][:, 0], history[:, 0])
    assert torch.equal(later["first_history"][:, 1], agents_of(FIRST)["history"][:, 1])


def test_people_who_are_moved_from_now_on_are_called() -> None:
    """They may have been seen before, as those who stand in a door for a while."""
    memory, left, seen = FirstSeenMemory(), torch.tensor([9.0, 6.0]), {}
    for step in range(4):
        batch = scenes(step, left)
        agents_of(batch)["controlled"] = torch.tensor([step >= 2, True]).expand(2, -1)
        seen = agents_of(memory.add(batch))
        assert seen["called"][0, :, 0].tolist() == [step == 2, False]
    assert seen["elapsed"][0, :, 0].tolist() == pytest.approx([0.4, 1.2])


def test_people_who_held_a_place_and_move_on_are_called() -> None:
    """The next place of a queue may be so near that the way to it is hardly longer."""
    memory, left = FirstSeenMemory(), torch.tensor([0.2, 6.0])
    for step, holds in ((0, False), (1, True), (2, False), (3, False)):
        batch = scenes(step, left)
        agents = agents_of(batch)
        agents["desired_velocity"] = agents["pref_speed"] * torch.tensor([1.0, 0.0])
        agents["desired_velocity"][:, 0] *= 0.3 if holds else 1.0
        assert agents_of(memory.add(batch))["called"][0, :, 0].tolist() == [step == 2, False]


def test_people_who_stand_though_told_to_walk_are_hindered() -> None:
    """The first one stands from the third decision on; the policy asks both to walk, and then to stand."""
    memory, left = FirstSeenMemory(), torch.tensor([9.0, 6.0])
    walk, stand = torch.full((2, 2, 2), 0.3), torch.zeros(2, 2, 2)
    hindered = []
    for step, asked in enumerate((walk, stand, walk, stand, stand)):
        batch = scenes(min(step, 1), left)
        batch["time"] = torch.full((2, 1), 0.4 * step)
        place = agents_of(batch)["history"]
        place[:, 0] = 0.0
        place[:, 0, :, 0] = torch.tensor([1.0, 1, 1, 1, 1, 1, 1, 2]) if step < 2 else 2.0
        place[:, 1, :, 0] = torch.arange(8.0) + step
        seen = agents_of(memory.add(batch))
        memory.remember(asked, asked)
        hindered.append(seen["hindered"][0, :, 0].tolist())
    # at the second decision both were asked to stand, so the first one does that of its own accord
    assert hindered == [[False, False]] * 3 + [[True, False]] * 2


def test_blocked_agents_start_pushing() -> None:
    """Both wish to walk, and stand; the first one is asked to, the second one held back."""
    memory, left = FirstSeenMemory(), torch.tensor([9.0, 6.0])
    wish = torch.full((2, 2, 2), 0.3)
    asked = wish * torch.tensor([1.0, 0.0]).view(1, 2, 1)
    hindered, pressing = [], []
    for step in range(4):
        batch = scenes(0, left)
        batch["time"] = torch.full((2, 1), 0.4 * step)
        agents_of(batch)["history"][:] = 2.0
        seen = agents_of(memory.add(batch))
        memory.remember(wish, asked if step < 2 else torch.zeros_like(wish))
        hindered.append(seen["hindered"][0, :, 0].tolist())
        pressing.append(seen["pressing"][0, :, 0].tolist())
    assert hindered == [[False, False]] + [[True, True]] * 3
    assert pressing == [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 0.0]]


def test_a_clock_that_went_back_and_a_long_absence_begin_anew() -> None:
    memory, left = FirstSeenMemory(), torch.tensor([9.0, 6.0])
    for step in range(3):
        memory.add(scenes(step, left - 0.5 * step))
    again = scenes(0, left)
    agents_of(again)["history"] += 3.0
    seen = agents_of(memory.add(again))
    assert torch.equal(seen["first_history"], agents_of(again)["history"])
    late = scenes(20, left)
    seen = agents_of(memory.add(late))
    assert torch.equal(seen["first_history"], agents_of(late)["history"]) and not seen["elapsed"].any()
