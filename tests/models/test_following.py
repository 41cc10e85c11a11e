"""People keep behind others: who slows down, and why no arch of people holds itself."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.linalg import vector_norm as length

from pedzoo.core.batch import agents_of
from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.models.architectures.social_walker import SocialWalker
from pedzoo.models.blocks.people.following import (
    BACK,
    BACKS_OFF,
    COMES,
    GAP_SECONDS,
    LUCK,
    MEETING,
    PRESSES,
    WIDTH,
    WIDTH_AT_WALLS,
    held_back,
)
from pedzoo.models.blocks.people.nearest import nearest
from pedzoo.models.blocks.people.step_features import Situation
from pedzoo.policies.clearance import kept_clear_in_torch
from pedzoo.policies.safety_layer import kept_clear
from pedzoo.policies.walker import Walker
from tests.helpers.batches import changed, make_batch
from tests.helpers.crowds import ROOM
from tests.helpers.crowds import crowd as about_a_door


def situation(place: Tensor, velocity: Tensor, ahead: Tensor, **more: Tensor) -> Situation:
    """Return people (A, 2) who have walked at velocities (A, 2), m/s, and want to go ``ahead`` (A, 2)."""
    back = torch.arange(-7.0, 1.0).view(8, 1) * STEP_SECONDS
    history = (place.unsqueeze(1) + back * velocity.unsqueeze(1)).unsqueeze(0)
    batch = make_batch((len(place),), padding=0.0)
    wanted = {"goal": (place + 20 * ahead).unsqueeze(0), "desired_velocity": 1.25 * ahead.unsqueeze(0)}
    liked, radius = (torch.full((1, len(place), 1), value) for value in (1.25, BODY_RADIUS))
    now = Situation.of(
        changed(batch, history=history, pref_speed=liked, radius=radius, **wanted), walls=False
    )
    return now._replace(**{key: value.unsqueeze(0) for key, value in more.items()})


def held(wish: Tensor, now: Situation, narrow: float | Tensor = 0.0, chance: Tensor | None = None) -> Tensor:
    """Return the velocities (A, 2) of people who wish for velocities (A, 2)."""
    others = nearest(now.history, now.mask, now.radius, now.ahead)
    around = torch.zeros_like(now.late) + narrow
    chance = torch.zeros_like(now.late) if chance is None else chance.unsqueeze(0)
    return held_back(wish.unsqueeze(0), now, others, around, around, chance)[0]


EAST = torch.tensor([[1.0, 0.0], [1.0, 0.0]])


def one_behind(
    gap: float, aside: float = 0.0, speed: float = 0.5, **more: Tensor
) -> tuple[Tensor, Situation]:
    """Return wishes of two who go east: the second one walks at 1.2 m/s, this far behind the first."""
    along = math.sqrt(WIDTH**2 - aside**2) + gap
    place = torch.tensor([[along, aside], [0.0, 0.0]])
    wish = torch.tensor([[speed, 0.0], [1.2, 0.0]])
    return wish, situation(place, wish, EAST, **more)


@pytest.mark.parametrize(("gap", "aside"), [(0.1, 0.0), (0.05, 0.3), (0.0, 0.0)])
def test_people_close_a_gap_no_faster_than_in_its_time(gap, aside):
    wish, now = one_behind(gap, aside)
    result = held(wish, now)
    assert torch.equal(result[0], wish[0])
    assert result[1].tolist() == pytest.approx([0.5 + gap / GAP_SECONDS, 0.0], abs=1e-3)


def test_people_far_beside_or_behind_standing_ones_walk_on():
    for wish, now in (one_behind(0.4), one_behind(0.1, 0.54, 1.2), one_behind(0.1, speed=0.0)):
        assert torch.equal(held(wish, now), wish)
    far_aside = torch.tensor([[0.3, 0.56], [0.0, 0.0]])
    wish = torch.tensor([[0.5, 0.0], [1.2, 0.0]])
    assert torch.equal(held(wish, situation(far_aside, wish, EAST)), wish)


def test_those_who_come_the_other_way_are_no_ones_to_follow():
    ahead = torch.tensor([[-1.0, 0.0], [1.0, 0.0]])
    wish = 1.2 * ahead
    assert torch.equal(held(wish, situation(torch.tensor([[0.7, 0.0], [0.0, 0.0]]), wish, ahead)), wish)


def two_who_meet(gap: float, turned: float = 0.0) -> tuple[Tensor, Situation]:
    """Return wishes of two who come towards each other at 1 m/s, ``gap`` metres beyond `MEETING` apart.

    The second one's way is turned, radians.
    """
    ahead = torch.tensor([[-1.0, 0.0], [math.cos(turned), math.sin(turned)]])
    place = torch.tensor([[MEETING + gap, 0.0], [0.0, 0.0]])
    return ahead.clone(), situation(place, ahead, ahead)


@pytest.mark.parametrize("first", [0, 1])
def test_person_nearer_to_a_narrow_place_goes_first(first):
    wish, now = two_who_meet(1.5 * GAP_SECONDS)
    around = torch.tensor([[0.2, 0.2]])
    around[0, first] = 0.6
    result = held(wish, now, around)
    assert torch.equal(result[first], wish[first])
    assert float(result[1 - first].norm()) == pytest.approx(0.5, abs=1e-3)  # 1.5 - the other's 1 m/s
    luck = torch.zeros(2)
    luck[1 - first] = 0.5 / LUCK  # chance tells the other one to go first, who is farther by 0.4 only
    assert torch.equal(held(wish, now, around, luck)[1 - first], wish[1 - first])


def test_mirror_images_go_one_after_the_other_by_chance():
    wish, now = two_who_meet(0.1)
    for first in (0, 1):
        luck = torch.zeros(2)
        luck[first] = 0.1
        result = held(wish, now, 1.0, luck)
        assert torch.equal(result[first], wish[first])
        assert not result[1 - first].any()


def test_nobody_waits_in_the_open_or_for_crossing_people():
    luck = torch.tensor([1.0, 0.0])
    wish, now = two_who_meet(0.1)
    assert torch.equal(held(wish, now, 0.0, luck), wish)  # in the open
    assert not torch.equal(held(wish, now, 0.1, luck), wish)
    crossing, across = two_who_meet(0.1, turned=1.2)
    assert torch.equal(held(crossing, across, 1.0, luck), crossing)
    slow = now.history.clone()
    slow[0, 0, :-1] = slow[0, 0, -1:] + torch.tensor([0.9 * COMES * STEP_SECONDS, 0.0])
    assert torch.equal(held(wish, now._replace(history=slow), 1.0, luck), wish)  # the first one stands
    passed, behind = two_who_meet(-2 * MEETING)
    assert torch.equal(held(passed, behind, 1.0, luck), passed)
    aside = now.history.clone()
    aside[0, 0, :, 1] += MEETING + 0.02
    assert torch.equal(held(wish, now._replace(history=aside), 1.0, luck), wish)  # beside their way


def test_near_walls_people_keep_more_room():
    wish, now = one_behind(WIDTH_AT_WALLS - WIDTH + 0.02)
    open_space, narrow = (held(wish, now, how) for how in (0.0, 1.0))
    assert float(open_space[1, 0]) == pytest.approx(1.15, abs=1e-3)
    assert float(narrow[1, 0]) == pytest.approx(0.5 + 0.02 / GAP_SECONDS, abs=1e-3)


def test_a_row_of_people_sets_out_at_once():
    """They stand; each knows that the one in front goes: three rounds for as many followers."""
    place = torch.tensor([[-0.62 * number, 0.0] for number in range(5)])
    ahead, wish = torch.tensor([[1.0, 0.0]]).expand(5, 2), torch.tensor([[1.2, 0.0]]).expand(5, 2)
    speed = held(wish, situation(place, torch.zeros(5, 2), ahead))[:, 0]
    assert speed.tolist() == pytest.approx([1.2, 1.2, 1.2, 1.05, 1.05], abs=1e-3)
    moves = torch.tensor([False, True, True, True, True])  # the first one is not ours, and stands
    assert torch.equal(
        held(wish[:2], situation(place[:2], torch.zeros(2, 2), EAST, moves=moves[:2])), wish[:2]
    )


def arch(pressing: float = 0.0) -> tuple[Tensor, Situation]:
    """Return three who stand in a ring, each behind the next: a taut way round a corner can lead so."""
    angle = torch.arange(3) * (2 * math.pi / 3)
    place = 0.3 * torch.stack((angle.cos(), angle.sin()), -1)
    ahead = torch.nn.functional.normalize(place.roll(-1, 0) - place, dim=-1)
    ahead = torch.nn.functional.normalize(ahead + torch.tensor([1.2, 0.0]), dim=-1)
    more = {"hindered": torch.ones(3), "remaining": torch.tensor([4.0, 4.2, 4.4])}
    now = situation(place, torch.zeros(3, 2), ahead, **more, pressing=torch.tensor([pressing, 0.0, 0.0]))
    return 1.2 * (place.roll(-1, 0) - place) / 0.52, now


def test_standing_person_with_shortest_path_waits_for_none():
    wish, now = arch()
    result = held(wish, now)
    assert torch.equal(result[0], wish[0])
    walked = held(wish, now._replace(hindered=torch.zeros(1, 3)))
    assert float(walked.norm(dim=-1).max()) <= float(result.norm(dim=-1).max())


def test_those_around_a_person_who_cannot_get_on_press_too():
    wish, now = arch(pressing=float(PRESSES))
    assert torch.equal(held(wish, now), wish)
    assert not torch.equal(held(wish, arch(pressing=PRESSES - 1.0)[1]), wish)


@pytest.mark.parametrize("longer", [0, 1])
def test_longer_path_backs_off(longer):
    ahead = torch.tensor([[-1.0, 0.0], [1.0, 0.0]])
    left = torch.tensor([4.0, 4.0])
    left[longer] = 6.0
    more = {"hindered": torch.ones(2), "remaining": left, "pressing": torch.full((2,), float(BACKS_OFF))}
    now = situation(torch.tensor([[0.32, 0.0], [0.0, 0.0]]), torch.zeros(2, 2), ahead, **more)
    result = held(ahead.clone(), now)
    assert torch.equal(result[1 - longer], ahead[1 - longer])
    assert torch.equal(result[longer], -BACK * ahead[longer])


def follower(follows: bool = True) -> SocialWalker:
    torch.manual_seed(0)
    parts = {"hidden_dim": 0, "style_prior": True, "avoids": True, "walls": False, "follows": follows}
    return SocialWalker.of(**parts).eval()


def crowd() -> TensorDict:
    """Return five people close behind each other."""
    batch = make_batch((5,), padding=0.0, seed=3)
    agents = agents_of(batch)
    agents["history"] *= 0.12
    agents["desired_velocity"] = 1.25 * torch.nn.functional.normalize(agents["desired_velocity"], dim=-1)
    agents["pref_speed"] = torch.full_like(agents["pref_speed"], 1.25)
    return batch


@torch.no_grad()
def test_walker_remembers_raw_and_constrained_actions():
    batch = crowd()
    agents_of(batch)["remaining_path"] = torch.full((1, 5, 1), 9.0)
    batch["scene_key"], batch["time"] = torch.tensor([[5]]), torch.zeros(1, 1)
    for follows in (True, False):
        seen = agents_of(Walker(follower(follows), safety=False)(batch.clone()))
        assert ("raw_action" in seen.keys()) == follows
        if follows:
            assert (length(seen["raw_action"], dim=-1) >= length(seen["action"], dim=-1) - 1e-5).all()


@pytest.mark.parametrize("shoulders", [0.0, 0.71])
def test_safety_layer_keeps_the_asked_room_in_narrow_places(shoulders):
    steps = about_a_door(6)
    walls = MapBank([ROOM]).walls_around(torch.full((64,), ROOM.map_id), identity_pose(64))
    one, other = (keep(steps, walls, shoulders) for keep in (kept_clear, kept_clear_in_torch))
    torch.testing.assert_close(one, other, atol=2e-3, rtol=0)
    usual = kept_clear(steps, walls)
    assert torch.equal(one, usual) == (shoulders > 0)
