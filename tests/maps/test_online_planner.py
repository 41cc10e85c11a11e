"""Paths to goals that keep changing: shortest ones, without fields of whole floor plans."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.named_plans import load_plan
from pedzoo.maps.planning.online import OnlinePlanner
from pedzoo.maps.planning.planner import Planner


@pytest.fixture(scope="module")
def bank() -> MapBank:
    return MapBank([load_plan("apartment.7")])


def guided(planner: Planner, starts: np.ndarray, ids: torch.Tensor):
    points = torch.from_numpy(starts).float().unsqueeze(0)
    speeds = torch.full((1, len(starts)), 1.3)
    row = torch.tensor([0 if planner.bank.grids else -1])
    return planner.guidance(points, ids.unsqueeze(0), row, identity_pose(1), speeds, 3.2, 1.3)


def test_paths_are_shortest_and_nearly_those_of_fields(bank):
    online, fields = OnlinePlanner(bank), Planner(bank)
    graph, rng = online.graph(0), np.random.default_rng(0)
    main = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    starts = graph.xy[rng.choice(main, 40)] + rng.uniform(-0.02, 0.02, (40, 2))
    goals = graph.xy[rng.choice(main, 40)]
    mine = guided(online, starts, online.add_goals(0, goals))
    theirs = guided(fields, starts, fields.add_goals(0, goals))
    torch.testing.assert_close(mine.goal_point, theirs.goal_point)
    assert bool((mine.distance <= theirs.distance + 0.03).all())
    torch.testing.assert_close(mine.distance, theirs.distance, rtol=0.03, atol=0.05)
    for start, goal, length in zip(starts, goals, mine.distance[0].tolist(), strict=True):
        corners = np.concatenate(([start], online.path(start, goal, 0)))
        assert length == pytest.approx(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum(), abs=0.06)


def test_more_goals_than_there_was_room_for_and_forgotten_ones(bank):
    online = OnlinePlanner(bank)
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


def test_without_a_floor_plan_paths_are_straight():
    online = OnlinePlanner(MapBank([]))
    ids = online.add_goals(-1, [(3.0, 4.0)])
    assert guided(online, np.zeros((1, 2)), ids).distance.item() == pytest.approx(5.0)


@pytest.mark.parametrize("plan", ["apartment.7", "office.7"])
def test_paths_of_people_who_walk_on_are_those_of_people_who_just_came(plan):
    bank = MapBank([load_plan(plan)])
    walked = OnlinePlanner(bank)
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
