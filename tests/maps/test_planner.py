"""The planner, against ways computed by hand, a brute-force search, and people who follow it."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_map, move_to_scene, turn_to_map
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import read_plan
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.planning import graph
from pedzoo.maps.planning.graph import OpenGraph
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import rectangles, room, wall


def drawn(*rows: str, **options: object) -> OccupancyGrid:
    """A plan of 1 m cells drawn with # for walls, the first row at the top."""
    cells = np.array([[OCCUPIED * (c == "#") for c in row] for row in rows], dtype=np.uint8)
    return OccupancyGrid(np.flipud(cells), 1.0, **options)  # type: ignore[arg-type]


def cells_planner(grid: OccupancyGrid) -> Planner:
    """With this clearance every free cell of a plan of 1 m cells is open: ways can be drawn on paper."""
    return Planner(MapBank([grid]), clearance=0.5)


TWO_ROOMS = drawn(".......", "...#...", "...#...", "...#...", "...#...")


@cache
def flat() -> tuple[MapBank, Planner]:
    """Two rooms of 4 x 4 m with a door of 0.9 m between them, which is not in their middle."""
    walls = room((0, 0), (8.2, 4), 0.1) + wall((4.1, 0), (4.1, 4), 0.2, doors=[(3.0, 0.9)])
    bank = MapBank([rectangles(walls, resolution=0.05, name="flat")], unknown="wall")
    return bank, Planner(bank)


def apartment(shared: Path) -> tuple[MapBank, Planner]:
    grid = read_plan(shared / "maps" / "igibson_rs.yaml")
    bank = MapBank([grid], unknown="wall")
    return bank, Planner(bank)


def arguments(bank: MapBank, people: int) -> tuple[Tensor, Tensor]:
    return torch.full((people,), bank.grids[0].map_id), identity_pose(people)


def next_waypoints(planner: Planner, points: Tensor, goal: Tensor) -> Guidance:
    return planner.next_waypoints(points, goal, *arguments(planner.bank, len(points)))


def guide(planner: Planner, points: Tensor, goal: Tensor, speed: float = 1.0, ahead: float = 3.2) -> Guidance:
    speeds = torch.full((len(points),), speed)
    return guidance_of(planner, points, goal, *arguments(planner.bank, len(points)), speeds, ahead)


def guidance_of(
    planner: Planner, points: Tensor, goal: Tensor, map_id: Tensor, pose: Tensor, speed: Tensor, ahead: float
) -> Guidance:
    """Guide people (P,) of whom each is in a scene of their own."""
    scenes = points.unsqueeze(1), goal.unsqueeze(1), planner.map_rows(map_id), pose, speed.unsqueeze(1)
    result = planner.guidance(*scenes, ahead, float(speed.max()))
    return Guidance(*(value.squeeze(1) for value in result))


def rooms_of(planner: Planner) -> np.ndarray:
    """Numbers of the open cells of the largest component."""
    component = planner.graph(0).component
    return np.flatnonzero(component == np.bincount(component).argmax())


def random_plan(seed: int, size: int = 14, walls: float = 0.3) -> OccupancyGrid:
    free = np.random.default_rng(seed).random((size, size)) > walls
    return OccupancyGrid(np.where(free, 0, OCCUPIED).astype(np.uint8), 1.0)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_torch_guides_as_compiled_loops_do(mirror: float) -> None:
    """Over free places of two rooms, for fast and slow people who look far and near; on goals, too."""
    bank, _ = flat()
    planner, slow = Planner(bank), Planner(bank)
    slow.compiled = False
    generator = torch.Generator().manual_seed(4)
    graph = planner.graph(0)
    cell = torch.randint(len(graph), (40,), generator=generator)
    there = torch.from_numpy(graph.xy)[cell].float() + 0.02 * torch.rand(40, 2, generator=generator)
    ends = torch.from_numpy(graph.xy)[torch.randint(len(graph), (5,), generator=generator)].numpy()
    pose = torch.tensor([[0.7, mirror, 3.0, -2.0]])
    points = move_to_scene(there.view(1, 40, 2), pose)
    speed = 0.3 + 1.5 * torch.rand(1, 40, generator=generator)
    for ahead in (0.4, 3.2):
        results = []
        for one in (planner, slow):
            ids = one.add_goals(0, ends)[torch.arange(40) % 5].view(1, 40)
            ids[:, 7] = -1
            results.append(one.guidance(points, ids, torch.tensor([0]), pose, speed, ahead, 1.8))
        torch.testing.assert_close(*results, rtol=1e-4, atol=1e-4)


def test_places_outside_a_plan_have_its_nearest_cells() -> None:
    graph = cells_planner(drawn("........", "........", "........")).graph(0)
    cell, inside = graph.locate(np.array([[20.0, 1.5], [7.5, 9.0], [-3.0, -3.0], [5.5, 2.5]]))
    assert cell.tolist() == [15, 23, 0, 21] and inside.tolist() == [False, False, False, True]


def test_without_a_floor_plan_a_path_is_straight() -> None:
    assert Planner(MapBank([])).path((0.0, 1.0), (3.0, 4.0), -1).tolist() == [[3.0, 4.0]]


def test_small_pockets_are_left_out() -> None:
    """One of 0.25 square metres is; where nothing is larger, the largest stays."""
    cells = np.full((20, 20), OCCUPIED, np.uint8)
    cells[2:7, 2:7] = 0  # 0.25 square metres
    small = OccupancyGrid(cells.copy(), 0.1)
    assert len(Planner(MapBank([small]), 0.01).graph(0)) == 25
    cells[10:18, 10:18] = 0  # 0.64 square metres
    assert len(Planner(MapBank([OccupancyGrid(cells, 0.1)]), 0.01).graph(0)) == 64


def test_ways_by_hand() -> None:
    planner = cells_planner(TWO_ROOMS)
    way = planner.path((0.5, 0.5), (6.5, 0.5), 0)
    assert way.tolist() == [[2.5, 4.5], [4.5, 4.5], [6.5, 0.5]]
    assert planner.path((0.5, 0.5), (0.6, 4.3), 0).tolist() == [[0.6, 4.3]]  # in sight

    goal = planner.add_goals(0, [(6.5, 0.5)])
    points = torch.tensor([[0.5, 0.5], [2.5, 4.5], [3.4, 4.6], [5.0, 3.0], [6.5, 0.5]])
    result = next_waypoints(planner, points, goal.expand(5))
    root = math.sqrt(20)
    assert result.waypoint.tolist() == [[2.5, 4.5], [4.5, 4.5], [4.5, 4.5], [6.5, 0.5], [6.5, 0.5]]
    assert result.goal_point.tolist() == [[6.5, 0.5]] * 5
    expected = [2 * root + 2, 2 + root, math.hypot(1.1, 0.1) + root, math.hypot(1.5, 2.5), 0]
    assert result.distance.tolist() == pytest.approx(expected, abs=1e-5)


def test_diagonal_steps_do_not_cut_corners() -> None:
    grid = drawn("..#", ".#.", "...")
    planner = cells_planner(grid)
    assert planner.path((0.5, 0.5), (2.5, 1.5), 0).tolist() == [[2.5, 0.5], [2.5, 1.5]]


@pytest.mark.parametrize("seed", range(6))
def test_lines_of_sight_are_those_of_a_dense_sampling(seed: int) -> None:
    graph = OpenGraph(random_plan(seed, 20, 0.1), "wall", 0.5)
    numbers = np.random.default_rng(seed).integers(0, len(graph), (600, 2))
    origin, target = graph.place[numbers[:, 0]], graph.place[numbers[:, 1]]
    # never a point where two cells meet: a sample is inside a square, or on an edge between two cells
    part = (np.arange(997) + 0.5) / 997
    points = origin[:, None] + (target - origin)[:, None] * part[:, None]
    low, high = np.floor(points + 1e-9).astype(int), np.ceil(points - 1e-9).astype(int)
    around = [graph.open[y, x] for x in (low[..., 0], high[..., 0]) for y in (low[..., 1], high[..., 1])]
    expected = np.logical_and.reduce(around).all(axis=1)
    assert 20 < expected.sum() < 580
    assert np.array_equal(graph.sight.clear(origin, target), expected)
    assert np.array_equal(graph.sight.clear(target, origin), expected)


def check_clearance(bank: MapBank, planner: Planner) -> None:
    """Every point of every way keeps the clearance, but for what bilinear reading is off by."""
    graph, rooms = planner.graph(0), rooms_of(planner)
    goals = planner.add_goals(0, graph.xy[rooms[:: len(rooms) // 5]])
    points = torch.from_numpy(graph.xy[rooms]).float()
    for goal in goals:
        result = next_waypoints(planner, points, goal.expand(len(points)))
        part = torch.linspace(0, 1, 60)[:, None]
        line = points[:, None] + (result.waypoint - points)[:, None] * part
        assert bank.signed_distance(line, *arguments(bank, len(line))).min() > planner.clearance - 1e-4


def test_ways_keep_the_clearance(shared: Path) -> None:
    check_clearance(*flat())
    check_clearance(*apartment(shared))


def walk(bank: MapBank, planner: Planner, goal: Tensor, starts: Tensor, speed: float = 1.3) -> None:
    """Follow the desired velocity in steps of 0.1 s: all arrive in time, without touching walls."""
    points, goals = starts.clone(), goal.expand(len(starts))
    here = arguments(bank, len(points))
    first = next_waypoints(planner, points, goals).distance
    walked, arrived = torch.zeros(len(points)), torch.zeros(len(points), dtype=torch.bool)
    for _ in range(int(first.max() * 1.1 / (speed * 0.1)) + 5):
        seen = guide(planner, points, goals, speed)
        arrived |= (points - seen.goal_point).norm(dim=1) < 0.3
        step = torch.where(arrived[:, None], 0.0, seen.desired_velocity * 0.1)
        walked += step.norm(dim=1)
        points = points + step
        distance, _ = bank.closest_wall(points, *here)
        assert distance.min() > 0.15
    assert arrived.all()
    assert (walked < 1.05 * first + 0.2).all()


def test_all_people_get_there(shared: Path) -> None:
    for bank, planner in (flat(), apartment(shared)):
        graph, rooms = planner.graph(0), rooms_of(planner)
        for goal in planner.add_goals(0, graph.xy[rooms[len(rooms) // 5 :: len(rooms) // 2]]):
            walk(bank, planner, goal, torch.from_numpy(graph.xy[rooms]).float())


def test_people_pushed_aside_find_back() -> None:
    bank, planner = flat()
    goal = planner.add_goals(0, [(7.0, 1.0)])
    # along the walls of the first room, a body's radius away from them
    edge = torch.arange(0.2, 3.8, 0.05)
    side = torch.full_like(edge, 0.17)
    starts = torch.cat(
        [torch.stack(pair, 1) for pair in ((edge, side), (side, edge), (edge, 4 - side), (4 - side, edge))]
    )
    inside = bank.closest_wall(starts, *arguments(bank, len(starts)))[0] > 0.16
    walk(bank, planner, goal, starts[inside])


def test_ways_from_walls_begin_at_the_nearest_open_cell() -> None:
    planner = cells_planner(TWO_ROOMS)
    goal = planner.add_goals(0, [(6.5, 0.5)])
    result = next_waypoints(planner, torch.tensor([[-4.5, 0.5], [3.6, 0.5]]), goal.expand(2))
    assert result.waypoint[0].tolist() == [0.5, 0.5]
    assert float(result.distance[0]) == pytest.approx(5 + 2 * math.sqrt(20) + 2, abs=1e-5)
    assert float(result.waypoint[1, 0]) in (2.5, 4.5) or result.waypoint[1].tolist() == [6.5, 0.5]
    assert result.distance.isfinite().all()


def test_a_turned_mirrored_and_moved_scene_is_told_the_same() -> None:
    bank, planner = flat()
    graph, rooms = planner.graph(0), rooms_of(planner)
    draws = torch.Generator().manual_seed(0)
    points = torch.from_numpy(graph.xy[rooms[::9]]).float()
    count = len(points)
    goals = planner.add_goals(0, graph.xy[rooms[:: len(rooms) // 9]])[torch.arange(count) % 9]
    mirror = torch.randint(0, 2, (count,), generator=draws) * 2.0 - 1
    numbers = torch.rand(count, 3, generator=draws) * 6
    pose = torch.stack((numbers[:, 0], mirror, numbers[:, 1], numbers[:, 2]), dim=1)
    ids, speed = torch.full((count,), bank.grids[0].map_id), torch.full((count,), 1.2)
    # rounding must not decide which cell it is, or whether a line passes a wall at just a body's radius
    points = points + torch.rand(count, 2, generator=draws) * 0.02
    plain = guidance_of(planner, points, goals, ids, identity_pose(count), speed, 3.2)
    moved = guidance_of(planner, move_to_scene(points, pose), goals, ids, pose, speed, 3.2)
    for name in ("goal", "carrot", "waypoint", "goal_point"):
        back = move_to_map(getattr(moved, name), pose)
        torch.testing.assert_close(back, getattr(plain, name), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(
        turn_to_map(moved.desired_velocity, pose), plain.desired_velocity, atol=1e-4, rtol=1e-4
    )
    torch.testing.assert_close(moved.distance, plain.distance, atol=1e-4, rtol=1e-4)
    first = planner.next_waypoints(points, goals, ids, identity_pose(count))
    again = planner.next_waypoints(move_to_scene(points, pose), goals, ids, pose)
    torch.testing.assert_close(move_to_map(again.waypoint, pose), first.waypoint, atol=1e-4, rtol=1e-4)


def test_the_carrot_by_hand() -> None:
    planner = cells_planner(drawn(*["." * 12] * 12))
    goal = planner.add_goals(0, [(8.5, 2.5)])
    seen = guide(planner, torch.tensor([[2.5, 2.5], [7.5, 2.5], [8.5, 5.5]]), goal.expand(3), speed=1.25)
    # 4 m ahead: on the way; prolonged beyond the goal; the same from above
    assert seen.goal.flatten().tolist() == pytest.approx([6.5, 2.5, 11.5, 2.5, 8.5, 1.5], abs=1e-5)
    assert seen.desired_velocity.flatten().tolist() == pytest.approx([1.25, 0, 1.25, 0, 0, -1.25], abs=1e-5)

    around = cells_planner(TWO_ROOMS)
    goal = around.add_goals(0, [(6.5, 0.5)])
    seen = guide(around, torch.tensor([[2.5, 3.5], [2.5, 3.5]]), goal.expand(2), speed=1.0, ahead=2.0)
    # a metre up to the waypoint, then a metre to the right: in sight over the wall's corner
    assert seen.waypoint.tolist() == [[2.5, 4.5]] * 2
    x, y = seen.carrot[0].tolist()
    assert y == pytest.approx(4.5)
    assert 2.5 <= x <= 3.5
    # the goal is on the same line, 2 m away
    away = seen.goal[0] - torch.tensor([2.5, 3.5])
    assert float(away.norm()) == pytest.approx(2.0, abs=0.01)
    assert math.atan2(*away.tolist()) == pytest.approx(math.atan2(x - 2.5, 1.0), abs=0.05)


@pytest.mark.parametrize("compiled", [True, False])
def test_the_carrot_is_seen_and_as_far_as_the_way(compiled: bool, monkeypatch) -> None:
    bank, planner = flat()
    monkeypatch.setattr(planner, "compiled", compiled)
    graph, rooms = planner.graph(0), rooms_of(planner)
    points = torch.from_numpy(graph.xy[rooms]).float()
    here = arguments(bank, len(points))
    cut = 0
    for goal in planner.add_goals(0, [(7.0, 1.0), (0.5, 0.5), (4.1, 3.0)]):
        seen = guide(planner, points, goal.expand(len(points)), speed=1.3)
        ahead = 1.3 * 3.2
        chord = seen.carrot - points
        free = (seen.waypoint - points).norm(dim=1) >= ahead
        assert chord[free].norm(dim=1).numpy() == pytest.approx(ahead, abs=1e-4)
        assert (chord.norm(dim=1) < ahead + 1e-4).all()
        part = torch.linspace(0, 1, 200)[:, None]
        line = points[:, None] + chord[:, None] * part
        least = bank.signed_distance(line, *here).min(dim=1).values
        assert least.min() > 0  # never through a wall
        assert (least > 0.1).float().mean() > 0.99
        to_waypoint = (seen.waypoint - points).norm(dim=1)
        assert (chord.norm(dim=1) > to_waypoint.clamp_max(ahead) - 0.35).all()
        cut += int((chord.norm(dim=1) < to_waypoint + 1e-4).sum())
    assert cut > 0  # a person stands where only the waypoint is in sight


def test_standing_on_waypoint_and_goal() -> None:
    planner = cells_planner(TWO_ROOMS)
    goal = planner.add_goals(0, [(6.5, 0.5)])
    points = torch.tensor([[2.5, 4.5], [6.5, 0.5]], requires_grad=True)
    seen = guide(planner, points, goal.expand(2))
    assert seen.desired_velocity[0].tolist() == pytest.approx([1, 0])
    assert seen.desired_velocity[1].tolist() == [0, 0]
    assert seen.goal[1].tolist() == [6.5, 0.5]
    (gradient,) = torch.autograd.grad(sum(part.sum() for part in seen), points)  # type: ignore[arg-type]
    assert gradient.isfinite().all()


def test_gradients_pass_through_positions() -> None:
    _, planner = flat()
    goal = planner.add_goals(0, [(7.0, 1.0)])
    points = torch.tensor([[1.0, 1.0], [6.0, 2.0]], requires_grad=True)
    seen = guide(planner, points, goal.expand(2))
    assert not seen.waypoint.requires_grad
    (gradient,) = torch.autograd.grad(seen.distance.sum(), points, retain_graph=True)
    torch.testing.assert_close(gradient, -seen.desired_velocity)
    (gradient,) = torch.autograd.grad(seen.desired_velocity[0, 0], points)
    assert gradient.isfinite().all()
    assert gradient[0].abs().sum() > 0


def test_goals_keep_their_numbers() -> None:
    _, planner = flat()
    planner = Planner(planner.bank)
    first = planner.add_goals(0, [(1.0, 1.0), (7.0, 1.0), (1.0, 1.0)])
    assert first.tolist() == [0, 1, 0]
    before = next_waypoints(planner, torch.tensor([[2.0, 2.0]]), first[1:2])
    # two goals in one cell are two goals; no map: as the crow flies
    second = planner.add_goals(0, torch.tensor([[7.0, 1.0], [7.001, 1.0]], dtype=torch.float64))
    third = planner.add_goals(-1, [(7.0, 1.0)])
    assert second.tolist() == [1, 2]
    assert third.tolist() == [3]
    assert planner.add_goals(0, torch.zeros(0, 2)).tolist() == []
    after = next_waypoints(planner, torch.tensor([[2.0, 2.0]]), second[:1])
    torch.testing.assert_close(before, after, rtol=0, atol=0)


def test_people_without_map_or_goal() -> None:
    bank, planner = flat()
    everywhere = planner.add_goals(-1, [(3.0, 4.0)])
    somewhere = planner.add_goals(0, [(7.0, 1.0)])
    ids = torch.tensor([-1, bank.grids[0].map_id, -1, bank.grids[0].map_id])
    goals = torch.tensor([int(everywhere), -1, -1, int(somewhere)])
    points = torch.tensor([[0.0, 0.0], [1.0, 1.0], [90.0, 0.0], [6.0, 1.0]])
    result = planner.next_waypoints(points, goals, ids, identity_pose(4))
    assert result.waypoint.tolist() == [[3, 4], [1, 1], [90, 0], [7, 1]]
    assert result.distance.tolist() == pytest.approx([5, 0, 0, 1])
    seen = guidance_of(planner, points, goals, ids, identity_pose(4), torch.ones(4), 2.0)
    assert seen.desired_velocity.flatten().tolist() == pytest.approx([0.6, 0.8, 0, 0, 0, 0, 1, 0])
    assert seen.goal[:3].flatten().tolist() == pytest.approx([1.2, 1.6, 1, 1, 90, 0])
    empty = planner.next_waypoints(points[:0], goals[:0], ids[:0], identity_pose(0))
    assert empty.distance.shape == (0,)
    assert Planner(MapBank()).add_goals(-1, [(0, 0)]).tolist() == [0]


def test_several_maps_of_one_bank() -> None:
    other = drawn("....", ".##.", "....", name="other", origin=(3.0, -2.0, math.pi / 2))
    planner = cells_planner(TWO_ROOMS)
    alone = Planner(MapBank([other]), clearance=0.5)
    both = Planner(MapBank([TWO_ROOMS, other]), clearance=0.5)
    graph = alone.graph(0)
    starts = torch.from_numpy(graph.xy).float()
    mine, theirs = planner.add_goals(0, [(6.5, 0.5)]), alone.add_goals(0, graph.xy[:1])
    first = both.add_goals(0, [(6.5, 0.5)])
    one = next_waypoints(planner, torch.tensor([[0.5, 0.5]]), mine)
    again = next_waypoints(both, torch.tensor([[0.5, 0.5]]), first)  # before the second map is used
    second = both.add_goals(1, graph.xy[:1])
    ids = torch.full((len(starts),), other.map_id)
    two = alone.next_waypoints(starts, theirs.expand(len(starts)), ids, identity_pose(len(starts)))
    mixed = both.next_waypoints(starts, second.expand(len(starts)), ids, identity_pose(len(starts)))
    torch.testing.assert_close((one, two), (again, mixed))
    with pytest.raises(UserError, match="goal 1 was added for row 1 of the bank, but person 0 is on row 0"):
        next_waypoints(both, torch.tensor([[0.5, 0.5]]), second)


def test_no_way() -> None:
    grid = drawn("..#..", "..#..", name="halves")
    planner = cells_planner(grid)
    with pytest.raises(UserError, match=r"no way from \(0.50, 0.50\) to \(4.50, 0.50\) on map 'halves'"):
        planner.path((0.5, 0.5), (4.5, 0.5), 0)
    goal = planner.add_goals(0, [(4.5, 0.5)])
    points = torch.tensor([[0.5, 0.5], [3.5, 0.5]])
    result = next_waypoints(planner, points, goal.expand(2))
    assert result.distance.tolist() == [math.inf, 1]
    assert result.waypoint.tolist() == [[0.5, 0.5], [4.5, 0.5]]
    seen = guide(planner, points, goal.expand(2))
    assert seen.desired_velocity.tolist() == [[0, 0], [1, 0]]
    assert seen.goal[0].tolist() == [0.5, 0.5]


def test_bad_goals_are_moved_a_little_or_refused() -> None:
    bank, planner = flat()
    near = planner.add_goals(0, [(0.1, 1.025)])  # 0.1 m from a wall: moved to the next open cell's centre
    result = next_waypoints(planner, torch.tensor([[1.0, 1.0]]), near)
    assert result.goal_point[0].tolist() == pytest.approx([0.275, 1.025], abs=1e-4)
    assert planner.add_goals(0, [(0.1, 1.025)]).tolist() == near.tolist()
    with pytest.raises(UserError, match=r"goal \(-3.00, 1.00\) is outside the map on map 'flat'.*\(0.2"):
        planner.add_goals(0, [(1.0, 1.0), (-3.0, 1.0)])
    # a coarse cell is open, and people do not fit into its corner
    cells = np.pad(np.zeros((4, 6), np.uint8), 1, constant_values=OCCUPIED)
    coarse = Planner(MapBank([OccupancyGrid(cells, 0.5)]))
    ids = coarse.add_goals(0, [(0.53, 0.53), (0.9, 0.6), (0.7, 0.8)])
    places = next_waypoints(coarse, torch.tensor([[2.0, 2.0]]).expand(3, 2), ids).goal_point
    torch.testing.assert_close(places, torch.tensor([[0.75, 0.75], [0.75, 0.75], [0.7, 0.8]]))
    thick = MapBank([drawn("###..", "###..", "###..", name="thick")])
    with pytest.raises(UserError, match=r"goal \(0.50, 1.50\) is in a wall.*\(3.50, 1.50\), more than 0.5 m"):
        Planner(thick).add_goals(0, [(0.5, 1.5)])
    with pytest.raises(UserError, match=r"start or goal .* outside the map"):
        planner.path((-3.0, 1.0), (1.0, 1.0), 0)
    with pytest.raises(UserError, match="finite"):
        planner.add_goals(0, [(math.nan, 1.0)])
    with pytest.raises(UserError, match="no way through it"):
        Planner(MapBank([drawn("###", name="solid")])).add_goals(0, [(0.5, 0.5)])
    with pytest.raises(UserError, match="at least 0"):
        Planner(bank, clearance=-1)


def test_lines_of_sight_are_kept_on_disk(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PEDZOO_HOME", str(tmp_path))
    monkeypatch.setattr(graph, "_KEPT", 0)
    grid = random_plan(3)
    first = cells_planner(grid).corners(0).matrix.toarray()
    (file,) = (tmp_path / "planner").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(graph.Sight, "clear", None)  # nothing is looked for again
        assert np.array_equal(cells_planner(grid).corners(0).matrix.toarray(), first)
    np.save(tmp_path / "other.npy", np.full((2, 3), 10**6))  # of more corners than there are
    for broken in (b"", file.read_bytes()[:-9], (tmp_path / "other.npy").read_bytes()):
        file.write_bytes(broken)
        assert np.array_equal(cells_planner(grid).corners(0).matrix.toarray(), first)
