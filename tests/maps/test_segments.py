"""Outlines of walls and the look-up of the nearest segments, against drawings and brute force."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene
from pedzoo.maps import walls as stored_walls
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.segments import Segments, outlines, signed_area


def draw(*rows: str) -> NDArray[np.bool_]:
    """Return the walls of a drawing; its first line is the largest y."""
    return np.array([[cell == "#" for cell in row] for row in rows[::-1]])


def random_grid(seed: int = 0, name: str = "random") -> OccupancyGrid:
    cells = (np.random.default_rng(seed).random((14, 20)) < 0.25).astype(np.uint8)
    return OccupancyGrid(cells, 0.5, (3.0, -2.0, 0.7), name=name)


def canonical(polygon: NDArray[np.float64]) -> list[tuple[float, ...]]:
    corners = [tuple(corner) for corner in polygon.tolist()]
    first = corners.index(min(corners))
    return corners[first:] + corners[:first]


@pytest.mark.parametrize(
    ("drawing", "expected"),
    [
        (["....", "...."], []),
        ([".....", ".###.", ".###.", "....."], [[(1, 1), (4, 1), (4, 3), (1, 3)]]),  # counter-clockwise
        # a hole runs clockwise, and walls at the map's border are closed
        (["####", "#..#", "####"], [[(0, 0), (4, 0), (4, 3), (0, 3)], [(1, 1), (1, 2), (3, 2), (3, 1)]]),
        # solids that touch at a corner stay apart
        (["#.", ".#"], [[(0, 1), (1, 1), (1, 2), (0, 2)], [(1, 0), (2, 0), (2, 1), (1, 1)]]),
    ],
)
def test_outlines_have_walls_on_the_left(drawing: list[str], expected: list) -> None:
    assert sorted(canonical(polygon) for polygon in outlines(draw(*drawing))) == expected


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_exact_outlines_enclose_the_area_of_walls(share: float) -> None:
    occupied = np.random.default_rng(1).random((30, 40)) < share
    polygons = outlines(occupied, tolerance=0)
    assert sum(map(signed_area, polygons)) == occupied.sum()
    for polygon in polygons:
        steps = np.diff(np.vstack((polygon, polygon[:1])), axis=0)
        assert (np.count_nonzero(steps, axis=1) == 1).all()
        turned = steps * np.roll(steps, 1, axis=0)
        assert (turned == 0).all()


def test_a_staircase_becomes_straight_within_the_tolerance() -> None:
    occupied = np.tri(40, 40, dtype=bool)
    (exact,), (short,) = outlines(occupied, 0), outlines(occupied, 1.0)
    assert len(exact) > 70
    assert len(short) <= 6
    for corner in exact:
        gaps = []
        for a, b in pairwise(np.vstack((short, short[:1]))):
            t = np.clip((corner - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            gaps.append(np.linalg.norm(corner - a - t * (b - a)))
        assert min(gaps) <= 1 + 1e-6


def test_thin_walls_keep_their_area() -> None:
    occupied = draw("........", ".######.", "........", "..#.....", "........")
    assert sorted(map(signed_area, outlines(occupied, 1.5))) == [1, 6]


@pytest.fixture
def exact(monkeypatch) -> None:
    """Outlines run along the cells' edges."""
    monkeypatch.setattr(stored_walls, "outlines", lambda cells: outlines(cells, 0.0))


def brute_force(bank: MapBank, row: int, point: Tensor, pose: Tensor, reach: float) -> list:
    """Return distance, start and end of all segments in reach that a point is outside of, nearest first."""
    result = []
    for polygon in bank.walls.polygons()[row]:
        there = move_to_scene(torch.as_tensor(polygon)[None], pose[None].double())[0]
        if pose[1] < 0:
            there = there.flip(0)
        for a, b in zip(there, there.roll(-1, 0), strict=True):
            way, off = b - a, point.double() - a
            distance = (off - (off @ way / (way @ way)).clamp(0, 1) * way).norm()
            if way[0] * off[1] - way[1] * off[0] < 0 and distance < reach:
                result.append((float(distance), a, b))
    return sorted(result, key=lambda one: one[0])


def turned_left(direction: Tensor) -> Tensor:
    return torch.stack((-direction[1], direction[0]))


def ends(near: Segments, points: Tensor) -> tuple[Tensor, Tensor]:
    """Return where segments start and end (2, K, N), as the bank's polygons do where nothing is mirrored."""
    ahead = near.side * turned_left(near.direction)
    start = points.T[:, None] - near.along * near.direction + near.line_distance * ahead
    return start, start + near.length * near.direction


def distances(near: Segments) -> Tensor:
    beyond = near.along - near.along.minimum(near.length).clamp_min(0)
    return torch.hypot(beyond, near.line_distance)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_nearest_segments_are_those_of_brute_force(dtype: torch.dtype) -> None:
    grids = [random_grid(0), random_grid(1, "other")]
    bank = MapBank(grids)
    count = 60
    which = torch.randint(2, (count,))
    pose = torch.stack(
        (torch.rand(count) * 6, torch.randint(2, (count,)) * 2.0 - 1, torch.rand(count), torch.rand(count)), 1
    )
    places = torch.rand(count, 2) * torch.tensor([14.0, 12.0]) + torch.tensor([-2.0, -4.0])
    points = move_to_scene(places, pose)
    reach = 0.5 + 2 * torch.rand(count)
    ids = torch.tensor([grid.map_id for grid in grids])[which]
    near = bank.segments_near(points.to(dtype), ids, pose.to(dtype), reach.to(dtype), most=6)
    assert near.valid.amax(0).mean() > 0.5
    for i in range(count):
        expected = brute_force(bank, int(which[i]), points[i], pose[i], float(reach[i]))[:6]
        valid = near.valid[:, i] > 0
        assert valid.tolist() == [True] * len(expected) + [False] * (len(valid) - len(expected))
        result = distances(near)[valid, i]
        assert result.tolist() == pytest.approx([one[0] for one in expected], abs=1e-5)
        wanted = {tuple(torch.cat(one[1:]).mul(100).round().int().tolist()) for one in expected[:-1]}
        both = ends(near, points.to(dtype))
        mine = torch.cat(both if pose[i, 1] > 0 else both[::-1])[:, valid, i].T.mul(100).round().int()
        # the last one may be one of several at the same distance
        assert len(wanted - {tuple(one) for one in mine.tolist()}) <= 1


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_walls_are_on_the_left_and_neighbours_fit(mirror: float, exact: None) -> None:
    grid = random_grid()
    bank = MapBank([grid])
    pose = torch.tensor([[0.4, mirror, 1.0, -2.0]])
    middle = torch.tensor([[3.0 + 5 * math.cos(0.7) - 3.5 * math.sin(0.7), -2 + 5 * math.sin(0.7) + 2.7]])
    ids = torch.tensor([grid.map_id])
    near = bank.segments_near(move_to_scene(middle, pose), ids, pose, 30.0, most=500, farthest=30.0)
    start, end = (part[..., 0] for part in ends(near, move_to_scene(middle, pose)))
    direction, valid = near.direction[..., 0], near.valid[..., 0]
    assert valid.sum() > 50
    torch.testing.assert_close(direction, (end - start) / (end - start).norm(dim=0))
    wall = mirror * turned_left(direction)
    ids, poses = torch.full((len(valid),), grid.map_id), pose.expand(len(valid), 4)
    for side, sign in ((wall, -1), (-wall, 1)):
        beside = start + 0.25 * direction + 0.2 * side
        assert (sign * bank.signed_distance(beside.T, ids, poses) > 0).all()
    for corner, place, along in ((0, start, direction), (1, end, -direction)):
        x, y = near.neighbor[:, corner, :, 0]
        beside = place + 0.25 * (x * along + y * wall)
        on_border = bank.signed_distance(beside.T, ids, poses).abs() < 1e-4
        assert on_border.float().mean() > 0.9  # all but those along the border of the map
        assert torch.equal(near.convex[corner, :, 0] > 0, y >= 0)


def test_only_so_many_and_only_in_reach() -> None:
    grid = random_grid()
    bank, at = MapBank([grid]), (torch.tensor([[6.0, 3.0]]), torch.tensor([grid.map_id]), identity_pose(1))
    assert bank.segments_near(*at, 5.0, most=3).valid.sum() == 3
    assert bank.segments_near(*at, 1e-3, most=3).valid.shape == (0, 1)
    everything = bank.segments_near(*at, 5.0, most=100)
    assert torch.equal(bank.segments_near(*at, 5.0, most=3).along, everything.nearest(3).along)
    # a table that reaches farther finds the same
    near, far = (bank.segments_near(*at, 4.0, most=100, farthest=reach) for reach in (4.0, 9.0))
    assert torch.equal(near.along, far.along) and near.valid.sum() > 10


def test_outlines_are_shared_where_no_hollow_is_filled() -> None:
    solid = draw("........", ".######.", ".######.", "........")
    hollow = draw("........", ".######.", ".##.###.", ".######.")
    for cells, same in ((solid, True), (hollow, False)):
        walls = MapBank([OccupancyGrid(cells.astype(np.uint8), 0.05, name="plan")]).walls
        assert (walls.segments(1.0) is walls.segments(1.0, hollows=False)) == same


def test_people_without_walls() -> None:
    grid = random_grid()
    empty = OccupancyGrid(np.zeros((4, 4), np.uint8), 1.0, name="empty")
    points = torch.tensor([[6.0, 3.0], [6.0, 3.0], [1e4, -1e4], [math.nan, 0.0], [6.0, 3.0]])
    ids = torch.tensor([-1, empty.map_id, grid.map_id, grid.map_id, grid.map_id])
    near = MapBank([empty, grid]).segments_near(points, ids, identity_pose(5), 2.0)
    assert (near.valid > 0).any(0).tolist() == [False, False, False, False, True]
    for bank in (MapBank(), MapBank([grid])):
        alone = bank.segments_near(points[:1], torch.tensor([-1]), identity_pose(1), 2.0)
        assert alone.direction.shape == (2, 0, 1)
        no_points = bank.segments_near(points[:0], ids[:0], identity_pose(0), 2.0)
        assert no_points.direction.shape == (2, 0, 0)
    with pytest.raises(UserError, match="is not of this bank"):
        MapBank().segments_near(torch.zeros(1, 2), torch.tensor([7]), identity_pose(1), 1.0)


def test_people_selected_keep_their_segments() -> None:
    grid = random_grid()
    points = torch.tensor([[6.0, 3.0], [5.0, 2.0], [7.0, 1.0]])
    near = MapBank([grid]).segments_near(points, torch.full((3,), grid.map_id), identity_pose(3), 2.0)
    some = near.select(torch.tensor([2, 0]))
    assert torch.equal(some.direction, near.direction[..., [2, 0]])
    assert torch.equal(some.valid, near.valid[:, [2, 0]])
