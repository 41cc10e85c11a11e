"""Social force: forces by hand, the potential as an oracle, invariances, walls on floor plans, settings."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from helpers.scenes import scene
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene, turn_to_scene
from pedzoo.maps import walls as stored_walls
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.segments import outlines
from pedzoo.policies.load import load_policy
from pedzoo.policies.rule_based.social_force import (
    SocialForce,
    SocialForceSettings,
    repulsion,
    social_force_velocity,
    view_weight,
    wall_force,
    wall_points,
)

PAPER = SocialForceSettings()
NEAREST = 50.0  # U0 / R of the paper: what a wall does at distance 0, m/s^2


def accelerate(
    position: Tensor,
    velocity: Tensor,
    desired: Tensor,
    settings: SocialForceSettings = PAPER,
    seconds: float = 0.01,
    **options: Any,
) -> Tensor:
    """Return every person's acceleration (B, A, 2); top speeds are out of the way."""
    shape = position.shape[:2]
    settings = replace(settings, top_speed_ratio=1e9)
    mask = options.pop("mask", torch.ones(shape, dtype=torch.bool))
    identity = options.pop("identity", torch.arange(shape[1]).expand(shape))
    speed = desired.norm(dim=-1)
    new = social_force_velocity(
        position, velocity, desired, speed, mask, settings, seconds, identity, **options
    )
    return (new - velocity) / seconds


def crowd(scenes: int, agents: int, side: float, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Return positions, velocities and desired velocities of a random crowd (B, A, 2)."""
    random = torch.Generator().manual_seed(seed)
    shape = (scenes, agents, 2)
    position = torch.rand(shape, generator=random) * side
    velocity, desired = (torch.randn(shape, generator=random) for _ in range(2))
    return position, 0.6 * velocity, desired


def commanded(batch: TensorDict, fluctuation: float = 0.0, **settings: Any) -> Tensor:
    """Return what the policy commands (B, A, 2), m/s."""
    policy = SocialForce(SocialForceSettings(fluctuation=fluctuation, **settings))
    return policy(batch)["agents", "action"]


def test_the_papers_parameters_are_the_default() -> None:
    result = SocialForceSettings(preset="1995")
    assert result == PAPER == SocialForce().settings
    assert (result.tau, result.strength, result.sigma, result.step_time) == (0.5, 2.1, 0.3, 2.0)
    assert (result.wall_strength, result.wall_range) == (10.0, 0.2)
    assert (result.view_angle, result.out_of_view, result.top_speed_ratio) == (100.0, 0.5, 1.3)
    assert result.wall_reach == pytest.approx(0.2 * math.log(5000))
    indoor = SocialForceSettings(preset="indoor", tau=0.4)
    assert (indoor.wall_strength, indoor.wall_range, indoor.tau) == (pytest.approx(2.2408, 1e-4), 0.1, 0.4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("tau=0", r"tau 0\.0: expected a number above 0"),
        ("strength=-1", r"strength -1\.0: expected a number, 0 or more"),
        ("out_of_view=1.5", r"out_of_view 1\.5: expected a weight from 0 to 1"),
        ("view_angle=200", r"view_angle 200\.0: expected degrees from 0 to 180"),
        ("max_neighbors=-1", r"max_neighbors -1: expected 0 or more"),
        ("dt=0.6", r"dt 0\.6: expected at most tau, 0\.5 s"),
        ("dt=0", r"dt 0\.0: expected seconds"),
        ("preset=1996", "unknown preset of social_force '1996': did you mean '1995'"),
        ("fluctuation=.inf", "fluctuation inf"),
        ("taw=1", "did you mean 'tau'"),
    ],
)
def test_settings_that_cannot_be(settings: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        load_policy(f"social_force:{settings}")


def test_a_person_alone_accelerates_as_by_hand() -> None:
    # (1.3 - 0.5) / 0.5 and 0.1 / 0.5
    state: Any = [torch.tensor([[part]]) for part in ([0.0, 0.0], [0.5, -0.1], [1.3, 0.0])]
    alone = accelerate(*state)
    assert alone.flatten().tolist() == pytest.approx([1.6, 0.2], abs=1e-4)


def test_repulsion_by_hand() -> None:
    # The other walks at 0.15 m/s along x: the step is 0.3 m. Seen from (0.3, 0.4) the foci are 0.5 and 0.4 m
    # away: 2 b = sqrt(0.9^2 - 0.3^2), b = 0.424264, exp(-b / 0.3) = 0.243117, V0 / sigma = 7. The gradient of
    # b is 0.9 / (4 b) ((0.6, 0.8) + (0, 1)) = (0.318198, 0.954594).
    force, away = repulsion(torch.tensor([[[0.3]], [[0.4]]]), torch.tensor([[[0.3]], [[0.0]]]), 2.1, 0.3)
    expected = [7 * 0.243117 * 0.318198, 7 * 0.243117 * 0.954594]
    assert (force * away).flatten().tolist() == pytest.approx(expected, rel=1e-5)
    assert away.norm() == pytest.approx(1)
    # a person who stands: V0 / sigma exp(-distance / sigma) straight away
    force, away = repulsion(torch.tensor([[[0.0]], [[-0.6]]]), torch.zeros(2, 1, 1), 2.1, 0.3)
    assert (force * away).flatten().tolist() == pytest.approx([0, -7 * math.exp(-2)], rel=1e-6)
    # finite at the centres; exactly in front of a person who comes there is no side to go to
    step = torch.tensor([2.6, 0.0]).view(2, 1, 1).expand(2, 12, 1)
    place = torch.cartesian_prod(torch.tensor([0.0, 1e-9, 1.3, 2.6]), torch.tensor([0.0, 1e-9, -1e-4]))
    force, away = repulsion(place.T.unsqueeze(2), step, 2.1, 0.3)
    assert force.max() < 60 and away.isfinite().all()
    assert float(away[:, 6].norm()) < 1e-6


def test_perception_by_hand() -> None:
    heading = torch.tensor([[1.0], [0.0]])
    angles = torch.tensor([0.0, 60, 99, 101, 180]).deg2rad()
    towards = torch.stack((angles.cos(), angles.sin())).unsqueeze(2)  # to whom the force comes from
    assert view_weight(-towards, heading, 100, 0.5).flatten().tolist() == [1, 1, 1, 0.5, 0.5]
    assert view_weight(-towards, 0 * heading, 100, 0.5).flatten().tolist() == [1] * 5


@pytest.mark.parametrize("weight", [0.5, 0.75, 1.0])
def test_who_is_behind_counts_less(weight: float) -> None:
    position, desired = torch.tensor([[[0.0, 0.0], [0.6, 0.0]], [[1.0, 0.0], [1.0, 0.0]]]).unsqueeze(1)
    result = accelerate(position, 0 * position, desired, replace(PAPER, out_of_view=weight))
    pushed, driven = 7 * math.exp(-2), 1 / 0.5
    assert result[0, :, 0].tolist() == pytest.approx([driven - pushed, driven + weight * pushed], abs=1e-3)


def test_top_speed_by_hand() -> None:
    desired, place = torch.tensor([[[0.6, 0.8]]]), torch.zeros(1, 1, 2)
    quick = commanded(scene(place, 5 * desired, desired, pref_speed=1.0))
    assert quick.flatten().tolist() == pytest.approx([1.3 * 0.6, 1.3 * 0.8])
    # (1 - 0.5) / 0.5 s for 0.1 s: half of what is missing in 0.35 s, as exp(-t / tau) has it
    slow = commanded(scene(place, 0.5 * desired, desired, pref_speed=1.0))
    assert slow.flatten().tolist() == pytest.approx([0.6 * 0.6, 0.6 * 0.8])
    # the planner's direction counts, the speed is one's own
    planned = commanded(scene(place, 0.5 * desired, 0.1 * desired, pref_speed=1.0))
    torch.testing.assert_close(planned, slow)


def test_order_padding_and_other_scenes_change_nothing() -> None:
    position, velocity, desired = crowd(30, 25, 6.0)
    whole = accelerate(position, velocity, desired)
    order = torch.randperm(25)
    mixed = accelerate(position[:, order], velocity[:, order], desired[:, order])
    assert torch.equal(mixed, whole[:, order])
    assert torch.equal(accelerate(position[7:8], velocity[7:8], desired[7:8]), whole[7:8])

    # two empty slots, at any place
    empty = torch.full((30, 2, 2), math.nan)
    place, speed, wish = (torch.cat((part, empty), 1) for part in (position, velocity, desired))
    mask, identity = (torch.arange(27) < 25).expand(30, 27), torch.arange(27).expand(30, 27)
    result = social_force_velocity(place, speed, wish, wish.norm(dim=-1), mask, PAPER, 0.1, identity)
    alone = social_force_velocity(
        position, velocity, desired, desired.norm(dim=-1), mask[:, :25], PAPER, 0.1, identity[:, :25]
    )
    assert torch.equal(result[:, :25], alone)
    assert (result[:, 25:] == 0).all()


def reference(position: Tensor, velocity: Tensor, desired: Tensor, settings: SocialForceSettings) -> Tensor:
    """Return accelerations (A, 2) of one scene by the paper's equations: all pairs, gradients by autograd."""
    position, velocity, desired = (part.double() for part in (position, velocity, desired))
    force = (desired - velocity) / settings.tau
    heading = desired / desired.norm(dim=1, keepdim=True)
    offset = (position[:, None] - position).requires_grad_()
    step = (settings.step_time * velocity)[None]
    whole = offset.norm(dim=2) + (offset - step).norm(dim=2)
    b = (whole**2 - step.square().sum(2)).clamp_min(1e-12).sqrt() / 2
    apart = offset.detach().norm(dim=2)
    counts = (apart < settings.neighbor_dist) & ~torch.eye(len(position), dtype=torch.bool)
    (gradient,) = torch.autograd.grad((2.1 * torch.exp(-b / settings.sigma))[counts].sum(), offset)
    push = -gradient
    size = push.norm(dim=2)
    seen = -(push * heading[:, None]).sum(2) >= size * math.cos(math.radians(100))
    return force + (push * torch.where(seen, 1.0, 0.5)[..., None] * counts[..., None]).sum(1)


def test_a_crowd_of_150_is_what_all_pairs_give() -> None:
    position, velocity, desired = crowd(2, 150, 16.0)
    settings = replace(PAPER, neighbor_dist=3.0)
    result = accelerate(position.double(), velocity.double(), desired.double(), settings)
    for number in range(2):
        expected = reference(position[number], velocity[number], desired[number], settings)
        gap = (result[number] - expected).norm(dim=1)
        # whose angle is 100 degrees to the last bit may be on the other side
        assert (gap < 1e-4).float().mean() > 0.98
    alone = accelerate(position, velocity, desired, replace(settings, max_neighbors=0))
    assert torch.allclose(alone, (desired - velocity) / 0.5, atol=1e-3)
    # whoever is left out beyond 5 m hardly counts: coming at 1.7 m/s, b = sqrt(5 x 1.6)
    place, velocity = torch.tensor([[[[0.0, 0.0], [-5.0, 0.0]]], [[[0.0, 0.0], [1.7, 0.0]]]])
    assert accelerate(place, velocity, velocity, replace(PAPER, neighbor_dist=20.0))[0, 0].norm() < 1e-3
    assert accelerate(place, velocity, velocity)[0, 0].norm() == 0


def test_people_at_the_same_place_part() -> None:
    place, desired = torch.tensor([[[1.0, 1.0], [1.0, 1.0], [9.0, 9.0]]]), torch.full((1, 3, 2), 1e-6)
    settings = replace(PAPER, out_of_view=1.0)
    result, swapped, other = (
        accelerate(place, 0 * place, desired, settings, identity=torch.tensor([identity]))[0, :2]
        for identity in ([0, 1, 2], [1, 0, 2], [1, 7, 2])
    )
    assert result.isfinite().all() and torch.allclose(result[0], -result[1], atol=1e-4)
    assert float(result[0].norm()) == pytest.approx(7 * math.exp(-0.01 / 0.3), rel=1e-3)
    # by who they are, not by where they are in the batch
    assert torch.allclose(swapped, result[[1, 0]], atol=1e-4)
    assert not torch.allclose(other[0], result[0], atol=0.1)


def test_long_decisions_are_integrated_in_tenths_of_a_second() -> None:
    position, velocity, desired = crowd(6, 5, 3.0)
    mask, identity = torch.ones(6, 5, dtype=torch.bool), torch.arange(5).expand(6, 5)
    rest = desired, desired.norm(dim=-1), mask, replace(PAPER, neighbor_dist=50.0)
    long = social_force_velocity(position, velocity, *rest, 0.4, identity)
    for _ in range(4):
        velocity = social_force_velocity(position, velocity, *rest, 0.1, identity)
        position = position + 0.1 * velocity
    assert torch.allclose(long, velocity, atol=1e-4)


# --- walls


def block(*walls: tuple[slice, slice], shape: tuple[int, int] = (80, 80), free: Any = ()) -> MapBank:
    """Return a floor plan of cells of 0.05 m: ``walls`` are full, and then some are ``free``."""
    cells = np.zeros(shape, np.uint8)
    for part in walls:
        cells[part] = OCCUPIED
    for part in free:
        cells[part] = 0
    return MapBank([OccupancyGrid(cells, 0.05, name=f"{shape} {cells.sum()}")])


EVERY, CORNER = slice(None), (slice(40), slice(40))


def points_of(bank: MapBank, places: Tensor) -> tuple[Tensor, Tensor]:
    """Return the points of walls that act at places (N, 2)."""
    table = bank.walls.segments(PAPER.wall_reach, hollows=False, dtype=places.dtype)
    return wall_points(table, places.T, torch.zeros(len(places), dtype=torch.long))


def push(bank: MapBank, places: Tensor) -> Tensor:
    """Return the paper's wall force (N, 2) at places (N, 2)."""
    return wall_force(*points_of(bank, places), 10.0, 0.2).T


def plain(distance: float) -> float:
    """Return what one straight wall does."""
    return NEAREST * math.exp(-distance / 0.2)


def test_a_straight_wall_by_hand_in_however_many_pieces(monkeypatch) -> None:
    at = torch.tensor([[5.0, 1.3], [5.03, 1.3], [4.987, 1.05], [5.0, 1.0005]])
    expected = torch.tensor([[0.0, 0.223130], [0, 0.223130], [0, 0.778801], [0, 0.997503]]) * 50

    def cut(occupied: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
        pieces = np.linspace(0, 1, 41)[:-1, None]
        sides = [zip(one, np.roll(one, -1, 0), strict=True) for one in outlines(occupied)]
        return [np.concatenate([a + pieces * (b - a) for a, b in side]) for side in sides]

    for pieces in (outlines, cut):
        monkeypatch.setattr(stored_walls, "outlines", pieces)
        walls = block((slice(20), EVERY), shape=(80, 200))  # y < 1 is wall
        torch.testing.assert_close(push(walls, at), expected, atol=1e-3, rtol=0)
        assert points_of(walls, at)[1].sum(0).tolist() == [1, 1, 1, 1]


def test_a_wall_across_the_cells_is_one_wall() -> None:
    y, x = np.mgrid[:300, :300]
    walls = block(0.37 * x - y > 20, shape=(300, 300))  # type: ignore[arg-type] # a staircase
    along, away = torch.tensor([[1.0, 0.37], [-0.37, 1.0]]) / math.hypot(0.37, 1)
    at = torch.tensor([7.5, 1.775]) + torch.arange(-1.5, 1.5, 0.01)[:, None] * along + 0.4 * away
    result = push(walls, at)
    # as strong as one straight wall within a cell and a half of where it is, and as steady
    apparent = -0.2 * (result.norm(dim=1) / NEAREST).log()
    assert (apparent - 0.4).abs().max() < 0.075
    assert (result @ along / (result @ away)).abs().max() < 0.2
    assert (result[1:] - result[:-1]).norm(dim=1).max() < 0.05 * plain(0.4)  # of a straight way to a wall


def test_corners_and_opposite_walls_count_once() -> None:
    near, far = plain(0.3), plain(0.5)
    for walls, at, expected in (
        (
            block(CORNER),
            [[2.3, 2.4], [2.3, 2.0], [2.3, 1.999], [2.0, 2.3], [1.999, 2.3]],
            [[0.6 * far, 0.8 * far], [near, 0], [near, 0], [0, near], [0, near]],
        ),
        (  # a room
            block((slice(20), EVERY), (EVERY, slice(20))),
            [[1.3, 1.5], [1.2, 1.2]],
            [[near, far], [plain(0.2), plain(0.2)]],
        ),
        (  # a corridor of 1.2 m
            block((slice(8), EVERY), (slice(32, None), EVERY), shape=(40, 200)),
            [[5.0, 1.0], [5.0, 0.7], [5.0, 1.3]],
            [[0.0, 0.0], [0, near - plain(0.9)], [0, plain(0.9) - near]],
        ),
    ):
        result = push(walls, torch.tensor(at))
        torch.testing.assert_close(result, torch.tensor(expected), atol=1e-3, rtol=0)


def test_at_a_bend_the_force_neither_doubles_nor_jumps(monkeypatch) -> None:
    bent = np.array([[0.0, 0.0], [200, 0], [200, 60], [100, 40], [0, 60]])  # 11 degrees to either side
    monkeypatch.setattr(stored_walls, "outlines", lambda occupied: [bent])
    walls = block((EVERY, EVERY), shape=(2, 2))
    for height in (0.15, 0.3, 0.6):
        at = torch.stack(
            (torch.linspace(4.5, 5.5, 1001), 2 + height + torch.linspace(-0.1, 0.1, 1001).abs()), 1
        )
        distance = height * 100 / math.hypot(100, 20)
        result = push(walls, at)
        assert (result[1:] - result[:-1]).norm(dim=1).max() < 0.01 * plain(distance)
        assert result.norm(dim=1).max() < 1.05 * plain(distance)
        assert result.norm(dim=1).min() > 0.9 * plain(distance)


def doorway() -> MapBank:
    """Return a wall of 0.15 m along x = 3.075 with a door of 0.85 m, centred at y = 3.025."""
    wall = slice(60, 63)
    return block((EVERY, wall), shape=(121, 120), free=[(slice(52, 69), wall)])


def test_a_doorway_is_symmetric_and_smooth() -> None:
    walls, centre = doorway(), torch.tensor([3.075, 3.025])
    across = torch.linspace(-0.27, 0.27, 541)
    for x in (0.0, 0.05, -0.3):
        result = push(walls, centre + torch.stack((torch.full((541,), x), across), 1))
        assert torch.allclose(result[:, 1], -result[:, 1].flip(0), atol=1e-2)
        assert torch.allclose(result[:, 0], result[:, 0].flip(0), atol=1e-2)
        assert (result[1:] - result[:-1]).norm(dim=1).max() < 0.2
        # away from the nearer jamb, all the way
        assert (result[:270, 1] > 0).all() and (result[271:, 1] < 0).all()
    inside = push(walls, centre[None] + torch.tensor([[0.0, 0.2]]))
    assert inside[0].tolist() == pytest.approx([0, plain(0.625) - plain(0.225)], abs=1e-3)


def test_hollows_in_walls_do_not_push() -> None:
    at, wall, inside = torch.tensor([[1.5, 1.8], [1.2, 0.6]]), (slice(20, 30), EVERY), slice(3, 50)
    solid = push(block(wall, shape=(60, 60)), at)
    # 0.2 m wide: no person stands in there
    assert torch.equal(push(block(wall, shape=(60, 60), free=[(slice(22, 26), inside)]), at), solid)
    wide = push(block(wall, shape=(60, 60), free=[(slice(21, 29), inside)]), at)
    assert not torch.allclose(wide, solid, rtol=1e-3)


def test_in_clutter_the_force_changes_smoothly() -> None:
    random = np.random.default_rng(3)
    ends = slice(None, None, 159)
    boxes: list[Any] = [(ends, EVERY), (EVERY, ends)]
    for _ in range(25):
        row, column = random.integers(5, 150, 2)
        high, wide = random.integers(1, 9, 2)
        boxes.append((slice(row, row + high), slice(column, column + wide)))
    walls = block(*boxes, shape=(160, 160))
    start = torch.from_numpy(random.random((300, 2)) * 7 + 0.5).float()
    angle = torch.from_numpy(random.random(300) * 7).float()
    line = torch.arange(120)[:, None, None] * 0.005 * torch.stack((angle.cos(), angle.sin()), 1) + start
    result = push(walls, line.view(-1, 2)).view(line.shape)
    ids = torch.full((300,), walls.grids[0].map_id)
    field = walls.signed_distance(line.transpose(0, 1), ids, identity_pose(300)).T
    fair = (field[1:] > 0.2) & (field[:-1] > 0.2) & (field[1:] < 1)
    change = (result[1:] - result[:-1]).norm(dim=2)
    one_wall = 0.005 / 0.2 * NEAREST * (-field[1:] / 0.2).exp()
    assert fair.sum() > 10_000
    assert (change / one_wall)[fair].max() < 5


def test_walls_turn_with_map_and_scene() -> None:
    """Whoever moves the others, and in any batch."""
    cells = np.random.default_rng(0).random((30, 30)) < 0.1
    grid = OccupancyGrid(cells.astype(np.uint8) * OCCUPIED, 0.2, (1.0, -2.0, 0.4), name="random")
    bank = MapBank([grid])
    position, velocity, desired = crowd(20, 4, 5.0)
    position = position + torch.tensor([0.0, -1.0])
    here = commanded(scene(position, velocity, desired, maps=bank))
    pose = torch.tensor([[2.1, -1.0, 4.0, -7.0]]).expand(20, 4)
    turned = scene(
        *(move_to_scene(position, pose), turn_to_scene(velocity, pose), turn_to_scene(desired, pose)),
        maps=bank,
    )
    turned["scene_pose"] = pose
    torch.testing.assert_close(commanded(turned), turn_to_scene(here, pose), atol=1e-3, rtol=0)
    moved = torch.tensor([True, False, False, True]).expand(2, 4)
    some = scene(*(part[3:5] for part in (position, velocity, desired)), controlled=moved, maps=bank)
    assert torch.equal(commanded(some), here[3:5])
    free = commanded(scene(position, velocity, desired, maps=bank), walls=False)
    assert not torch.allclose(free, here, atol=0.1)
    assert torch.equal(commanded(scene(position, velocity, desired)), free)


def test_places_on_and_in_walls_give_numbers() -> None:
    at = torch.tensor([[1.0, 2.0], [2.0, 2.0], [1.0, 1.0], [1.9, 1.9], [math.nan, 0.0], [1e4, -1e4]])
    assert push(block(CORNER), at).isfinite().all()
    assert push(block(), at).abs().sum() == 0
    assert push(MapBank(), torch.zeros(0, 2)).shape == (0, 2)


def test_actions_are_differentiable() -> None:
    walls = block((slice(20), EVERY), (slice(30, 40), slice(30, 40)))
    position = torch.tensor([[[1.0, 1.3], [1.4, 1.35], [1.3, 1.8], [0.4, 1.6]]]).double()
    _, velocity, desired = (part.double() for part in crowd(1, 4, 1.0))
    mask, identity = torch.ones(1, 4, dtype=torch.bool), torch.arange(4)[None]

    def force(place: Tensor, rows: Tensor | None) -> Tensor:
        return wall_force(*points_of(walls, place.T), 10.0, 0.2)

    def action(*state: Any) -> Tensor:
        position, velocity, desired, speed = state
        options: Any = {"walls": force, "identity": identity, "seconds": 0.2}
        return social_force_velocity(position, velocity, desired, speed, mask, PAPER, **options)

    inputs = [part.requires_grad_() for part in (position, velocity, desired, torch.ones(1, 4).double())]
    assert torch.autograd.gradcheck(action, inputs, atol=1e-4)
    same, still = torch.zeros(1, 4, 2, requires_grad=True), torch.zeros(1, 4, 2)
    social_force_velocity(same, still, still, torch.ones(1, 4), mask, PAPER, 0.1, identity).sum().backward()
    assert same.grad is not None and same.grad.isfinite().all()


# --- walking


def test_fluctuations_free_people_who_meet_head_on() -> None:
    position, velocity = torch.tensor([[[0.0, 0.0], [2.0, 0.0]], [[1.0, 0.0], [-1.0, 0.0]]]).unsqueeze(1)
    straight = commanded(scene(position, velocity, velocity))
    assert straight[0, 0, 1] < 0 and straight[0, 1, 1] == -straight[0, 0, 1]  # both keep to the right
    once, again = (commanded(scene(position, velocity, velocity), fluctuation=0.1) for _ in range(2))
    assert torch.equal(once, again)
    assert 0 < (once - straight).norm(dim=-1).max() < 0.05
    place, now, nearest = position, velocity, math.inf
    for step in range(60):
        seen = scene(place, now, velocity)
        seen["time"] = torch.full((1, 1), 0.1 * step)
        now = commanded(seen, fluctuation=0.1)
        place = place + 0.1 * now
        nearest = min(nearest, float((place[0, 0] - place[0, 1]).norm()))
    assert place[0, 0, 0] > place[0, 1, 0] + 1
    assert nearest > 0.3


@pytest.mark.parametrize(("preset", "passes"), [("1995", False), ("indoor", True)])
@pytest.mark.parametrize("side", [0.0, 0.1])
def test_a_lone_person_needs_the_indoor_preset_to_pass_a_door(preset: Any, passes: bool, side: float) -> None:
    bank = doorway()
    map_id = torch.tensor([bank.grids[0].map_id])
    place, velocity = torch.tensor([[[1.0, 3.025 + side]]]), torch.zeros(1, 1, 2)
    for _ in range(60):
        desired = 1.3 * torch.nn.functional.normalize(torch.tensor([5.0, 3.025]) - place, dim=-1)
        velocity = commanded(scene(place, velocity, desired, maps=bank), preset=preset, fluctuation=0.1)
        place = place + 0.1 * velocity
        assert bank.signed_distance(place, map_id, identity_pose(1)).min() > 0.2
    assert (float(place[0, 0, 0]) > 4) == passes
