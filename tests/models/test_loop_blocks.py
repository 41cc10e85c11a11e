"""What a controller sees and is: closest approaches, walls on rings, the frame of the way, a trait."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
import torch
from helpers.batches import make_batch, on_plan, random_weights
from test_blocks import crowd_of
from torch import Tensor, nn

from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.models.architectures.sgan import SGAN, ContextNoise
from pedzoo.models.blocks.people import ego_frame
from pedzoo.models.blocks.people.approach import ApproachPooling

GOAL: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "window_end", "noise": "agent"}
NEW: dict[str, Any] = {"map": "rings", "map_dim": 5, "approach_dim": 6, "trait_dim": 7}


def transparent() -> ApproachPooling:
    """Return a pooling that answers with the features of the only other person, then with these negated."""
    pool = ApproachPooling(3, 16, hidden_dim=16)
    with torch.no_grad():
        for parameter in pool.parameters():
            parameter.zero_()
        pool.pair.weight.copy_(torch.cat((torch.eye(8), -torch.eye(8))))
        pool.output.weight.copy_(torch.eye(16))
    return pool


def walking(people: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return position, last displacement, heading and state of so many people."""
    random = torch.Generator().manual_seed(seed)
    position, moved, state = (torch.randn(people, n, generator=random) for n in (2, 2, 3))
    return 3 * position, 0.4 * moved, nn.functional.normalize(moved, dim=-1), state


def seen_by_the_first(away: tuple[float, float], velocity: tuple[float, float]) -> list[float]:
    """Return what a person who walks along x at 1 m/s sees of another person."""
    position = torch.tensor([[0.0, 0.0], away])
    moved = 0.4 * torch.tensor([[1.0, 0.0], velocity])
    heading = torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    result = transparent()(position, moved, heading, torch.zeros(2, 3), crowd_of((2,)))
    return (result[0, :8] - result[0, 8:]).tolist()


def test_closest_approaches_by_hand() -> None:
    """4 m ahead, 1 m to the left, towards each other at 2 m/s: beside each other, 1 m apart, in 2 s."""
    near = 2 / (2 + math.sqrt(17))
    urgent = near * 2 / (2 + 1) * math.exp(-2 / 2)
    wanted = [near * 4 / 2, near * 1 / 2, near * -2, 0.0, 0.0, near * 1 / 2, near, urgent]
    assert seen_by_the_first((4.0, 1.0), (-1.0, 0.0)) == pytest.approx(wanted, abs=3e-3)
    leaves = seen_by_the_first((-4.0, 0.0), (-1.0, 0.0))  # closest now: nothing is taken off for the time
    assert leaves[4:6] == pytest.approx([2 / 6 * -4 / 2, 0.0], abs=1e-4)
    assert leaves[7] == pytest.approx((2 / 6) ** 2, abs=1e-4)
    far = seen_by_the_first((20.0, 0.0), (-2.0, 0.0))  # at 3 m/s: after 4 s there are 8 m left
    assert far[4] == pytest.approx(2 / 22 * 8 / 2, rel=1e-3)


def test_what_another_does_is_added_to_how_they_move() -> None:
    """Features of the state of the person seen, and not of the own one, inside the same layer."""
    pool = transparent()
    with torch.no_grad():
        pool.other.weight[:3] = torch.eye(3)
    position, moved = torch.tensor([[0.0, 0.0], [4.0, 1.0]]), 0.4 * torch.tensor([[1.0, 0.0], [-1.0, 0.0]])
    heading, state = torch.tensor([[1.0, 0.0], [1.0, 0.0]]), torch.tensor([[9.0, 9.0, 9.0], [0.1, 0.2, 5.0]])
    plain = torch.tensor(seen_by_the_first((4.0, 1.0), (-1.0, 0.0)))
    result = pool(position, moved, heading, state, crowd_of((2,)))[0, :8]
    torch.testing.assert_close(result[:3], (plain[:3] + state[1]).clamp_min(0.0))


def test_a_person_alone_sees_no_others() -> None:
    result = ApproachPooling(3, 6)(*walking(5), crowd_of((1, 3, 1)))
    assert not result[0].any() and not result[4].any() and bool(result[1:4].any(1).all())


@pytest.mark.parametrize("case", ["same spot", "standing", "both", "side by side"])
def test_gradients_are_finite_wherever_people_are(case: str) -> None:
    pool = ApproachPooling(3, 6)
    position, moved, heading, state = walking(4)
    if case in ("same spot", "both"):
        position = torch.zeros(4, 2)
    if case in ("standing", "both"):
        moved = torch.zeros(4, 2)
    if case == "side by side":
        moved = moved[:1].expand(4, 2).clone()
    leaves = [x.requires_grad_() for x in (position, moved, heading, state)]
    pool(*leaves, crowd_of((4,))).square().sum().backward()
    gradients = [x.grad for x in (*leaves, *pool.parameters()) if x.grad is not None]
    assert len(gradients) == 4 + len(list(pool.parameters()))
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)


def room() -> OccupancyGrid:
    """A square of 6 m with a wall from x = 4 to 5 m and a pillar."""
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[:, 40:50] = OCCUPIED
    cells[20:25, 10:15] = OCCUPIED
    return OccupancyGrid(cells, 0.1, (1.0, -2.0, 0.3), name="room")


def test_way_frame_hardly_turns_for_stopping_people() -> None:
    """A step of 2 cm to the left, to the right or back, with the goal straight ahead."""
    goal = torch.tensor([[4.0, 0.0]]).expand(3, 2)
    moved = torch.zeros(3, 7, 2)
    moved[:, -1] = torch.tensor([[0.0, 0.02], [0.0, -0.02], [-0.02, 0.0]])
    way, heading = ego_frame.way(moved, goal), ego_frame.heading(moved, goal)
    assert torch.allclose(way.norm(dim=-1), torch.ones(3))
    assert bool((way[:, 0] > 0.999).all())
    assert bool((heading[:2, 0] < 0.95).all())
    standing = ego_frame.way(torch.zeros(1, 7, 2), torch.zeros(1, 2))  # nowhere to go: some direction
    assert float(standing.norm()) == pytest.approx(1.0)


def test_a_new_trait_adds_nothing_and_a_trained_one_does() -> None:
    trait, context, z = ContextNoise(5, 2, 8), torch.randn(3, 4, 5), torch.randn(3, 4, 2)
    assert torch.equal(trait(context, z), context)
    for parameter in trait.parameters():
        nn.init.normal_(parameter)
    assert not torch.allclose(trait(context, z), trait(context, -z), atol=0.1)


def grown(plain: SGAN) -> SGAN:
    """Return a network with everything new whose other weights are those of a plain one."""
    model, old = SGAN.of(**GOAL, **NEW), plain.state_dict()
    new = model.state_dict()
    for key, value in old.items():
        if key == "to_decoder.0.weight":
            new[key][:, : value.shape[1]] = value
        else:
            new[key] = value
    model.load_state_dict(new)
    return model


def test_new_parts_say_nothing_before_training() -> None:
    plain = cast("SGAN", random_weights(SGAN.of(**GOAL)))
    model, batch = grown(plain), on_plan(make_batch((3, 1, 4)), MapBank([room()]))
    noise = torch.randn(3, 4, 8, generator=torch.Generator().manual_seed(0))
    wanted = plain.next_steps(batch, noise, 8, 8)
    result = model.next_steps(batch, noise, 8, 8)
    torch.testing.assert_close(result, wanted, atol=1e-6, rtol=0)
    result.square().sum().backward()
    first = cast("nn.Linear", model.to_decoder[0])
    assert first.weight.grad is not None and bool(first.weight.grad[:, -11:].any(1).any())
    assert model.trait is not None
    last = cast("nn.Linear", model.trait.net[-1])
    assert last.weight.grad is not None and bool(last.weight.grad.any())
