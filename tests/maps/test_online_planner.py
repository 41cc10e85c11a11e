"""Paths to goals that keep changing: shortest ones, whatever was asked for before."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.sparse.csgraph import dijkstra

from pedzoo.core.geometry import identity_pose, move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import read_plan
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import load_plan


@pytest.fixture(scope="module")
def bank() -> MapBank:
    return MapBank([load_plan("apartment.7")])


def guided(planner: Planner, starts: np.ndarray, ids: torch.Tensor):
    points = torch.from_numpy(starts).float().unsqueeze(0)
    speeds = torch.full((1, len(starts)), 1.3)
    row = torch.tensor([0 if planner.bank.grids else -1])
    return planner.guidance(points, ids.unsqueeze(0), row, identity_pose(1), speeds, 3.2, 1.3)


def test_more_goals_than_there_was_room_for_and_forgotten_ones(bank):
    online = Planner(bank)
    graph = online.graph(0)
    points = graph.xy[:: len(graph) // 150]
    ids = online.add_goals(0, points)
    first = guided(online, points, ids.roll(1))
    again = online.without_goals()
    assert (online.goals, again.goals) == (len(points), 0)
    few = again.add_goals(0, points[:3])
    torch.testing.assert_close(
        guided(again, points[1:4], few).distance, guided(online, points[1:4], ids[:3]).distance
    )
    assert first.distance.shape == (1, len(points))


@pytest.mark.parametrize("plan", ["apartment.7", "office.7"])
def test_paths_do_not_depend_on_what_was_asked_before(plan):
    bank = MapBank([load_plan(plan)])
    walked = Planner(bank)
    graph, rng = walked.graph(0), np.random.default_rng(1)
    main = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    places, goals = (graph.xy[rng.choice(main, 12)] for _ in range(2))
    ids = walked.add_goals(0, goals)
    for _ in range(12):
        fresh = walked.without_goals()
        fresh.add_goals(0, goals)
        mine, theirs = guided(walked, places, ids), guided(fresh, places, ids)
        torch.testing.assert_close(mine.distance, theirs.distance, rtol=0, atol=1e-4)
        way = mine.waypoint[0].double().numpy() - places
        places = places + way * np.minimum(1, 0.5 / np.linalg.norm(way, axis=1, keepdims=True).clip(1e-9))


def drawn(seed: int, resolution: float, walls: float) -> OccupancyGrid:
    cells = np.where(np.random.default_rng(seed).random((26, 30)) < walls, OCCUPIED, 0).astype(np.uint8)
    return OccupancyGrid(cells, resolution, name=f"drawn {seed}")


def plan(name: str, shared: Path) -> OccupancyGrid:
    kind, _, rest = name.partition(" ")
    if kind == "drawn":
        seed, resolution, walls = rest.split()
        return drawn(int(seed), float(resolution), float(walls))
    grid = read_plan(shared / "maps" / kind) if kind.endswith(".yaml") else load_plan(kind)
    return grid.coarser(float(rest)) if rest else grid


def rooms_of(planner: Planner) -> np.ndarray:
    component = planner.graph(0).component
    return np.flatnonzero(component == np.bincount(component).argmax())


def shortest(planner: Planner, cells: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Lengths from open cells (P,) to others (G,): Dijkstra on cells that see each other, or all bends."""
    graph = planner.graph(0)
    free = np.pad(graph.open, 1, constant_values=True)
    beside = [
        ~np.roll(free, (a, b), (0, 1)) & np.roll(free, a, 0) & np.roll(free, b, 1)
        for a in (-1, 1)
        for b in (-1, 1)
    ]
    bends = graph.index[np.flatnonzero(np.logical_or.reduce(beside)[1:-1, 1:-1] & graph.open)]
    some = np.arange(len(graph)) if len(graph) < 500 else np.unique(np.concatenate((bends, cells, ends)))
    one, other = (part.ravel() for part in np.meshgrid(some, some))
    seen = graph.sight.clear(graph.place[one], graph.place[other])
    metres = np.where(seen, np.linalg.norm(graph.xy[one] - graph.xy[other], axis=1), 0)
    found = dijkstra(metres.reshape(len(some), -1), indices=np.searchsorted(some, ends))
    return found[:, np.searchsorted(some, cells)].T


PLANS = [
    "apartment.7",
    "office.25 0.1",
    "apartment.25 0.5",
    "igibson_rs.yaml 0.1",
    "aws_small_house.yaml 0.2",
]
PLANS += ["drawn 0 0.5 0.15", "drawn 1 0.5 0.3", "drawn 2 0.25 0.02", "drawn 3 0.05 0.004", "drawn 4 1.0 0.2"]


@pytest.mark.parametrize("name", PLANS)
def test_lengths_fall_along_waypoints_and_are_the_shortest(name: str, shared: Path) -> None:
    empty = Planner(MapBank([plan(name, shared)]))
    graph, rng, cell = empty.graph(0), np.random.default_rng(0), empty.graph(0).grid.resolution
    main = rooms_of(empty)
    corners = np.intersect1d(empty.corners(0).cells, main)
    cells = np.concatenate((rng.choice(corners, 25), rng.choice(main, 25)))
    ends = np.concatenate((rng.choice(corners, 2), rng.choice(main, 2)))
    expected = shortest(empty, cells, ends)
    corners_first = np.array([(i, k) for i in range(len(cells)) for k in range(len(ends))])
    # what was asked before must not matter
    for order in (corners_first, corners_first[::-1].copy(), rng.permutation(corners_first)):
        online = empty.without_goals()
        ids = online.add_goals(0, graph.xy[ends])
        for some in np.array_split(order, 3):
            starts, goals, exact = cells[some[:, 0]], ids[some[:, 1]], expected[some[:, 0], some[:, 1]]
            # anywhere in the cell, also on its border
            aside = rng.choice([-0.4999, 0.0, 0.3, 0.4999], (len(some), 2)) * cell
            for shift in (aside * 0, aside):
                seen = guided(online, graph.xy[starts] + shift, goals)
                off = np.abs(seen.distance[0].numpy() - exact)
                assert (off < np.linalg.norm(shift, axis=1) + 1e-4).all()
                while not bool((there := seen.distance[0] < 1e-4).all()):
                    onward = guided(online, seen.waypoint[0].double().numpy(), goals)
                    assert bool(((onward.distance[0] < seen.distance[0] - 1e-3 * cell) | there).all())
                    seen = onward
                torch.testing.assert_close(seen.waypoint, seen.goal_point, rtol=0, atol=1e-4)


def test_goals_beside_the_centres_of_cells_and_any_pose(bank: MapBank) -> None:
    online, rng = Planner(bank), np.random.default_rng(5)
    graph, main = online.graph(0), rooms_of(online)
    places, ends = (graph.xy[rng.choice(main, 60)] + rng.uniform(-0.024, 0.024, (60, 2)) for _ in range(2))
    ids, points = online.add_goals(0, ends), torch.from_numpy(places).float()
    plain = guided(online, places, ids)
    lengths = [
        np.linalg.norm(np.diff(np.concatenate(([a], online.path(a, b, 0))), axis=0), axis=1).sum()
        for a, b in zip(places, ends, strict=True)
    ]
    np.testing.assert_allclose(plain.distance[0], lengths, rtol=0, atol=0.04)
    fresh = online.without_goals()
    fresh.add_goals(0, ends)
    turned = torch.tensor([[2.1, -1.0, 7.0, -3.0]])
    moved = move_to_scene(points, turned.expand(60, 4))
    rows, speeds = torch.tensor([0]), torch.full((1, 60), 1.3)
    for planner in (online, fresh):
        there = planner.guidance(moved.unsqueeze(0), ids.unsqueeze(0), rows, turned, speeds, 3.2, 1.3)
        torch.testing.assert_close(there.distance, plain.distance, rtol=0, atol=1e-3)
    map_ids = torch.full((60,), bank.grids[0].map_id)
    other = fresh.without_goals()
    other.add_goals(0, ends)
    found = other.next_waypoints(moved, ids, map_ids, turned.expand(60, 4))
    torch.testing.assert_close(found.distance, plain.distance[0], rtol=0, atol=1e-3)


def test_memory_grows_with_people_and_not_with_goals_times_cells() -> None:
    bank = MapBank([load_plan("apartment.7").coarser(0.1)])
    online, rng = Planner(bank), np.random.default_rng(2)
    graph, main = online.graph(0), rooms_of(online)
    places, ends = (graph.xy[rng.choice(main, 400)] for _ in range(2))
    _ = online.corners(0).matrix, bank.walls
    tracemalloc.start()
    ids = online.add_goals(0, ends)
    for _ in range(20):
        seen = guided(online, places, ids)
        places = places + seen.desired_velocity[0].double().numpy() * 0.3
    assert tracemalloc.get_traced_memory()[1] < 6e6  # fields of all cells would take 22e6
    tracemalloc.stop()
    fresh = online.without_goals()
    fresh.add_goals(0, ends)
    mine, theirs = guided(online, places, ids), guided(fresh, places, ids)
    torch.testing.assert_close(mine.distance, theirs.distance, rtol=0, atol=1e-3)
