"""Limits of strides: the compiled loop says what torch does, and old limits stay as they were."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.maps.bank import MapBank
from pedzoo.maps.plans import load_plan, rectangles, wall
from pedzoo.maps.walls.local_walls import LocalWalls
from pedzoo.maps.walls.strides import CompiledWallsAhead, Keeping, WallsAhead, walls_ahead

REACH, WITHIN, ROUNDING, CREEP = 0.14, 0.29, 1e-4, 0.02


def walls_of(bank: MapBank, scenes: int, angle: float = 0.0) -> LocalWalls:
    row, pose = torch.zeros(scenes, dtype=torch.long), torch.tensor([[angle, 1.0, 0.0, 0.0]])
    walls = bank.walls_of_state(*bank.walls_of_scenes(row, pose.repeat(scenes, 1)))
    assert walls is not None
    return walls


def keeping(like: Tensor) -> Keeping:
    return Keeping(torch.full_like(like, REACH), torch.full_like(like, WITHIN), ROUNDING, CREEP)


def test_the_compiled_loop_says_what_torch_does() -> None:
    walls, generator = walls_of(MapBank([load_plan("apartment.7")]), 60, 0.7), torch.Generator()
    place = 12 * torch.rand(2, 60, 5, generator=generator.manual_seed(0)) - 4
    wanted = torch.full((3, 60, 5), 0.1)
    quick = walls_ahead(walls, place, keeping(place[0]), wanted, 2)
    exact = WallsAhead(walls, place.double(), keeping(place[0].double()), wanted.double(), 2)
    assert type(quick) is CompiledWallsAhead
    stops = 0
    for _ in range(6):
        near = quick.limits.normal.abs().sum(0) > 0
        for name, one, other in zip(quick.limits._fields, quick.limits, exact.limits, strict=True):
            assert other is not None
            if one is None:  # no agent has run into a wall, or wants more than it may
                idle = {"blocked_bound": other < -1e3, "length": other >= 0.1}[name]
                assert float(idle.float().mean()) > 0.99
                continue
            mine = near.expand_as(one)
            assert torch.allclose(one[mine].double(), other.expand_as(one)[mine], atol=2e-4)
        target = place + 0.2 * (torch.rand(place.shape, generator=generator) - 0.5)
        there, truly = quick.arrive(target), exact.arrive(target.double())
        there = torch.ones(60, 5) if there is None else there
        assert truly is not None
        assert float((there != truly).float().mean()) < 0.005  # within rounding of the limit
        stops += int((there == 0).sum())
        place = torch.where(there > 0, target, place)
    assert stops > 10


def test_an_agent_that_runs_into_a_wall_gets_the_limit_of_both() -> None:
    walls = walls_of(MapBank([rectangles(wall((0, 1), (4, 1), 0.2), 0.05)], "free"), 1)
    place = torch.tensor([[[2.0]], [[0.7]]])  # the wall begins 0.2 m above
    wanted = torch.tensor([0.1, REACH + 0.01]).view(2, 1, 1)
    ahead = walls_ahead(walls, place, keeping(place[0]), wanted, 1)
    first = ahead.limits
    assert torch.allclose(first.normal[:, 0, 0], torch.tensor([0.0, -1.0]), atol=1e-6)
    assert torch.allclose(first.bound, torch.tensor([[-0.9 + REACH]]), atol=1e-5)  # y may be 0.76
    assert first.length is None and first.blocked_bound is None
    before = [part.clone() for part in (first.bound, first.normal)]

    goes_back = ahead.arrive(place + torch.tensor([0.0, 0.1]).view(2, 1, 1))
    assert goes_back is not None and float(goes_back) == 0
    second = ahead.limits
    assert second.blocked_bound is not None
    assert second.length is not None and torch.allclose(
        second.length, torch.tensor([[REACH]])
    )  # now it wants more
    assert torch.allclose(second.blocked_bound, first.bound, atol=1e-5)
    assert torch.equal(second.bound, first.bound)
    assert ahead.arrive(place + torch.tensor([0.0, 0.05]).view(2, 1, 1)) is None
    # autograd keeps limits that are over
    assert all(torch.equal(part, old) for part, old in zip((first.bound, first.normal), before, strict=True))
