"""ORCA: lines by hand, invariances, walls, real RVO2 as the oracle; and the search of neighbours."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.segments import Segments
from pedzoo.policies.neighbours import nearest
from pedzoo.policies.rule_based.orca import (
    OrcaSettings,
    agent_lines,
    orca_velocity,
    solve,
    wall_lines,
)

SETTINGS = OrcaSettings(dt=0.4)


def present(position: Tensor) -> Tensor:
    return torch.ones(position.shape[:2], dtype=torch.bool)


def walk(
    position: Tensor,
    velocity: Tensor,
    preferred: Tensor,
    settings: OrcaSettings = SETTINGS,
    top_speed: float = 1.7,
    **options: Tensor | Segments | None,
) -> Tensor:
    speed = torch.full(position.shape[:2], top_speed, dtype=position.dtype)
    mask = options.pop("mask", present(position))
    return orca_velocity(position, velocity, preferred, speed, mask, settings, **options)  # type: ignore[arg-type]


def lines_of(position: Tensor, velocity: Tensor) -> Tensor:
    radius = torch.full(position.shape[:2], SETTINGS.radius)
    half = torch.full(position.shape[:2], 0.5)
    return agent_lines(position, velocity, radius, half, present(position), None, SETTINGS)


def violation(lines: Tensor, velocity: Tensor) -> Tensor:
    """Return how far velocities (2, ..., N) are on the wrong side of lines (4, ..., N), m/s."""
    (px, py, dx, dy), (x, y) = lines, velocity
    return (py - y) * dx - (px - x) * dy


def crowd(scenes: int, agents: int, side: float, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Return positions, velocities and preferred velocities of a random crowd (B, A, 2)."""
    random = torch.Generator().manual_seed(seed)
    shape = (scenes, agents, 2)
    position = torch.rand(shape, generator=random) * side
    velocity, preferred = (torch.randn(shape, generator=random) for _ in range(2))
    return position, 0.8 * velocity, preferred


def test_settings_of_igibson_are_known() -> None:
    igibson = OrcaSettings(preset="igibson")
    assert (igibson.radius, igibson.max_neighbors, igibson.top_speed_ratio) == (0.5, None, 1.0)
    assert (igibson.neighbor_dist, igibson.time_horizon, igibson.time_horizon_obst) == (5.0, 2.0, 2.0)
    assert OrcaSettings(preset="igibson", radius=0.3) == replace(igibson, radius=0.3)
    assert OrcaSettings(preset="pedzoo") == OrcaSettings()
    assert igibson.wall_reach(torch.tensor([0.5])).tolist() == [1.5]


@pytest.mark.parametrize(
    ("name", "value"),
    [("radius", 0.0), ("time_horizon", math.inf), ("max_neighbors", -1), ("jitter", -0.5), ("dt", math.nan)],
)
def test_settings_out_of_range_are_refused(name: str, value: Any) -> None:
    with pytest.raises(UserError, match=f"orca: {name} {value}: expected"):
        OrcaSettings(**{name: value})
    with pytest.raises(UserError, match="did you mean 'igibson'"):
        OrcaSettings(preset="igibsen")  # type: ignore[arg-type]


def test_lines_of_two_people_head_on_by_hand() -> None:
    position = torch.tensor([[[0.0, 0.0], [2.0, 0.0]]])
    velocity = torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]])
    # A leg of the cone that is tangent to the disk of radius 0.4 at distance 2: its angle has sine 0.2. The
    # relative velocity (2, 0) is 0.4 away from it; each does half.
    sine, cosine = 0.2, math.sqrt(0.96)
    lines = lines_of(position, velocity)
    assert lines.shape == (4, 1, 2)
    away = (0.2 * -sine, 0.2 * -cosine)
    assert lines[:, 0, 0].tolist() == pytest.approx([1 + away[0], away[1], -cosine, sine], abs=1e-6)
    assert lines[:, 0, 1].tolist() == pytest.approx([-1 - away[0], -away[1], cosine, -sine], abs=1e-6)
    chosen = walk(position, velocity, velocity)[0]
    assert chosen[0].tolist() == pytest.approx([1 + away[0], away[1]], abs=1e-6)
    assert torch.equal(chosen[0], -chosen[1])


def test_lines_of_resting_and_overlapping_people_by_hand() -> None:
    position = torch.tensor([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 0.0], [0.1, 0.0]]])
    still = torch.zeros(2, 2, 2)
    lines = lines_of(position, still)
    # at rest: the cut-off disk around (4, 0) / 2 s of radius 0.4 / 2 s begins at 1.8 m/s, half of it each
    assert lines[:, 0, 0].tolist() == pytest.approx([0.9, 0, 0, 1], abs=1e-6)
    # overlap 0.3 m: apart in one time step of 0.4 s, so 0.375 m/s backwards each
    assert lines[:, 0, 2].tolist() == pytest.approx([-0.375, 0, 0, 1], abs=1e-6)
    assert walk(position, still, still)[1].flatten().tolist() == pytest.approx(
        [-0.375, 0, 0.375, 0], abs=1e-6
    )


def test_alone_people_walk_as_they_like_up_to_their_top_speed() -> None:
    preferred = torch.tensor([[[1.0, 0.5]], [[30.0, 40.0]]])
    chosen = walk(torch.zeros(2, 1, 2), torch.zeros(2, 1, 2), preferred, top_speed=2.0)
    assert chosen.flatten().tolist() == pytest.approx([1, 0.5, 1.2, 1.6])


def test_order_padding_and_other_scenes_change_nothing() -> None:
    state: Any = crowd(30, 6, 3.0)
    whole, order = walk(*state), torch.randperm(6)
    assert torch.equal(walk(*(part[:, order] for part in state)), whole[:, order])
    assert torch.equal(walk(*(part[7:8] for part in state)), whole[7:8])
    padded: Any = [torch.cat((part, torch.full((30, 2, 2), math.nan)), 1) for part in state]
    result = walk(*padded, mask=(torch.arange(8) < 6).expand(30, 8))
    assert torch.equal(result[:, :6], whole)
    assert (result[:, 6:] == 0).all()


def test_gradients_are_not_needed_and_do_not_disturb() -> None:
    position, velocity, preferred = crowd(4, 6, 2.0)
    result = walk(position, velocity, preferred.requires_grad_())
    assert not result.requires_grad
    weight = torch.ones((), requires_grad=True)
    (weight * result).sum().backward()  # what is chosen can be part of a loss
    assert weight.grad is not None and torch.allclose(weight.grad, result.sum())


def test_passive_people_keep_their_velocity_and_are_avoided() -> None:
    position, velocity, preferred = crowd(30, 6, 3.0)
    passive = torch.rand(30, 6) < 0.4
    result = walk(position, velocity, preferred, passive=passive)
    assert torch.equal(result[passive], velocity[passive])
    free = walk(position, velocity, preferred, passive=torch.zeros_like(passive))
    assert torch.equal(free, walk(position, velocity, preferred))
    assert not torch.equal(result[~passive], free[~passive])
    # head-on, 2 m apart: the relative velocity is 0.4 away from the tangent, and one makes all of it
    position, velocity = torch.tensor([[[[0.0, 0.0], [2.0, 0.0]]], [[[1.0, 0.0], [-1.0, 0.0]]]])
    chosen = walk(position, velocity, velocity, passive=torch.tensor([[False, True]]))[0]
    assert chosen[0].tolist() == pytest.approx([1 - 0.4 * 0.2, -0.4 * math.sqrt(0.96)], abs=1e-6)
    assert torch.equal(chosen[1], velocity[0, 1])


def test_nearest_neighbours_only() -> None:
    state: Any = crowd(30, 6, 3.0)
    position, velocity, preferred = state
    gaps = torch.cdist(position, position) + 9 * torch.eye(6)
    for agent in range(6):
        pair = torch.stack((torch.full((30,), agent), gaps[:, agent].argmin(1)), 1)[..., None]
        alone = walk(*(part.gather(1, pair.expand(-1, -1, 2)) for part in state))
        assert torch.equal(walk(*state, settings=replace(SETTINGS, max_neighbors=1))[:, agent], alone[:, 0])
    for few in (replace(SETTINGS, max_neighbors=0), replace(SETTINGS, neighbor_dist=1e-4)):
        assert torch.equal(walk(position, velocity, preferred, few, top_speed=9.0), preferred)


def test_people_at_the_same_place_give_numbers() -> None:
    position = torch.zeros(3, 4, 2)
    velocity = torch.tensor([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]).expand(3, 4, 2)
    for preferred in (torch.zeros(3, 4, 2), velocity):
        assert walk(position, velocity, preferred).isfinite().all()
    # with the same velocity there is no side to go to: they go on as they like
    two = walk(position[:1, :2], velocity[:1, :2], torch.tensor([[[0.3, 0.0], [0.0, 0.4]]]))
    assert two.flatten().tolist() == pytest.approx([0.3, 0, 0, 0.4])


@pytest.fixture(scope="module")
def net() -> Tensor:
    """Return a fine net of velocities (2, V) up to 1.7 m/s."""
    axis = torch.linspace(-1.7, 1.7, 121)
    velocities = torch.cartesian_prod(axis, axis)
    return velocities[velocities.norm(dim=1) <= 1.7].T


@pytest.mark.parametrize(("agents", "side"), [(10, 1.5), (5, 6.0)])
def test_nothing_of_a_net_is_better_than_what_is_chosen(net: Tensor, agents: int, side: float) -> None:
    """Crowded people violate as little as possible, others are as near to what they prefer as permitted."""
    position, velocity, preferred = crowd(20, agents, side)
    lines, wished = lines_of(position, velocity), preferred.flatten(0, 1).T.contiguous()
    chosen = solve(lines, 0, wished, torch.full((20 * agents,), 1.7))
    wrong, worst = violation(lines[..., None], net[:, None, None]).amax(0), violation(lines, chosen).amax(0)
    assert (chosen.norm(dim=0) <= 1.7 + 1e-4).all()
    assert (worst <= wrong.amin(1).clamp_min(0) + 1e-4).all()
    distance = (net[:, None] - wished[..., None]).norm(dim=0).masked_fill(wrong > 0, torch.inf).amin(1)
    feasible = distance < torch.inf
    assert 40 < (feasible if agents == 5 else ~feasible).sum()
    assert (worst[feasible] <= 1e-5).all()
    assert ((chosen - wished).norm(dim=0) <= distance + 1e-5)[feasible].all()


def room(side: float = 6.0, cell: float = 0.05) -> OccupancyGrid:
    """Two rooms with a wall of 0.15 m between them at x = side / 2 and a door of 0.85 m in its middle."""
    count = round(side / cell)
    cells = np.zeros((count, count), np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    wall = count // 2
    cells[:, wall - 1 : wall + 2] = OCCUPIED
    cells[wall - 8 : wall + 9, wall - 1 : wall + 2] = 0
    return OccupancyGrid(cells, cell, name="two rooms")


@pytest.mark.parametrize(("radius", "passes"), [(0.5, False), (0.3, True), (0.2, True), (0.1, True)])
def test_a_lone_person_passes_a_door_that_is_wide_enough(radius: float, passes: bool) -> None:
    grid, settings = room(), OrcaSettings(radius=radius, dt=0.1)
    bank = MapBank([grid])
    ids, pose = torch.tensor([grid.map_id] * 3), identity_pose(3)
    start = position = torch.tensor([[[1.5, 3.025]], [[1.5, 3.1]], [[4.5, 2.9]]])
    goal = torch.tensor([[[4.2, 3.025]], [[4.2, 3.025]], [[1.8, 3.025]]])
    velocity = torch.zeros_like(position)
    for _ in range(60):
        preferred = 0.5 * torch.nn.functional.normalize(goal - position, dim=-1)
        near = bank.segments_near(position[:, 0], ids, pose, settings.wall_reach(torch.tensor(0.5)))
        velocity = walk(position, velocity, preferred, settings, top_speed=0.5, walls=near)
        position = position + 0.1 * velocity
        assert (bank.signed_distance(position, ids, pose) > radius - 0.03).all()
    crossed = (position[..., 0] > 3.025) != (start[..., 0] > 3.025)
    assert crossed.all() if passes else not crossed.any()


def one_wall() -> tuple[MapBank, Tensor]:
    """Return a wall that fills y < 1 of a wide map, and its id."""
    cells = np.zeros((40, 200), np.uint8)
    cells[:10] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1)
    return MapBank([grid]), torch.tensor([grid.map_id])


def test_a_wall_by_hand() -> None:
    bank, ids = one_wall()
    position = torch.tensor([[[10.0, 2.0]], [[10.0, 1.1]], [[10.0, 3.5]]])
    preferred = torch.tensor([1.0, -1.0]).expand(3, 1, 2)
    near = bank.segments_near(position[:, 0], ids.expand(3), identity_pose(3), 3.6)
    lines = wall_lines(near, torch.zeros(2, 3), torch.full((3,), 0.2), SETTINGS)
    # 0.8 m to the disk's edge in 2 s: at most 0.4 m/s towards the wall; in touch: none
    assert lines[1:, 0, 0].tolist() == pytest.approx([-0.4, 1, 0], abs=1e-5)
    assert lines[:, 0, 1].tolist() == pytest.approx([0, 0, 1, 0], abs=1e-5)
    chosen = walk(position, torch.zeros(3, 1, 2), preferred, walls=near)
    assert chosen.flatten().tolist() == pytest.approx([1, -0.4, 1, 0, 1, -1], abs=1e-5)


def test_opposite_lines_are_violated_equally() -> None:
    """At least 0.7 m/s and at most -0.1 m/s along one direction: 0.3 m/s."""
    turn = torch.tensor(math.radians(30))
    along, across = torch.stack((turn.cos(), turn.sin())), torch.stack((-turn.sin(), turn.cos()))
    lines = torch.stack((torch.cat((0.7 * across, along)), torch.cat((-0.1 * across, -along))), 1)[..., None]
    chosen = solve(lines, 0, torch.tensor([[0.2], [0.9]]), torch.ones(1))
    assert float((chosen[:, 0] * across).sum()) == pytest.approx(0.3, abs=1e-5)


def test_walls_are_obeyed_whatever_people_do() -> None:
    """Random lines, a third of them left out, most of which cannot all be obeyed."""
    random = torch.Generator().manual_seed(0)
    angle = torch.rand(9, 800, generator=random) * 2 * math.pi
    point = 0.6 * torch.randn(2, 9, 800, generator=random)
    direction = torch.stack((angle.cos(), angle.sin())) * (torch.rand(9, 800, generator=random) > 0.3)
    preferred, speed = torch.randn(2, 800, generator=random), 1 + torch.rand(800, generator=random)
    point[:, :2] = 0.5 * torch.stack((direction[1, :2], -direction[0, :2]))  # walls permit standing still
    lines = torch.cat((point, direction))
    chosen = solve(lines, 2, preferred, speed)
    assert violation(lines[:, :2], chosen).max() < 1e-3
    assert 200 < (violation(lines, chosen).amax(0) > 1e-3).sum() < 700


def test_people_pressed_against_a_wall_do_not_enter_it() -> None:
    bank, ids = one_wall()
    position = torch.rand(20, 12, 2) * torch.tensor([3.0, 1.5]) + torch.tensor([8.0, 1.2])
    velocity, ahead = torch.zeros_like(position), torch.tensor([0.0, -1.3]).expand_as(position)
    for _ in range(40):
        near = bank.segments_near(position.flatten(0, 1), ids.expand(240), identity_pose(240), 3.6)
        velocity = walk(position, velocity, ahead, OrcaSettings(dt=0.1), walls=near)
        position = position + 0.1 * velocity
    assert velocity.isfinite().all()
    assert position[..., 1].min() > 1.19


@pytest.mark.parametrize(
    ("side", "boxes", "agents"), [(120, None, 5), (50, None, 20), (120, 14, 5), (80, 8, 20)]
)
def test_rvo2_chooses_the_same_velocities(side: int, boxes: int | None, agents: int) -> None:
    pytest.importorskip("pyrvo")
    from tools.bench.compare_orca import Walk, plan

    scenes = Walk(plan(side, boxes or 0, 0), boxes is not None, 200 // agents, agents, 0)
    apart = []
    for _ in range(15):
        state, theirs = scenes.step()
        apart.append((state.ours(scenes.walls) - theirs).norm(dim=-1))
    gap = torch.stack(apart).flatten()
    assert gap.median() < 1e-6
    assert (gap < 1e-3).double().mean() > 0.998


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (2, 1), (3, 4)])
@pytest.mark.parametrize("obstacles", [0, 1, 16])
def test_few_people_and_few_walls(shape: tuple[int, int], obstacles: int) -> None:
    bank, ids = one_wall()
    position = 1.5 + torch.rand(*shape, 2)
    people = shape[0] * shape[1]
    near = bank.segments_near(position.flatten(0, 1), ids.expand(people), identity_pose(people), 3.6)
    settings = replace(SETTINGS, max_obstacles=obstacles)
    for mask in (present(position), ~present(position)):
        result = walk(position, torch.zeros_like(position), position, settings, walls=near, mask=mask)
        assert result.shape == position.shape
        assert result.isfinite().all()
        assert mask.any() or not result.any()


# Neighbours: a plain double loop is the oracle


def scene(kind: str, scenes: int = 3, agents: int = 24) -> tuple[Tensor, Tensor]:
    """Return positions (B, A, 2) and who is there."""
    random = torch.Generator().manual_seed(0)
    position = 12 * torch.rand(scenes, agents, 2, generator=random)
    if kind == "equal":  # whole metres: many equal distances, many at exactly the reach, many at one place
        position = position.round() // 2
    elif kind == "far":  # two groups 10 km apart, and one person at the end of the world
        position = 0.3 * position
        position[:, ::2] += torch.tensor([1e4, -1e4])
        position[0, 0] = 1e30
    elif kind == "one cell":
        position = 0.02 * position - 300
    mask = torch.rand(scenes, agents, generator=random) < 0.8
    mask[-1] = kind == "random"
    return torch.where(mask[..., None], position, math.nan), mask


KINDS = pytest.mark.parametrize("kind", ["random", "equal", "far", "one cell"])


def distance2(a: Tensor, b: Tensor) -> Tensor:
    """In the order of operations of the product, so that equal is equal."""
    gap = b - a
    return gap[0] * gap[0] + gap[1] * gap[1]


def oracle(position: Tensor, mask: Tensor, reach: float, most: int | None) -> list[list[int]]:
    """Return the neighbours of each of the B * A people."""
    agents = mask.shape[1]
    result: list[list[int]] = []
    for b, a in torch.cartesian_prod(torch.arange(len(mask)), torch.arange(agents)).tolist():
        others = [c for c in range(agents) if c != a and mask[b, a] and mask[b, c]]
        gaps = [(float(distance2(position[b, a], position[b, c])), c) for c in others]
        result.append([b * agents + c for gap, c in sorted(gaps)[:most] if gap < reach * reach])
    return result


@KINDS
@pytest.mark.parametrize(("reach", "most"), [(3.0, None), (3.0, 4), (1.0, 1), (40.0, None), (1e-3, 5)])
def test_the_nearest_are_the_oracles(kind: str, reach: float, most: int | None) -> None:
    position, mask = scene(kind)
    expected = oracle(position, mask, reach, most)
    for rows in (None, torch.tensor([70, 3, 3, 30]), torch.tensor([], dtype=torch.long)):
        index, near = nearest(position, mask, reach, most, rows)
        near = torch.ones_like(index, dtype=torch.bool) if near is None else near
        asked = list(range(mask.numel())) if rows is None else rows.tolist()
        assert [index[near[:, i], i].tolist() for i in range(len(asked))] == [expected[i] for i in asked]
        assert torch.equal(index[~near], torch.tensor(asked).expand_as(index)[~near])
        assert len(index) == max((len(expected[i]) for i in asked), default=0)


@pytest.mark.parametrize(("shape", "most"), [((0, 3), None), ((3, 0), None), ((2, 1), None), ((2, 3), 0)])
def test_no_people_have_no_neighbours(shape: tuple[int, int], most: int | None) -> None:
    index, near = nearest(torch.rand(*shape, 2), torch.ones(shape, dtype=torch.bool), 5.0, most)
    assert index.shape == (0, shape[0] * shape[1])
    assert near is None


def test_double_precision() -> None:
    position, mask = scene("random")
    single, double = (nearest(part, mask, 3.0, 6)[0] for part in (position, position.double()))
    assert torch.equal(single, double)
    edge = torch.tensor([[[0.0, 0.0], [3 - 1e-12, 0.0], [0.0, 3.0]]], dtype=torch.float64)
    index, near = nearest(edge, torch.ones(1, 3, dtype=torch.bool), 3.0, None)
    assert near is not None
    assert index[near].tolist() == [1, 0]


def test_a_crowd_is_searched_in_little_memory() -> None:
    """People among 20,000 are not compared with all others: 400 million pairs would be 1.6 GB."""
    position = 400 * torch.rand(1, 20_000, 2, generator=torch.Generator().manual_seed(0))
    mask = torch.ones(1, 20_000, dtype=torch.bool)
    _, near = nearest(position, mask, 3.0, 10)
    assert near is not None
    assert near.sum() == pytest.approx(20_000 * 20_000 * math.pi * 9 / 160_000, rel=0.05)
