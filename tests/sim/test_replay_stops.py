"""Replay with stops: people who replace recorded ones stand where those stood, for as long, and go on."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from pedzoo.core.errors import UserError
from pedzoo.data.tracks import Tracks
from pedzoo.eval.rollout import rollout
from pedzoo.maps.formats import write_ros
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.policies.walker import stay_in_place
from pedzoo.sim.recorded_people import Stops, stops_of
from pedzoo.sim.robots.env import make_robot_env
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay, Replay

GRID = np.full((80, 120), FREE, dtype=np.uint8)
GRID[:, 80:100] = OCCUPIED

WAITER, WALKER, IN_WALL, EARLY = 1, 2, 3, 4


def walk(agent: int, start: tuple[float, float], moves: list[tuple[int, float, float]]) -> list[tuple]:
    """Return rows (frame, agent, x, y) of a person who makes each move (steps, x, y) for so many frames."""
    steps = [(x, y) for count, x, y in moves for _ in range(count)]
    places = np.vstack((start, steps)).cumsum(0)
    return [(frame, agent, *place) for frame, place in enumerate(places)]


ROWS = [
    # walks, stands at (4.6, 1) for 15 steps, walks, stands too shortly at (7.0, 1), walks down
    *walk(WAITER, (1.0, 1.0), [(12, 0.3, 0), (15, 0, 0), (8, 0.3, 0), (4, 0, 0), (12, 0, 0.3)]),
    *walk(WALKER, (1.0, 6.0), [(20, 0.3, 0)]),
    # stands where the floor plan has a wall, 1 m deep
    *walk(IN_WALL, (5.0, 3.0), [(13, 0.3, 0), (15, 0, 0), (12, -0.3, 0)]),
    # stands before being taken over, not after
    *walk(EARLY, (1.0, 4.5), [(7, 0, 0.01), (12, 0.3, 0)]),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stops")
    write_ros(OccupancyGrid(GRID, 0.1, name="rooms"), path / "rooms.yaml")
    rows = sorted(ROWS)
    (path / "first.txt").write_text("".join(f"{f} {a} {x:.4f} {y:.4f}\n" for f, a, x, y in rows))
    return path


def replay(folder: Path, stops: bool = True) -> PreparedReplay:
    made = Replay(files=[str(folder / "first.txt")], dt=0.4, map=str(folder / "rooms.yaml"), stops=stops)
    return made.prepare(0.25)


def person(scenario: PreparedReplay, agent: int) -> int:
    return int((scenario.persons.agent == agent).nonzero()[0, 0])


def test_stops_by_hand() -> None:
    rows = np.array(ROWS)
    begin = np.array([int((rows[:, 1] == agent).argmax()) for agent in (WAITER, WALKER, IN_WALL, EARLY)])
    tracks = Tracks("made", rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2:])
    stops = stops_of(tracks, begin, begin + 7)
    assert stops.pause.shape == (4, 1)
    # rows 12 to 27 are at (4.6, 1); the mean of three rows is there from 13 to 26, still from 14 on
    assert stops.place[0, 0].tolist() == pytest.approx([4.6, 1.0])
    assert float(stops.pause[0, 0]) == pytest.approx(13 * 0.4)
    assert stops.pause[1:, 0].tolist() == [0.0, pytest.approx(13 * 0.4), 0.0]


def test_stops_that_are_left_out_leave_no_gap() -> None:
    place = torch.arange(12.0).view(2, 3, 2)
    stops = Stops(place, torch.tensor([[1.0, 2.0, 3.0], [4.0, 0, 0]]), torch.tensor([[5, 6, 7], [8, -1, -1]]))
    some = stops.only(torch.tensor([[False, True, True], [True, False, False]]))
    assert some.pause.tolist() == [[2, 3], [4, 0]]
    assert some.place.tolist() == [[[2, 3], [4, 5]], [[6, 7], [0, 0]]]
    assert some.goals(torch.tensor([1, 2])).tolist() == [[6, 7, 1, -1], [8, 2, -1, -1]]
    assert Stops.joined([some, Stops.none(1)]).goals(torch.tensor([1, 2, 3])).tolist()[2] == [3, -1, -1, -1]


def test_goals_and_ways_lead_over_the_stops(folder: Path) -> None:
    scenario = replay(folder)
    people, waiter = scenario.persons, person(scenario, WAITER)
    assert people.stops.place[waiter].tolist() == [pytest.approx([4.6, 1.0])]
    assert float(people.path_length[waiter]) == pytest.approx(4.6 - 3.1 + np.hypot(2.4, 3.6), abs=0.1)
    # no path leads to a stop in a wall: that person goes to the exit
    in_wall = person(scenario, IN_WALL)
    assert float(people.stops.pause[in_wall].sum()) == 0
    assert float(people.path_length[in_wall]) == pytest.approx(
        float(replay(folder, stops=False).persons.path_length[in_wall])
    )


@pytest.mark.parametrize("policy", ["go_to_goal", "orca:radius=0.3", "social_walker.styled"])
def test_people_stand_at_their_stop_and_go_on(folder: Path, policy: str) -> None:
    scenario = replay(folder)
    result, _ = rollout(policy, scenario, "compiled", scenario.scenes)  # type: ignore[arg-type]
    path, speed = way(result, person(scenario, WAITER))
    stands = (speed < 0.25).nonzero()[:, 0]  # learned people come the last decimetres step by step
    place = path[stands]
    # 5.2 s, less the first and the last step, in which they come and go
    assert 0.1 * len(stands) == pytest.approx(5.2, abs=0.9)
    assert float((place - torch.tensor([4.6, 1.0])).norm(dim=1).median()) < 0.1
    assert float((path[-1] - torch.tensor([7.0, 4.6])).norm()) < 0.31
    without, _ = rollout(policy, replay(folder, stops=False), "compiled", 1)  # type: ignore[arg-type]
    _, speed = way(without, person(scenario, WAITER))
    assert int((speed < 0.1).sum()) < 5


def way(result: Rollout, number: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return where a person was while a policy moved it (T, 2), and its speed from there on (T - 1,)."""
    mine = (result.person == number) & result.controlled
    assert int(mine.any(2).sum()) == 1
    path = result.trace[mine]
    return path, path.diff(dim=0).norm(dim=1) / 0.1


def test_a_scene_without_stops_is_as_before(folder: Path, tmp_path: Path) -> None:
    rows = [row for row in sorted(ROWS) if row[1] == WALKER]
    file = tmp_path / "walker.txt"
    file.write_text("".join(f"{f} {a} {x:.4f} {y:.4f}\n" for f, a, x, y in rows))
    scenes: list[Any] = [
        Replay(files=[str(file)], dt=0.4, stops=stops).prepare(0.25) for stops in (False, True)
    ]
    without, stops = (rollout("go_to_goal", scene, "compiled", 1)[0] for scene in scenes)
    assert torch.equal(without.trace, stops.trace)


def test_waiting_people_go_to_their_place_and_others_by_the_model() -> None:
    desired = torch.tensor([[[1.3, 0.0], [0.0, 0.65], [0.0, 0.0]]])
    batch = TensorDict(
        {"agents": {"desired_velocity": desired, "pref_speed": torch.full((1, 3, 1), 1.3)}}, [1]
    )
    step = torch.tensor([[[0.1, 0.2], [0.4, 0.0], [0.3, 0.3]]])
    # half of the usual speed: half of the model's step and half of what leads to the place
    assert stay_in_place(batch, step)[0].tolist() == [
        pytest.approx([0.1, 0.2]), pytest.approx([0.2, 0.13]), [0, 0]
    ]  # fmt: skip
    without = TensorDict({"agents": {"pref_speed": torch.ones(1, 3, 1)}}, [1])
    assert torch.equal(stay_in_place(without, step), step)


def test_robots_are_refused(folder: Path) -> None:
    name = f"replay:files={folder / 'first.txt'},dt=0.4,stops=true"
    with pytest.raises(UserError, match=r"stops=true: expected one robot .* stops=false"):
        make_robot_env(name)
