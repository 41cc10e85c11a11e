"""Who goes first in the safety layer: those ahead, a draw between equals; and queues that never lock."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from helpers.crowds import contacts, steps
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import BODY_RADIUS
from pedzoo.eval.rollout import rollout
from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.metrics.arrival import deadlock, success
from pedzoo.models.architectures import social_walker
from pedzoo.policies.load import load_policy
from pedzoo.policies.safety_layer.clearance import (
    BEYOND,
    LEAST_SHARE,
    MARGIN,
    kept_clear_in_torch,
    precedence,
)
from pedzoo.policies.safety_layer.layer import kept_clear

NARROW = rectangles(
    [*room((-3.0, -3.0), (3.0, 3.0), 0.1), *wall((0.0, -3.0), (0.0, 3.0), 0.1, doors=[(3.0, 0.5)])], 0.05
)
"""A wall along x = 0 with a door of 0.5 m in its middle."""


def order(place: list[list[float]], step: list[list[float]], waits: bool = False) -> float:
    """Return the precedence of the first of two; the second has the higher rank."""
    at = torch.tensor(place).T.unsqueeze(1)
    wait = torch.full((1, 2, 2), waits)
    rank = torch.tensor([[0.0, 1.0]])
    result = precedence(
        torch.tensor([step]), at.unsqueeze(3) - at.unsqueeze(2), wait, rank, torch.zeros(1, 2, 2)
    )
    assert torch.equal(result, -result.mT)
    return float(result[0, 0, 1])


def test_people_ahead_go_first() -> None:
    """One behind the other; towards one place, the nearer one, in proportion up to 0.2 m; head-on neither."""
    assert order([[0.0, 0.0], [-0.6, 0.1]], [[0.3, 0.0], [0.5, 0.0]]) == 1
    nearer, farther = [[-0.9, 0.0], [0.0, -1.0]], [[0.5, 0.0], [0.0, 0.5]]
    assert order(nearer, farther) == pytest.approx(0.5 * 0.1 / 0.2)
    assert order([[-0.4, 0.0], [0.4, 0.0]], [[0.5, 0.0], [-0.5, 0.0]]) == pytest.approx(0, abs=1e-6)


def test_of_two_who_wait_one_goes_first() -> None:
    """Head-on the one with the higher rank; else the one who is ahead, however little."""
    assert order([[-0.4, 0.0], [0.4, 0.0]], [[0.5, 0.0], [-0.5, 0.0]], waits=True) == pytest.approx(-1)
    assert order([[0.0, 0.0], [-0.1, 0.4]], [[0.5, 0.0], [0.5, 0.0]], waits=True) == 1


@pytest.mark.parametrize("answer", [kept_clear, kept_clear_in_torch])
def test_people_behind_make_way(answer: Callable[..., Tensor]) -> None:
    """In the open: of the correction of two, one behind the other, the person behind makes nearly all."""
    result = answer(steps([[0.0, 0.0], [-0.5, 0.0]], [[0.1, 0.0], [0.5, 0.0]], 1.15), None)
    lacks = (2 * BODY_RADIUS + MARGIN - (0.5 - BEYOND * 0.4)) / BEYOND
    assert float(result[0, 0, 0]) == pytest.approx(0.1 + LEAST_SHARE * lacks, abs=5e-3)
    assert float(result[0, 1, 0]) == pytest.approx(0.5 - (1 - LEAST_SHARE) * lacks, abs=5e-3)


@pytest.mark.parametrize(
    ("scenario", "decisions"),
    [
        ("room_exit:people=20,entering=0,width=0.9", 60),
        ("room_exit:people=20,entering=0,width=0.5", 250),
        ("door:people=18,from_right=0,abreast=3,width=0.46,resolution=0.01", 250),
        ("door:people=6,width=0.5,jitter=0,speed_std=0,offset=0", 250),
    ],
)
def test_no_queue_locks(scenario: str, decisions: int) -> None:
    """All get through the narrowest doors, without touching others or walls; also where two groups meet."""
    policy = load_policy("go_to_goal:safety=true")
    assert contacts(policy, scenario, 2, decisions, clearance=0.2) == (0, 0, 0)


@pytest.mark.parametrize("people", ["people=4", "people=4,from_right=1", "people=6,from_right=0"])
def test_no_social_walker_is_held_up_at_a_door_but_by_halts(
    people: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those who stand for 5 s do so by themselves: with halts some do, without them none."""
    scenario = f"door:{people},width=[0.7,0.8,0.9,1.0,1.1,1.2],offset=[-0.4,0,0.3,0.6]"
    monkeypatch.setattr(social_walker, "RARE_HALT", 50.0)
    walked, _ = rollout("social_walker.styled", scenario, "compiled", 60, seed=7)
    assert float(deadlock(walked).above.sum()) == 0
    assert torch.equal(success(walked).above, success(walked).below)


@pytest.mark.parametrize("rank", [[0.0, 1.0], [1.0, 0.0]])
def test_two_who_wait_head_on_in_a_narrow_door_pass(rank: list[float]) -> None:
    """One lets the other through, in either order of the two."""
    bank, waits = MapBank([NARROW]), torch.ones(1, 2, dtype=torch.bool)
    walls = bank.walls_around(torch.tensor([bank.grids[0].map_id]), identity_pose(1))
    more = {"waits": waits, "rank": torch.tensor([rank]), "velocity": torch.zeros(1, 2, 2)}
    asked = steps([[-0.4, 0.0], [0.4, 0.0]], [[0.4, 0.0], [-0.4, 0.0]], 1.15, **more)
    move = kept_clear(asked, walls)[0, :, 0]
    first, second = (move[0], -move[1]) if rank[0] else (-move[1], move[0])
    assert first > second + 0.1
