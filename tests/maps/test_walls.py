"""Walls as boxes, exact distances to them and rays, against brute force over all cells."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.core.geometry import identity_pose, move_to_map, move_to_scene, turn_to_map, turn_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import read_plan, read_ros
from pedzoo.maps.grid import OCCUPIED, UNKNOWN, OccupancyGrid, boxes, merge_cells
from pedzoo.maps.plans import load_plan


def drawn(*rows: str, **options: object) -> OccupancyGrid:
    """A map from text, the first line at the top: ``#`` wall, ``?`` unknown, anything else free."""
    values = {"#": OCCUPIED, "?": UNKNOWN}
    cells = np.array([[values.get(letter, 0) for letter in row] for row in rows], dtype=np.uint8)
    return OccupancyGrid(np.flipud(cells), **{"resolution": 0.5, **options})  # type: ignore[arg-type]


def scattered(height: int, width: int, share: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width)) < share


def painted(parts: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """How many boxes cover each cell."""
    count = np.zeros(shape, dtype=int)
    for x0, y0, x1, y1 in parts:
        count[y0:y1, x0:x1] += 1
    return count


def brute_force(grid: OccupancyGrid, points: np.ndarray, unknown: str = "free") -> np.ndarray:
    """Signed distance of grid-frame points (N, 2), metres, to the squares: all of them are looked at."""
    rim = 40  # cells outside the map count as free
    walls = np.pad(grid.occupied(unknown), rim)  # type: ignore[arg-type]
    cells = points / grid.resolution + rim
    column, row = np.floor(cells).astype(int).T
    inside = walls[row, column]
    result = np.full(len(points), np.inf)
    for sign, side in ((1, walls), (-1, ~walls)):
        corners = np.argwhere(side)[:, ::-1]
        mine = inside == (sign < 0)
        if len(corners) and mine.any():
            gap = np.abs(cells[mine, None] - corners - 0.5) - 0.5
            result[mine] = sign * np.hypot(*np.maximum(gap, 0).transpose(2, 0, 1)).min(axis=1)
    return result * grid.resolution


def ask(
    grid: OccupancyGrid, points: np.ndarray | list[list[float]], **options: float
) -> tuple[Tensor, Tensor]:
    given = torch.as_tensor(np.asarray(points), dtype=torch.float64)
    bank = MapBank([grid], **options)  # type: ignore[arg-type]
    return bank.closest_wall(given, torch.full((len(given),), grid.map_id), identity_pose(len(given)))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_boxes_cover_every_wall_once_and_nothing_else(share: float) -> None:
    for seed, shape in enumerate([(1, 1), (1, 9), (9, 1), (23, 31)]):
        cells = scattered(*shape, share, seed)
        assert (painted(merge_cells(cells), shape) == cells).all()


def test_boxes_of_plain_walls_are_few() -> None:
    assert boxes(drawn("....", ".##.", ".##."), "free").tolist() == [[0.5, 0.0, 1.5, 1.0]]
    for count, rows in {
        0: ("..", ".."),
        4: ("#####", "#...#", "#...#", "#####"),
        6: ("#######", "#..#..#", "#.....#", "#..#..#", "#######"),
        5: ("#.#.#.#", "#.#.#.#", "#######"),  # fewer along the columns than along the rows or as many
    }.items():
        assert len(boxes(drawn(*rows), "free")) <= count
    grid = drawn("??", "..", "##")
    assert boxes(grid, "free").tolist() == [[0.0, 0.0, 1.0, 0.5]]
    assert sorted(boxes(grid, "wall").tolist()) == [[0.0, 0.0, 1.0, 0.5], [0.0, 1.0, 1.0, 1.5]]


def test_boxes_of_the_shared_maps(shared: Path) -> None:
    for path in sorted((shared / "maps").glob("*.yaml")):
        grid = read_ros(path)
        walls = grid.occupied("wall")
        parts = np.rint(boxes(grid, "wall") / grid.resolution).astype(int)
        assert (painted(parts, walls.shape) == walls).all()
        assert len(parts) < walls.sum() / 4


@pytest.mark.parametrize("share", [0.005, 0.1, 0.5, 0.9, 0.995])
def test_distance_is_that_to_the_nearest_square(share: float) -> None:
    for seed, shape in enumerate([(1, 1), (1, 12), (25, 19)]):
        cells = scattered(*shape, share, seed)
        cells[0, 0] = True
        grid = OccupancyGrid(cells, 0.5)
        points = np.random.default_rng(seed).uniform(-4, np.array(shape[::-1]) * 0.5 + 4, (1500, 2))
        points[:500] = np.round(points[:500], 1)  # many of them on edges and corners
        result, away = ask(grid, points, max_distance=20.0)
        error = np.abs(result.numpy() - brute_force(grid, points))
        # Hardly ever is a box missed, and then it is nearer by very little.
        assert error.max() < 0.01 * grid.resolution
        assert (error < 1e-9).mean() > 0.998
        # within a cell of a wall nothing is ever missed
        assert error[result.abs().numpy() <= 0.5].max(initial=0) < 1e-9
        assert torch.allclose(away.norm(dim=1), torch.ones(len(points), dtype=away.dtype))


def test_distances_and_directions_by_hand() -> None:
    grid = drawn(".....", "..#..", ".....")  # the wall is [1, 1.5] x [0.5, 1]
    points = [[0.25, 0.75], [1.25, 2.0], [1.8, 1.4], [1.1, 0.7], [1.5, 0.8], [1.25, 0.5], [-3.0, 0.75]]
    distance, away = ask(grid, points)
    assert distance.tolist() == pytest.approx([0.75, 1.0, 0.5, -0.1, 0.0, 0.0, 4.0], abs=1e-12)
    expected = [[-1, 0], [0, 1], [0.6, 0.8], [-1, 0], [1, 0], [0, -1], [-1, 0]]
    np.testing.assert_allclose(away.numpy(), expected, atol=1e-12)


def test_nothing_within_reach() -> None:
    grid = drawn("#....")
    for options in ({"max_distance": 1.0}, {}):
        far = options.get("max_distance", 5.0)
        distance, away = ask(grid, [[0.5 + far, 0.25], [-40.0, 90.0], [0.5 + far - 0.1, 0.25]], **options)
        assert distance.tolist() == pytest.approx([far, far, far - 0.1])
        assert away.tolist() == [[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]
    assert ask(drawn("..", "?."), [[0.5, 0.5], [50.0, 0.5]])[0].tolist() == [5.0, 5.0]
    assert ask(drawn("##", "##"), [[0.4, 0.5], [2.0, 0.5]])[0].tolist() == pytest.approx([-0.4, 1.0])
    distance, _ = ask(drawn("#..."), [[math.nan, 0.2], [1.0, 0.25]])  # who is lost harms nobody
    assert distance[0].isnan() and distance[1:].tolist() == [0.5]
    for bank in (MapBank(), MapBank([grid])):
        points = torch.tensor([[[0.2, 0.2], [1e6, 0.0]]])
        distance, away = bank.closest_wall(points, torch.tensor([-1]), identity_pose(1))
        assert distance.tolist() == [[5.0, 5.0]] and away.abs().max() == 0
        empty = bank.closest_wall(torch.zeros(0, 3, 2), torch.zeros(0, dtype=torch.long), torch.zeros(0, 4))
        assert [part.shape for part in empty] == [(0, 3), (0, 3, 2)]


def test_maps_of_a_bank_poses_and_shapes() -> None:
    """Two maps, one far away and turned, in turned, mirrored and moved scenes, agree with each alone."""
    grids = [
        OccupancyGrid(scattered(20, 30, 0.1, 1), 0.1, (-60.0, 40.0, 0.7), name="far"),
        OccupancyGrid(scattered(13, 9, 0.2, 2), 0.3, name="near"),
    ]
    bank = MapBank(grids)
    row = torch.tensor([0, 1, 1, 0, 1, 0])
    ids = torch.tensor([grids[number].map_id for number in row.tolist()])
    own = torch.rand(6, 3, 4, 2, dtype=torch.float64) * 4 - 0.5  # in the grids' frames
    origin = torch.tensor([grid.origin for grid in grids], dtype=torch.float64)[row]
    lie = torch.stack((origin[:, 2], torch.ones(6), origin[:, 0], origin[:, 1]), dim=1)
    pose = torch.stack(
        (torch.rand(6) * 6, torch.tensor([1.0, -1, 1, -1, -1, 1]), torch.rand(6), torch.rand(6))
    )
    pose = pose.T.double()
    in_scene = move_to_scene(move_to_scene(own, lie), pose)
    distance, away = bank.closest_wall(in_scene, ids, pose)
    assert distance.shape == (6, 3, 4)
    for entry, number in enumerate(row.tolist()):
        alone = ask(
            OccupancyGrid(grids[number].cells, grids[number].resolution), own[entry].reshape(-1, 2).numpy()
        )
        torch.testing.assert_close(distance[entry].flatten(), alone[0], atol=1e-9, rtol=0)
        turned = turn_to_scene(turn_to_scene(alone[1][None], lie[entry, None]), pose[entry, None])[0]
        torch.testing.assert_close(away[entry].view(-1, 2), turned, atol=1e-6, rtol=0)

    single, _ = bank.closest_wall(in_scene.float(), ids, pose.float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single.double(), distance, atol=1e-5, rtol=0)
    moved = bank.to("meta")
    assert moved.walls.choice.device.type == "meta" and bank.walls.choice.device.type == "cpu"


@pytest.mark.parametrize("share", [0.0, 0.02, 0.2, 1.0])
def test_rays_go_to_the_nearest_box(share: float) -> None:
    grids = [
        OccupancyGrid(scattered(40, 60, share, 1), 0.1, (-6.0, 4.0, 0.7), name="turned"),
        OccupancyGrid(scattered(13, 9, share, 2), 0.3, name="small"),
    ]
    bank, reach = MapBank(grids), 5.0
    ids = torch.tensor([grids[0].map_id, grids[1].map_id, -1])
    pose = torch.tensor([[0.3, -1.0, 2.0, 1.0], [2.0, 1.0, 0.0, -1.0], [0.0, 1.0, 0.0, 0.0]]).double()
    angle = torch.rand(3, 400, dtype=torch.float64) * 7
    angle[:, :8] = torch.arange(8) * math.pi / 4
    angle[1, :8] += 2.0  # along the axes of the small map
    direction = torch.stack((angle.cos(), angle.sin()), 2)
    origin = move_to_scene(
        torch.rand(3, 400, 2, dtype=torch.float64) * torch.tensor([[[6.0, 4.0]], [[2.7, 3.9]], [[1.0, 1.0]]]),
        torch.tensor([[0.7, 1.0, -6.0, 4.0], [0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]).double(),
    )
    origin[:, -40:] -= 4 * direction[:, -40:]  # some from outside the map
    expected = torch.full((3, 400), reach, dtype=torch.float64)
    lies = torch.tensor([[0.7, 1.0, -6.0, 4.0], [0.0, 1.0, 0.0, 0.0]]).double()
    for row, grid in enumerate(grids):
        o, d = (move_to_map(origin, lies[[0, 1, 1]])[row], turn_to_map(direction, lies[[0, 1, 1]])[row])
        parts = torch.from_numpy(boxes(grid, "free")).unsqueeze(1)
        if len(parts):
            slabs = torch.stack((parts[..., :2] - o, parts[..., 2:] - o)) / d
            enter, leave = slabs.amin(0).amax(-1), slabs.amax(0).amin(-1)
            met = torch.where((enter < leave) & (leave > 0), enter.clamp(0, reach), reach)
            expected[row] = met.amin(0)
    origin, direction = move_to_scene(origin, pose), turn_to_scene(direction, pose)
    rays = origin.permute(2, 1, 0), direction.permute(2, 1, 0)
    result = bank.walls_around(ids, pose).cast(*rays, reach).t()
    assert (result - expected).abs().max() < 1e-6


def test_the_gradient_is_the_direction() -> None:
    grid = OccupancyGrid(scattered(12, 12, 0.15, 3), 0.5)
    points = torch.rand(200, 2, dtype=torch.float64) * 6
    points.requires_grad_()
    bank, ids = MapBank([grid]), torch.full((200,), grid.map_id)
    pose = torch.tensor([[0.4, -1.0, 0.1, 0.2]]).repeat(200, 1)
    distance, away = bank.closest_wall(points, ids, pose)
    (gradient,) = torch.autograd.grad(distance.sum(), points)
    torch.testing.assert_close(gradient, away)
    assert not away.requires_grad
    step = 1e-5
    ahead, _ = bank.closest_wall(points.detach() + step * away, ids, pose)
    # walking away changes the distance by as much, except where another wall is as near
    assert ((ahead - distance.detach() - step).abs() < 1e-9).float().mean() > 0.97


def test_distances_on_a_real_map(shared: Path) -> None:
    grid = read_plan(shared / "maps" / "igibson_rs.yaml")
    points = np.random.default_rng(0).uniform(-1, 21, (20_000, 2))
    walls = np.pad(grid.occupied("wall"), 20)
    corner = points[:, None] / grid.resolution + 20
    expected = np.zeros(len(points))
    for sign, side in ((1, walls), (-1, ~walls)):
        parts = merge_cells(side)  # a partition: the nearest of these few is the nearest square
        gap = np.maximum(np.maximum(parts[:, :2] - corner, corner - parts[:, 2:]), 0)
        expected += sign * np.hypot(*gap.transpose(2, 0, 1)).min(axis=1) * grid.resolution
    bank = MapBank([grid], unknown="wall")
    ids = torch.full((len(points),), grid.map_id)
    result, _ = bank.closest_wall(
        torch.from_numpy(points) + torch.tensor(grid.origin[:2]), ids, identity_pose(len(points))
    )
    error = np.abs(result.numpy() - expected)
    assert error.max() < 0.05 * grid.resolution
    assert error[np.abs(expected) < 0.2].max() < 1e-9
    assert (error < 1e-9).mean() > 0.9999


def test_compiled_half_planes_are_those_of_torch():
    bank = MapBank([load_plan("apartment.7")])
    row, pose = torch.zeros(40, dtype=torch.long), torch.tensor([[0.7, -1.0, 2.0, 1.0]]).repeat(40, 1)
    walls = bank.walls_of_state(*bank.walls_of_scenes(row, pose))
    assert walls is not None
    points = 12 * torch.rand(2, 3, 40, 5, generator=torch.Generator().manual_seed(0)) - 4
    within = torch.full((40, 5), 0.3)
    found, wanted = walls.half_planes(points, within), walls.half_planes(points.double(), within.double())
    (gap, planes), (exact, exact_planes) = ((each[0], each[1:]) for each in (found, wanted))
    near = exact <= 0.3
    assert 0.1 < near.float().mean() < 0.9 and bool((gap[~near] > 0.3 - 1e-5).all())
    assert torch.allclose(gap[near].double(), exact[near], atol=1e-5)
    assert torch.allclose(planes[:, near].double(), exact_planes[:, near], atol=1e-4)
    # a place is as far inside of its half-plane as it is away from the wall
    inside = (points * planes[1:]).sum(0) - planes[0]
    assert torch.allclose(inside[near], gap[near], atol=1e-5)
