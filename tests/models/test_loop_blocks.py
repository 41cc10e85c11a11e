"""What a controller sees and is: closest approaches, walls on rings, the frame of the way, a trait."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
import torch
from helpers.batches import agents_of, changed, make_batch, on_plan, random_weights
from torch import Tensor, nn

from pedzoo.core import geometry
from pedzoo.core.errors import UserError
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.blocks.map_encoders import CLIP, RADII, RAYS, RingEncoder
from pedzoo.models.blocks.mlp import ContextNoise
from pedzoo.models.blocks.people import ego_frame
from pedzoo.models.blocks.people.approach import ApproachPooling
from pedzoo.models.blocks.people.crowd import Crowd

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


def crowd_of(*sizes: int) -> Crowd:
    return Crowd.of(torch.arange(max(sizes)) < torch.tensor(sizes).unsqueeze(1))


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
    result = transparent()(position, moved, heading, torch.zeros(2, 3), crowd_of(2))
    return (result[0, :8] - result[0, 8:]).tolist()


def test_closest_approach_of_two_who_meet() -> None:
    """4 m ahead, 1 m to the left, towards each other at 2 m/s: beside each other, 1 m apart, in 2 s."""
    near = 2 / (2 + math.sqrt(17))
    urgent = near * 2 / (2 + 1) * math.exp(-2 / 2)
    wanted = [near * 4 / 2, near * 1 / 2, near * -2, 0.0, 0.0, near * 1 / 2, near, urgent]
    assert seen_by_the_first((4.0, 1.0), (-1.0, 0.0)) == pytest.approx(wanted, abs=3e-3)


def test_what_another_does_is_added_to_how_they_move() -> None:
    """Features of the state of the person seen, and not of the own one, inside the same layer."""
    pool = transparent()
    with torch.no_grad():
        pool.other.weight[:3] = torch.eye(3)
    position, moved = torch.tensor([[0.0, 0.0], [4.0, 1.0]]), 0.4 * torch.tensor([[1.0, 0.0], [-1.0, 0.0]])
    heading, state = torch.tensor([[1.0, 0.0], [1.0, 0.0]]), torch.tensor([[9.0, 9.0, 9.0], [0.1, 0.2, 5.0]])
    plain = torch.tensor(seen_by_the_first((4.0, 1.0), (-1.0, 0.0)))
    result = pool(position, moved, heading, state, crowd_of(2))[0, :8]
    torch.testing.assert_close(result[:3], (plain[:3] + state[1]).clamp_min(0.0))


def test_who_goes_away_is_closest_now() -> None:
    result = seen_by_the_first((-4.0, 0.0), (-1.0, 0.0))
    assert result[4:6] == pytest.approx([2 / 6 * -4 / 2, 0.0], abs=1e-4)
    assert result[7] == pytest.approx((2 / 6) ** 2, abs=1e-4)  # now: nothing is taken off for the time


def test_what_lies_far_ahead_in_time_is_taken_after_four_seconds() -> None:
    """20 m ahead and 3 m/s: after 4 s there are 8 m left."""
    result = seen_by_the_first((20.0, 0.0), (-2.0, 0.0))
    assert result[4] == pytest.approx(2 / 22 * 8 / 2, rel=1e-3)


def test_turning_and_shifting_the_scene_changes_nothing() -> None:
    pool, crowd = ApproachPooling(3, 6), crowd_of(5, 1, 3, 5)
    position, moved, heading, state = walking(14)
    result = pool(position, moved, heading, state, crowd)
    turn = torch.tensor([math.cos(2.0), math.sin(2.0)]).expand(14, 2)
    turned = [geometry.rotate(vector, turn) for vector in (position, moved, heading)]
    turned[0] = turned[0] + torch.tensor([30.0, -7.0])
    assert float(result.detach().abs().max()) > 0.05
    torch.testing.assert_close(pool(*turned, state, crowd), result, atol=2e-5, rtol=0)


def test_people_have_no_order_and_other_scenes_no_part() -> None:
    pool = ApproachPooling(3, 6)
    everything = walking(9)
    result = pool(*everything, crowd_of(4, 5))
    order = torch.tensor([2, 0, 3, 1, 8, 7, 6, 5, 4])
    torch.testing.assert_close(pool(*(x[order] for x in everything), crowd_of(4, 5)), result[order])
    torch.testing.assert_close(pool(*(x[4:] for x in everything), crowd_of(5)), result[4:])


def test_the_default_width_is_that_of_shipped_weights() -> None:
    assert ApproachPooling(3, 6).pair.out_features == 64


def test_a_person_alone_sees_no_others() -> None:
    result = ApproachPooling(3, 6)(*walking(5), crowd_of(1, 3, 1))
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
    pool(*leaves, crowd_of(4)).square().sum().backward()
    gradients = [x.grad for x in (*leaves, *pool.parameters()) if x.grad is not None]
    assert len(gradients) == 4 + len(list(pool.parameters()))
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)


def room() -> OccupancyGrid:
    """A square of 6 m with a wall from x = 4 to 5 m and a pillar."""
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[:, 40:50] = OCCUPIED
    cells[20:25, 10:15] = OCCUPIED
    return OccupancyGrid(cells, 0.1, (1.0, -2.0, 0.3), name="room")


def test_rings_read_distances_turned_to_the_heading() -> None:
    """First the distance here, then rings from the smallest, anticlockwise from straight ahead."""
    grid = room()
    bank, encoder = MapBank([grid]), RingEncoder(dim=4)
    random = torch.Generator().manual_seed(0)
    angle = 2 * math.pi * torch.rand(6, generator=random)
    position = torch.tensor([2.0, 0.0]) + 3 * torch.rand(6, 2, generator=random)
    heading = torch.stack((angle.cos(), angle.sin()), 1)
    pose = torch.tensor([[0.7, -1.0, 2.0, 1.0]]).repeat(6, 1)
    map_id = torch.full((6,), grid.map_id)
    scene, ahead = geometry.move_to_scene(position, pose), geometry.turn_to_scene(heading, pose)
    result = encoder.distances(bank, scene, ahead, map_id, pose)
    assert result.shape == (6, 1 + len(RADII) * RAYS)
    for person in range(6):
        towards = math.atan2(float(ahead[person, 1]), float(ahead[person, 0]))
        where = [scene[person].tolist()]
        for radius in RADII:
            for ray in range(RAYS):
                turned = towards + 2 * math.pi * ray / RAYS
                x, y = scene[person].tolist()
                where.append([x + radius * math.cos(turned), y + radius * math.sin(turned)])
        points = torch.tensor([where])
        wanted = bank.signed_distance(points, map_id[:1], pose[:1])[0].clamp(-CLIP, CLIP)
        torch.testing.assert_close(result[person], wanted, atol=1e-4, rtol=0)
    assert float(result.min()) < 0 < float(result.max())
    assert encoder(bank, scene, ahead, map_id, pose).shape == (6, 4)


def test_rings_carry_gradients_to_positions_and_keep_no_map() -> None:
    torch.manual_seed(0)
    grid = room()
    encoder = RingEncoder(dim=32)
    bank = MapBank([grid])
    position = torch.tensor([[3.5, 0.5]], requires_grad=True)
    heading = torch.tensor([[1.0, 0.0]])
    encoder(bank, position, heading, torch.tensor([grid.map_id]), geometry.identity_pose(1)).sum().backward()
    assert position.grad is not None and float(position.grad.abs().sum()) > 0
    assert all(key.startswith("net.") for key in encoder.state_dict())


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
    trait.reset()
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


@pytest.mark.parametrize("frame", ["heading", "way"])
def test_turning_the_scene_turns_what_people_with_everything_do(frame: Any) -> None:
    model = random_weights(SGAN.of(**GOAL, approach_dim=6, trait_dim=7, frame=frame))
    batch = make_batch((3, 1, 4), padding=0.0, dtype=torch.float64)
    model = model.double()
    noise = torch.randn(3, 4, 8, dtype=torch.float64)
    turn = torch.tensor([math.cos(1.0), math.sin(1.0)], dtype=torch.float64)
    keys = ("history", "future", "velocity", "goal", "desired_velocity")
    old = {key: cast("Tensor", agents_of(batch)[key]) for key in keys}
    turned = {key: geometry.rotate(value, turn.expand_as(value)) for key, value in old.items()}
    with torch.no_grad():
        result = model.next_steps(batch, noise, 8, 8)
        again = model.next_steps(changed(batch, **turned), noise, 8, 8)
    assert float(result.abs().max()) > 0.1
    # the small vector that gives people who stand a direction is the world's
    torch.testing.assert_close(again, geometry.rotate(result, turn.expand_as(result)), atol=2e-3, rtol=0)


def test_the_way_needs_a_goal() -> None:
    with pytest.raises(UserError, match="set goal_dim, or frame heading"):
        SGAN.of(frame="way")
