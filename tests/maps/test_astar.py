"""The planner ``astar``: networkx' A* on the open cells is its oracle, and its lengths have a bound."""

import networkx as nx
import numpy as np
import pytest
import torch
from helpers.scenes import Watch

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import AStarPlanner, Planner
from pedzoo.maps.plans import load_plan
from pedzoo.metrics.closed_loop import measure
from pedzoo.policies.controller.controller import Controller
from pedzoo.sim.make import make_env

LONGEST = 1 / np.cos(np.pi / 8)
"""Of a path along eight directions and the straight line, where this goes between two of them: 1.0824."""


def drawn(seed: int) -> OccupancyGrid:
    cells = np.where(np.random.default_rng(seed).random((26, 30)) < 0.15, OCCUPIED, 0).astype(np.uint8)
    return OccupancyGrid(cells, 0.5, name=f"drawn {seed}")


PLANS = {"apartment.7": load_plan, "office.7": load_plan, "0": lambda at: drawn(int(at))}


def ends_of(planner: Planner, starts: int, goals: int) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers of open cells of the largest part of the map."""
    component = planner.graph(0).component
    main, rng = np.flatnonzero(component == np.bincount(component).argmax()), np.random.default_rng(0)
    return rng.choice(main, starts), rng.choice(main, goals)


def guided(planner: Planner, starts: np.ndarray, goals: np.ndarray) -> Guidance:
    """Guide people at cells (P,) to each of the goals (G,): (P, G, ...)."""
    xy = planner.graph(0).xy
    ids = planner.add_goals(0, xy[goals]).expand(len(starts), -1)
    points = torch.from_numpy(xy[starts]).float().unsqueeze(1).expand(-1, len(goals), -1)
    row, pose = torch.zeros(len(starts), dtype=torch.long), identity_pose(1).expand(len(starts), -1)
    return planner.guidance(points, ids, row, pose, torch.ones(ids.shape), 3.2, 1.0)


@pytest.mark.parametrize("name", PLANS)
def test_paths_are_those_of_networkx_little_over_the_shortest(name: str) -> None:
    bank = MapBank([PLANS[name](name)])
    planner = AStarPlanner(bank)
    graph = planner.graph(0)
    starts, goals = ends_of(planner, 60, 4)
    cells, metre = nx.Graph(), graph.grid.resolution
    number, (height, width) = graph.index.reshape(graph.shape), graph.shape
    for column, row in graph.place.tolist():
        for right, up in ((1, 0), (0, 1), (1, 1), (1, -1)):
            if not (0 <= column + right < width and 0 <= row + up < height):
                continue
            beside = (row + up, column + right), (row + up, column), (row, column + right)
            if min(number[at] for at in beside) >= 0:
                one, other = int(number[row, column]), int(number[row + up, column + right])
                cells.add_edge(one, other, weight=metre * np.hypot(right, up))

    def straight(one: int, other: int) -> float:
        return float(np.linalg.norm(graph.xy[one] - graph.xy[other]))

    length = guided(planner, starts, goals).distance
    shortest = guided(Planner(bank), starts, goals).distance
    assert (length < LONGEST * shortest + 1e-4).all() and (length > shortest - 1e-4).all()
    assert float((length / shortest.clamp_min(1e-6))[shortest > 1].max()) > 1.06  # the bound is nearly met
    for i, start in enumerate(starts[:12].tolist()):
        for k, goal in enumerate(goals.tolist()):
            expected = nx.astar_path_length(cells, start, goal, straight)
            assert float(length[i, k]) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("name", PLANS)
def test_collinear_steps_are_joined_and_stay_on_the_grid(name: str) -> None:
    """Waypoints lie on eight directions, no two segments go the same way, and they add up to the length."""
    planner = AStarPlanner(MapBank([PLANS[name](name)]))
    graph = planner.graph(0)
    starts, goals = ends_of(planner, 25, 3)
    lengths = guided(planner, starts, goals).distance
    for i, start in enumerate(starts):
        for k, goal in enumerate(goals):
            points = np.vstack((graph.xy[start], planner.path(graph.xy[start], graph.xy[goal], 0)))
            steps = np.rint(np.diff(graph.to_place(points), axis=0)).astype(int)
            straight = (steps == 0).any(1) | (abs(steps[:, 0]) == abs(steps[:, 1]))
            assert straight.all()
            turns = np.sign(steps)
            assert (turns[1:] != turns[:-1]).any(1).all()
            assert graph.sight.clear(graph.place[start][None], graph.place[start][None] + steps[:1]).all()
            length = np.linalg.norm(steps, axis=1).sum() * graph.grid.resolution
            assert length == pytest.approx(float(lengths[i, k]), abs=1e-3)


def test_compiled_and_torch_waypoints_lead_to_the_goal(monkeypatch) -> None:
    planner = AStarPlanner(MapBank([load_plan("apartment.7")]))
    starts, goals = ends_of(planner, 50, 3)
    seen = guided(planner, starts, goals)
    monkeypatch.setattr(planner, "compiled", False)
    torch.testing.assert_close(seen, guided(planner, starts, goals), atol=1e-4, rtol=0)
    row, ids = torch.zeros(1, dtype=torch.long), planner.add_goals(0, planner.graph(0).xy[goals[:1]])
    for _ in range(60):
        points = seen.waypoint[:, :1].reshape(1, -1, 2)
        speeds = torch.ones(points.shape[:2])
        seen = planner.guidance(points, ids.expand(speeds.shape), row, identity_pose(1), speeds, 3.2, 1.0)
        seen = Guidance(*(part[0].unsqueeze(1) for part in seen))
    torch.testing.assert_close(seen.waypoint, seen.goal_point)


def test_where_no_path_leads() -> None:
    cells = np.zeros((4, 5), np.uint8)
    cells[:, 2] = OCCUPIED
    planner = AStarPlanner(MapBank([OccupancyGrid(cells, 1.0, name="halves")]), clearance=0.5)
    ids = planner.add_goals(0, [(4.4, 0.7)])
    points = torch.tensor([[[0.5, 0.5], [3.5, 2.5]]])
    seen = planner.guidance(
        points, ids.expand(1, 2), torch.tensor([0]), identity_pose(1), torch.ones(1, 2), 2, 1
    )
    assert seen.distance[0, 0] == torch.inf and seen.waypoint[0, 0].tolist() == [0.5, 0.5]
    # one step along the diagonal and one down, to the goal itself
    assert seen.waypoint[0, 1].tolist() == [4.5, 1.5]
    assert float(seen.distance[0, 1]) == pytest.approx(2**0.5 + np.hypot(0.1, 0.8), abs=1e-5)


@pytest.mark.parametrize("physics", ["compiled", "torch"])
def test_people_of_an_environment_get_there(physics: str) -> None:
    scenario = "goals:map=apartment.0,people=3,goals=2,pool=8"
    walk, env = pedzoo.rollout("go_to_goal", scenario, physics, 4, planner="astar")
    assert env.prepared.planner.name == "astar"
    assert measure(walk)[0]["success"] > 0.9
    first = make_env(scenario, planner="astar", num_envs=4)
    second = make_env(first.prepared, num_envs=4)  # the other planner: prepared again
    assert (first.prepared.planner.name, second.prepared.planner.name) == ("astar", "shortest")
    assert (first.reset()["agents", "remaining_path"] >= second.reset()["agents", "remaining_path"]).all()


def test_people_of_a_controller_get_there() -> None:
    plan = load_plan("apartment.7")
    graph = Planner(MapBank([plan])).graph(0)
    starts, goals = ends_of(Planner(MapBank([plan])), 2, 2)
    controller = Controller(Watch(), plan, dt=0.4, planner="astar")
    place, asked = (
        {i: graph.xy[c] for i, c in enumerate(starts)},
        {i: graph.xy[c] for i, c in enumerate(goals)},
    )
    for _ in range(120):
        velocity = controller.step(place, asked)
        place = {i: place[i] + 0.4 * velocity[i] for i in place}
    assert all(np.linalg.norm(place[i] - asked[i]) < 0.3 for i in place)


def test_unknown_planners_are_refused() -> None:
    for call in (
        lambda: make_env("door", planner="a-star"),
        lambda: Controller(Watch(), "flat", planner="a-star"),
        lambda: pedzoo.evaluate(["orca"], ["door"], planner="a-star"),
    ):
        with pytest.raises(UserError, match=r"unknown planner 'a-star': did you mean 'astar'.*shortest"):
            call()
