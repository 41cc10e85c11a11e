"""What a policy remembers of how people began."""

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of
from pedzoo.policies.memory import FirstSeenMemory
from tests.helpers.batches import make_batch

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
