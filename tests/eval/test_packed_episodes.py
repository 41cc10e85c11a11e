"""Episodes that results keep: what is read again is what was walked, in few bytes."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.episodes import unpacked_plan, unpacked_tracks
from helpers.walks import made

from pedzoo.core.geometry import move_to_map
from pedzoo.eval.evaluate import evaluate
from pedzoo.eval.packed_episodes import packed_episode, packed_episodes, packed_plan
from pedzoo.eval.rollout import rollout
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.rollout import Rollout


@pytest.fixture(scope="module")
def walked() -> tuple[Rollout, MapBank]:
    result, env = rollout("go_to_goal", "door", "compiled", 2)
    return result, env.bank


def test_positions_come_back_to_half_a_millimetre(walked: tuple[Rollout, MapBank]) -> None:
    result, bank = walked
    episodes, plans = packed_episodes(result, bank, 5, seed=3)
    assert [one["episode"] for one in episodes] == [0, 1] and {one["seed"] for one in episodes} == {3}
    path = move_to_map(result.path, result.pose)
    for number, packed in enumerate(json.loads(json.dumps(episodes))):
        assert packed["points"] == int(result.length[number])
        for person, track in zip(packed["people"], unpacked_tracks(packed), strict=True):
            first = person["first"]
            truth = path[number, person["slot"], first : first + len(track)].numpy()
            np.testing.assert_allclose(track, truth, atol=0.00051)
        x, y = move_to_map(result.goal, result.pose)[number, 0, 0].tolist()
        assert packed["people"][0]["goals"][0] == pytest.approx([0, x, y], abs=1e-3)
    grid = bank.grids[0]
    again = unpacked_plan(plans[str(grid.map_id)])
    assert (again.cells == grid.cells).all() and again.origin == pytest.approx(grid.origin)


def test_touches_are_runs_of_points(walked: tuple[Rollout, MapBank]) -> None:
    contact = torch.zeros_like(walked[0].agent_contact)
    contact[0, 1, [4, 5, 9]] = True  # the points of `path` are one later
    packed = packed_episode(replace(walked[0], agent_contact=contact), 0)
    assert [person["touch"] for person in packed["people"]] == [[], [[5, 6], [10, 10]]]
    assert packed["values"]["agent_contacts"] == 2


def test_fifty_people_for_a_minute_take_less_than_100_kb() -> None:
    people, points = 50, 600
    torch.manual_seed(0)
    turns = 0.1 * torch.randn(1, people, points + 1).cumsum(2)
    crowd = made((0.13 * torch.stack((turns.cos(), turns.sin()), -1)).cumsum(2))
    packed = packed_episode(crowd, 0)
    assert len(packed["people"]) == people and packed["counts"] == [points + 1] * people
    assert len(json.dumps(packed)) < 100_000
    expected = move_to_map(crowd.path, crowd.pose)[0, 7]
    np.testing.assert_allclose(unpacked_tracks(packed)[7], expected, atol=6e-4)


def test_large_plans_are_kept_in_coarser_cells() -> None:
    cells = np.zeros((1300, 20), dtype=np.uint8)
    cells[650] = 1
    packed = packed_plan(OccupancyGrid(cells, 0.05))
    assert packed["rows"] == 434 and packed["cell"] == pytest.approx(0.15)
    assert (unpacked_plan(packed).cells == 1).any(1).sum() == 1


def test_evaluations_keep_what_is_asked_for() -> None:
    given = {"suites": ["door"], "episodes": 2, "physics": "compiled"}
    report = evaluate(["go_to_goal"], keep_episodes=1, **given)
    (row,) = report["rows"]
    assert len(row["episodes"]) == 1 and row["episodes"][0]["plan"] in report["plans"] and "plans" not in row
    assert "plans" not in evaluate(["go_to_goal"], **given)
