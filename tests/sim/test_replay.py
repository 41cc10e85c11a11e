"""Replay: recorded people come, are taken over, stop and leave when they should, under any policy."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import step_mdp

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.data.tracks import Tracks
from pedzoo.eval.realism import replay_row
from pedzoo.eval.rollout import rollout
from pedzoo.eval.rollout import run as walk_all
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import write_ros
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from pedzoo.maps.planning.planner import Planner
from pedzoo.metrics.realism.crowds import crowd
from pedzoo.metrics.realism.features import every_step, surroundings
from pedzoo.policies.load import load_policy
from pedzoo.policies.rule_based.go_to_goal import GoToGoal
from pedzoo.policies.walker import Walker, stay_in_place
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.recorded_people import REASONS, stops_of
from pedzoo.sim.robots.env import make_robot_env
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay, Replay
from pedzoo.sim.script import occupants_of

# a room of 12 m x 8 m with a wall from x = 8 to 10 that leaves a room of 2 m x 8 m behind it
SIDE = 0.1
GRID = np.full((80, 120), FREE, dtype=np.uint8)
GRID[:, 80:100] = OCCUPIED

ALICE, SHORT, STANDS, DEEP, EDGE, BEHIND, LATE = 1, 2, 3, 4, 5, 6, 7
WAITER, WALKER, IN_WALL, EARLY = 1, 2, 3, 4

Rows = list[tuple[float, ...]]


def straight(agent: int, first: int, count: int, start: tuple, step: tuple) -> Rows:
    """Return rows (frame, agent, x, y) of a person who walks ``step`` metres per frame."""
    return [(first + i, agent, start[0] + i * step[0], start[1] + i * step[1]) for i in range(count)]


def turning(agent: int, start: tuple[float, float], moves: list[tuple[int, float, float]]) -> Rows:
    """Return rows of a person who makes each move (steps, x, y) for so many frames."""
    steps = [(x, y) for count, x, y in moves for _ in range(count)]
    return [(i, agent, *place) for i, place in enumerate(np.vstack((start, steps)).cumsum(0))]


ROWS = [
    *straight(ALICE, 0, 17, (1.0, 1.0), (0.3, 0.0)),  # leaves at (5.8, 1)
    *straight(SHORT, 2, 8, (1.0, 2.0), (0.4, 0.0)),
    *straight(STANDS, 3, 20, (2.0, 6.0), (0.01, 0.0)),  # 0.12 m in the last 12 steps
    *straight(DEEP, 4, 21, (3.0, 3.0), (0.3, 0.0)),  # leaves at (9, 3): a metre inside the wall
    *straight(EDGE, 5, 21, (2.1, 4.0), (0.3, 0.0)),  # leaves at (8.1, 4): 0.1 m inside it
    *straight(BEHIND, 6, 21, (1.0, 5.0), (0.5, 0.0)),  # leaves at (11, 5): no way leads there
    *straight(LATE, 40, 15, (1.0, 1.5), (0.0, 0.2)),  # comes when all others are gone
]
STOPS = [
    # walks, stands at (4.6, 1) for 15 steps, walks, stands too shortly at (7.0, 1), walks down
    *turning(WAITER, (1.0, 1.0), [(12, 0.3, 0), (15, 0, 0), (8, 0.3, 0), (4, 0, 0), (12, 0, 0.3)]),
    *turning(WALKER, (1.0, 6.0), [(20, 0.3, 0)]),
    # stands where the floor plan has a wall, 1 m deep, and then before it
    *turning(IN_WALL, (5.0, 3.0), [(13, 0.3, 0), (15, 0, 0), (12, -0.3, 0), (15, 0, 0), (9, -0.2, 0)]),
    # stands before being taken over, not after
    *turning(EARLY, (1.0, 4.5), [(7, 0, 0.01), (12, 0.3, 0)]),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with a recording, another one and their floor plan."""
    path = tmp_path_factory.mktemp("recordings")
    write_ros(OccupancyGrid(GRID, SIDE, name="rooms"), path / "rooms.yaml")
    save(path / "first.txt", ROWS)
    save(path / "stops.txt", sorted(STOPS))
    save(path / "second.txt", [(f, a + 10, x, 8 - y) for f, a, x, y in ROWS if a in (ALICE, SHORT, LATE)])
    return path


def save(path: Path, rows: Rows) -> None:
    path.write_text("".join(f"{f} {a} {x:.4f} {y:.4f}\n" for f, a, x, y in rows))


def replay(folder: Path, files: str = "first", **settings: Any) -> PreparedReplay:
    """Return the prepared scenario of recordings in ``folder``."""
    names = [str(folder / f"{name}.txt") for name in files.split()]
    return Replay(files=names, dt=0.4, map=str(folder / "rooms.yaml"), **settings).prepare(0.25)


@pytest.fixture(scope="module")
def plaza() -> PreparedReplay:
    """Return the prepared replay of the recording that ships."""
    return Replay().prepare(0.25)


class Stands(GoToGoal):
    """Stays where it is."""

    def forward(self, tensordict: Any) -> Any:
        tensordict["agents", "action"] = torch.zeros_like(tensordict["agents", "velocity"])
        return tensordict


class Drunk(GoToGoal):
    """Walks anywhere, and gives no number for people whom it does not move; for all after ``breaks`` s."""

    breaks = torch.inf

    def forward(self, tensordict: Any) -> Any:
        agents = tensordict["agents"]
        angle = 9 * tensordict["time"] + agents["id"]
        action = 1.5 * torch.stack((angle.cos(), angle.sin()), dim=-1)
        sober = agents["controlled"] & (tensordict["time"] < self.breaks)
        tensordict["agents", "action"] = torch.where(sober.unsqueeze(2), action, torch.nan)
        return tensordict


class Truth(GoToGoal):
    """Walks people as they really did."""

    def __init__(self, env: PedestrianEnv) -> None:
        super().__init__(env.decision_dt)
        self.env = env

    def forward(self, tensordict: Any) -> Any:
        script: Any = self.env.prepared.script
        state = self.env.state
        there = script.playback(state, state.failed, round(self.decision_dt / 0.1), 1)[:, :, -1, 0]
        tensordict["agents", "action"] = (there - state.position) / self.decision_dt
        return tensordict


def walked(env: PedestrianEnv, policy: Any) -> list[dict[str, Tensor]]:
    """Return the observations from the reset to the end of the first scene, with every person's trace."""
    now, results, done = env.reset(), [], False
    while not done:
        agents: Any = now["agents"]
        keys = ("id", "mask", "controlled", "valid", "history", "pref_speed", "velocity")
        results.append({key: agents[key][0] for key in keys})
        result = env.step(policy(now))
        results[-1]["trace"] = result["next", "agents", "info", "trace"][0]
        done, now = bool(result["next", "done"][0]), step_mdp(result)
        results[-1]["over"] = now["agents", "controlled"][0]
    return results


def at(track: Rows, agent: int, frame: np.ndarray) -> np.ndarray:
    """Return where a person is at (fractions of) frames (T,): (T, 2)."""
    rows = np.array([row for row in track if row[1] == agent])
    return np.column_stack([np.interp(frame, rows[:, 0], rows[:, axis]) for axis in (2, 3)])


def person(scenario: PreparedReplay, agent: int) -> int:
    return int((scenario.persons.agent == agent).nonzero()[0, 0])


def times(result: Rollout, who: Tensor, number: int) -> list[int]:
    """Return the first and the last trace point, counted from 1, at which a person is marked in ``who``."""
    points = ((result.person == number) & who).any(1).any(0).nonzero()[:, 0] + 1
    return [int(points[0]), int(points[-1])] if len(points) else []


# The people


def test_who_is_simulated_and_why_others_are_not(folder: Path) -> None:
    people = replay(folder).persons
    reasons = dict(zip(people.agent.tolist(), (REASONS[what] for what in people.what.tolist()), strict=True))
    assert reasons == {
        ALICE: "controlled",
        SHORT: "too short",
        STANDS: "already at the exit",
        DEEP: "exit in a wall",
        EDGE: "controlled",
        BEHIND: "no path to the exit",
        LATE: "controlled",
    }
    assert people.counts == dict.fromkeys(reasons.values(), 1) | {"controlled": 3}
    without = Replay(files=[str(folder / "first.txt")], dt=0.4).prepare(0.25)
    assert without.persons.counts == {"controlled": 5, "too short": 1, "already at the exit": 1}
    result, _ = rollout("go_to_goal", without, "compiled", without.scenes)
    assert len(result.person[result.controlled & (result.reached > 0)].unique()) == 5


def test_starts_goals_ways_and_times(folder: Path) -> None:
    scenario = replay(folder)
    people, alice, edge = scenario.persons, person(scenario, ALICE), person(scenario, EDGE)
    # 8 steps are frames 0 to 7; the last of 17 is frame 16
    assert (int(people.handover[alice]), int(people.last[alice])) == (7, 16)
    assert people.start[alice].tolist() == pytest.approx([1 + 7 * 0.3, 1])
    assert people.exit[alice].tolist() == people.goal[alice].tolist() == pytest.approx([5.8, 1])
    assert float(people.path_length[alice]) == pytest.approx(5.8 - 3.1, abs=0.05)
    assert float(people.pref_speed[alice]) == pytest.approx(0.3 / 0.4)
    # (8.1, 4) is not in an open cell: the nearest one's centre is 0.25 m or more from the wall at x = 8
    assert people.exit[edge].tolist() == pytest.approx([8.1, 4])
    assert people.goal[edge].tolist() == pytest.approx([7.75, 4], abs=0.101)
    assert float(people.goal[edge, 0]) <= 7.75 + 1e-6
    # a person who stands likes 0.3 m/s all the same
    assert float(people.pref_speed[person(scenario, STANDS)]) == pytest.approx(0.3)


def test_the_speed_of_the_whole_track(folder: Path) -> None:
    save(folder / "one.txt", [(i, 1, 1 + 0.2 * i + 0.3 * max(0, i - 7), 1.0) for i in range(15)])
    assert float(replay(folder, "one").persons.pref_speed[0]) == pytest.approx(0.5)
    # 14 steps of 0.2 m and 7 times 0.3 m more in 5.6 s
    assert float(replay(folder, "one", speed="track").persons.pref_speed[0]) == pytest.approx(4.9 / 5.6)


def test_a_share_of_the_time(folder: Path) -> None:
    scenario = replay(folder, share=0.5)
    assert scenario.persons.what[person(scenario, LATE)] == REASONS.index("later")
    assert scenario.scenes == scenario.persons.counts["later"] == 1  # nobody in the second half


def test_a_hole_in_a_track_makes_two_people(folder: Path) -> None:
    save(
        folder / "hole.txt",
        [row for row in straight(1, 0, 32, (1.0, 1.0), (0.1, 0.0)) if not 12 <= row[0] < 20],
    )
    people = replay(folder, "hole").persons
    assert people.counts == {"controlled": 2} and people.first.tolist() == [0, 20]


# When they come, are taken over and go


@pytest.mark.parametrize("dt", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("policy", [Stands, Drunk])
def test_all_come_and_go_on_time_with_any_policy(folder: Path, dt: float, policy: type) -> None:
    scenario = replay(folder)
    seen = walked(make_env(scenario, num_envs=1, decision_dt=dt), policy(dt))
    # the clock is 0 in frame 7; alice is taken over there, and has twice the 9 frames until frame 16
    spans = {
        ALICE: (0, 2 * 9 * 0.4),
        EDGE: ((12 - 7) * 0.4, (12 - 7 + 2 * 13) * 0.4),
        **{
            agent: (torch.inf, (last - 7) * 0.4)
            for agent, last in ((SHORT, 9), (STANDS, 22), (DEEP, 24), (BEHIND, 26))
        },
    }
    for agent, (taken, goes) in spans.items():
        number = person(scenario, agent)
        for i, now in enumerate(seen):
            clock = i * dt
            mine = (now["id"] == number) & now["mask"]
            due = clock < goes - 1e-6
            if policy is Stands or taken == torch.inf:  # people without a policy never arrive
                assert bool(mine.any()) == due, (agent, clock)
            expected = due and clock > taken - 1e-6
            if policy is Stands or not expected:
                assert bool((mine & now["controlled"]).any()) == expected, (agent, clock)
    assert len(seen) * dt == pytest.approx((12 - 7 + 2 * 13) * 0.4) or policy is Drunk


def test_people_are_played_back_exactly(folder: Path) -> None:
    """To the last bit of float32 at frames, and on straight lines between them, whatever others do."""
    scenario = replay(folder)
    for dt in (0.1, 0.4):
        result = run(scenario, Drunk(dt), dt)
        met = 0
        for agent in (SHORT, STANDS, DEEP, EDGE, BEHIND):
            number = person(scenario, agent)
            mine = (result.person == number) & result.present & ~result.controlled
            slot = int(mine[0].any(1).nonzero()[0, 0])
            points = mine[0, slot].nonzero()[:, 0]
            expected = at(ROWS, agent, 7 + (points.numpy() + 1) / 4)
            there = result.trace[0, slot, points]
            assert np.abs(there.numpy() - expected).max() < 1e-6
            at_frames = (points + 1) % 4 == 0
            assert torch.equal(there[at_frames], torch.from_numpy(expected).float()[at_frames])
            met += len(points)
        # 2, 15, 17, 5 and 19 frames of 4 trace points
        assert met == 4 * (2 + 15 + 17 + 5 + 19)


def run(scenario: PreparedReplay, policy: Any, dt: float = 0.4, episodes: int = 1) -> Rollout:
    """Return what a policy did."""
    env = make_env(scenario, num_envs=episodes, decision_dt=dt)
    policy = policy(env) if isinstance(policy, type) else policy
    with torch.no_grad():
        return walk_all(policy, env)


def test_newcomers_are_known_as_far_as_they_were_seen(folder: Path) -> None:
    scenario = replay(folder)
    seen = walked(make_env(scenario), Stands())
    number = person(scenario, EDGE)  # comes in frame 5, two frames before the clock is 0
    slot = int((seen[0]["id"] == number).nonzero()[0, 0])
    for i in range(8):
        assert seen[i]["valid"][slot].tolist() == [k >= max(0, 5 - i) for k in range(8)]
        if i <= 5:  # until it is taken over
            expected = at(ROWS, EDGE, np.clip(np.arange(i, i + 8), 5, None))
            assert np.abs(seen[i]["history"][slot].numpy() - expected).max() < 1e-5
    assert seen[0]["valid"][int((seen[0]["id"] == person(scenario, ALICE)).nonzero()[0, 0])].all()
    # who comes is on the way already
    rows = straight(1, 0, 20, (1.0, 1.0), (0.3, 0.0)) + straight(2, 12, 20, (1.0, 2.0), (0.0, 0.2))
    save(folder / "two.txt", rows)
    now = walked(make_env(replay(folder, "two")), Stands())[5]  # frame 12
    slot = int((now["id"] == 1).nonzero()[0, 0])
    assert now["velocity"][slot].tolist() == pytest.approx([0, 0.5], abs=1e-6)
    assert now["valid"][slot].tolist() == [False] * 7 + [True]
    assert now["history"][slot].tolist() == [pytest.approx([1, 2])] * 8


def test_the_truth_arrives_with_all_people(folder: Path) -> None:
    for dt in (0.1, 0.4):
        scenario = replay(folder, "first second")
        result = run(scenario, Truth, dt, scenario.scenes)
        real = scenario.real()
        arrived = result.person[result.controlled & (result.reached > 0)].unique()
        simulated = scenario.persons.controlled.nonzero()[:, 0]
        assert torch.equal(arrived, simulated)
        both = result.controlled & real.controlled[..., : result.trace.shape[2]]
        assert torch.equal(result.person[both], real.person[..., : both.shape[2]][both])
        apart = (result.trace - real.trace[:, :, : both.shape[2]]).norm(dim=-1)
        assert float(apart[both].max()) < 1e-3
        # real people are scored for as long as those who walk alike, to the same 0.1 s
        assert torch.equal(result.underway, real.controlled[..., : both.shape[2]])
        assert torch.equal(result.underway, real.underway[..., : both.shape[2]])
        assert int(real.controlled.sum()) == int(result.underway.sum()) > 0
        steps, true = every_step(result), every_step(real)
        both = (result, steps), (real, true)
        length = min(steps.scored.shape[2], true.scored.shape[2])
        assert torch.equal(steps.scored[..., :length], true.scored[..., :length])
        assert int(steps.scored.sum()) == int(true.scored.sum()) > 0
        results, expected = (replay_row("", r, scenario, dt)["metrics"] for r in (result, real))
        assert results == pytest.approx(expected, abs=2e-3)
        assert expected["realism"] == expected["closed_loop_ade_m"] == 0.0 and expected["success"] == 1.0
        lines = scenario.persons.start, scenario.persons.goal
        minutes = [crowd(r, s, surroundings(s), 0, scenario.scenes, *lines).minutes for r, s in both]
        assert torch.equal(*minutes)


@pytest.mark.parametrize("simulated", ["all", "one"])
def test_real_is_the_recording(folder: Path, simulated: Any) -> None:
    scenario = replay(folder, "first second", simulated=simulated)
    real, people, scenes = scenario.real(), scenario.persons, scenario.script.scenes
    for scene in (scenes.table == 0).nonzero()[:, 0].tolist():
        origin, there = int(scenes.origin[scene]), real.present[scene]
        for slot, point in there[:, 3::4].nonzero().tolist():
            agent = int(people.agent[real.person[scene, slot, 4 * point + 3]])
            expected = at(ROWS, agent, np.array([origin + point + 1]))
            assert np.abs(real.trace[scene, slot, 4 * point + 3].numpy() - expected).max() < 1e-5
    for number in people.controlled.nonzero()[:, 0].tolist():
        scene = int((real.controlled & (real.person == number)).any(-1).any(-1).nonzero()[0, 0])
        begun = 0.4 * int(scenes.origin[scene])
        first, last = times(real, real.controlled, number)
        assert begun + 0.1 * (first - 1) == pytest.approx(0.4 * float(people.handover[number]))
        _, gone = times(real, real.present, number)
        assert begun + 0.1 * gone == pytest.approx(0.4 * float(people.last[number]))
        mine = real.controlled[scene] & (real.person[scene] == number)
        away = (real.trace[scene][mine] - people.goal[number]).norm(dim=-1)
        assert away[:-1].min() > 0.3 - 1e-5 and (away[-1] < 0.3 + 1e-5 or last == gone)
        assert real.reached[scene][mine].tolist() == [0] * (len(away) - 1) + [1]
    assert not real.controlled[~real.present].any()
    assert torch.equal(real.person[real.controlled].unique(), people.controlled.nonzero()[:, 0])


# Slots and scenes


def test_slots_are_never_shared(plaza: PreparedReplay) -> None:
    begin, end = torch.tensor([0, 3, 5, 5, 9, 9]), torch.tensor([5, 9, 6, 5, 12, 10])
    assert occupants_of(0 * begin, begin, end)[0].tolist() == [
        [0, 0, 0, 0, 0, 2, -1, -1, -1, 4, 4, 4, -1],
        [-1, -1, -1, 1, 1, 1, 1, 1, 1, 5, -1, -1, -1],
    ]
    people, (who,) = plaza.persons, plaza.script.occupants
    for number in range(len(people.agent)):
        slot, frames = (who == number).nonzero(as_tuple=True)
        assert len(slot.unique()) == 1
        assert torch.equal(frames, torch.arange(int(people.first[number]), int(people.removal[number])))
    frames = torch.arange(who.shape[1])
    there = ((people.first[:, None] <= frames) & (frames < people.removal[:, None])).sum(0)
    assert torch.equal((who >= 0).sum(0), there) and int(there.max()) == plaza.people  # no fewer would do


def test_recordings_are_cut_where_no_person_can_be_left(folder: Path) -> None:
    scenes = replay(folder, "first second").script.scenes
    # alice and others, the late one (frame 40 and later), and both again in the second recording
    assert scenes.origin.tolist() == [7, 47, 7, 47] and scenes.table.tolist() == [0, 0, 1, 1]


def test_one_person_among_others_who_are_played_back(folder: Path) -> None:
    one = replay(folder, "first second", simulated="one")
    assert one.scenes == 5
    result, scored = run(one, Drunk(), 0.4, 5), []
    for person, controlled, present in zip(result.person, result.controlled, result.present, strict=True):
        scored += (mine := person[controlled].unique().tolist())
        others = person[present & ~controlled].unique().tolist()
        assert len(mine) == 1 and mine[0] not in others
    assert sorted(scored) == one.persons.controlled.nonzero()[:, 0].tolist()


def test_others_around_one_person_are_taken_over_in_their_frame(folder: Path) -> None:
    one, around = (replay(folder, "first second", simulated=which) for which in ("one", "around"))
    assert around.scenes == one.scenes == 5
    people, result, alone = around.persons, run(around, GoToGoal(), 0.4, 5), run(one, GoToGoal(), 0.4, 5)
    reacting = []
    for scene in range(5):
        origin, lead = (int(part[scene]) for part in (around.script.scenes.origin, around.script.scenes.lead))
        assert alone.person[scene][alone.controlled[scene]].unique().tolist() == [lead]
        who, moved = result.person[scene], result.controlled[scene]
        for number in set(who[moved].tolist()) - {lead}:
            first = int(((who == number) & moved).any(0).nonzero()[0])
            # a policy takes a person over in a frame of 0.4 s; who was taken before the scene is so at once
            assert first == max(4 * (int(people.handover[number]) - origin), 0)
            reacting.append(number)
    assert len(reacting) >= 2 and people.controlled[torch.tensor(reacting)].all()


def test_stays_are_people_and_not_slots(folder: Path) -> None:
    scenario = replay(folder)
    real = scenario.real()
    for slot, first, last in real.stays(0):
        (number,) = real.person[0, slot, max(first - 1, 0) : last].unique().tolist()
        came, left = int(scenario.persons.first[number]), int(scenario.persons.last[number])
        # the clock is 0 in frame 7; later people have the first trace point 0.1 s after that
        assert first == (4 * (came - 7) + 1 if came > 7 else 0)
        assert last == 4 * (min(left, 25) - 7)  # no person who is simulated is left after frame 25
    assert len(real.stays(0)) == 6
    door, _ = rollout("go_to_goal", "door:people=4", "compiled", 1)
    assert [stay[0] for stay in door.stays(0)] == [0, 1, 2, 3]


def test_what_another_scenario_has_prepared_serves_as_well(folder: Path) -> None:
    every, one = replay(folder), replay(folder, simulated="one")
    names = [str(folder / "first.txt")]
    settings = Replay(files=names, dt=0.4, map=str(folder / "rooms.yaml"), simulated="one")
    again = settings.adapted(every)
    assert isinstance(again, PreparedReplay) and again.planner is every.planner
    assert torch.equal(run(again, GoToGoal()).trace, run(one, GoToGoal()).trace)
    assert every.scenes != again.scenes and Replay().adapted(every) is None


# The environment


def test_partial_resets_and_auto_reset(folder: Path) -> None:
    scenario, policy = replay(folder, "first second"), GoToGoal()
    env = make_env(scenario, num_envs=3)
    now = env.reset()
    for _ in range(3):
        result = env.step(policy(now))
        now = step_mdp(result)
    before = env.state
    env.reset(result["next"].clone().set("_reset", torch.tensor([[False], [True], [False]])))
    after = env.state
    assert after.scene.tolist() == [0, 0, 2]  # scene 4 of the seed is the first again
    assert after.clock.tolist() == pytest.approx([1.2, 0, 1.2])
    for key in ("past", "person", "controlled", "observed_points"):
        assert torch.equal(getattr(after, key)[[0, 2]], getattr(before, key)[[0, 2]])
    long = make_env(scenario, num_envs=3).rollout(120, policy, break_when_any_done=False)
    for row, keys in enumerate(long["scene_key"][..., 0].tolist()):
        mine = list(dict.fromkeys(keys))
        assert mine == Draws.for_episodes(0, torch.arange(len(mine)) * 3 + row).key.tolist() and len(mine) > 2


def test_a_replay_begins_as_it_was_recorded(folder: Path) -> None:
    scenario = replay(folder)
    histories = [make_env(scenario, warm_start=w).reset()["agents", "history"] for w in ("orca", "static")]
    assert torch.equal(*histories)


def test_only_the_actions_of_the_controlled_matter(folder: Path) -> None:
    scenario, policy = replay(folder), Drunk()
    assert not run(scenario, policy).failed.any()
    policy.breaks = 1.5
    with pytest.warns(UserWarning, match=f"agent {person(scenario, ALICE)} of scene 0"):
        assert run(scenario, policy).failed.all()


def test_noise_is_drawn_by_the_person(plaza: PreparedReplay) -> None:
    env = make_env(plaza)
    now: Any = env.reset()
    swapped = now.clone()
    ids = swapped["agents", "id"][0]
    first, second = now["agents", "mask"][0].nonzero()[:2, 0].tolist()
    ids[[first, second]] = ids[[second, first]]
    walker = load_policy("sgan_goal.zara1")
    assert isinstance(walker, Walker)
    noise, other = walker.noise_of(now), walker.noise_of(swapped)
    assert noise is not None and other is not None
    assert torch.equal(noise[0, [second, first]], other[0, [first, second]])
    assert not torch.equal(noise[0, first], other[0, first])


def test_rewards_are_the_way_that_got_shorter(folder: Path) -> None:
    env = make_env(replay(folder))
    policy, now, total = GoToGoal(), env.reset(), 0.0
    slot = int((now["agents", "id"][0] == 0).nonzero()[0, 0])
    way, length = float(env.state.remaining_path[0, slot]), 0.0
    while bool(env.state.controlled[0, slot]):
        result = env.step(policy(now))
        touched = result["next", "agents", "info", "agent_contact"][0, slot].any()
        total += float(result["next", "agents", "reward"][0, slot, 0]) + float(touched)
        length, now = float(env.state.planned[0, slot]), step_mdp(result)
        assert (result["next", "agents", "reward"][0, :, 0][~env.state.controlled[0]][1:] <= 0).all()
    assert total == pytest.approx(way, abs=1e-4)
    assert length == pytest.approx(way - 0.3, abs=1e-4)


# Bad input


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (partial(Replay, **{"simulated": "ome"}), "did you mean 'one'"),
        (partial(Replay, **{"speed": "trak"}), "did you mean 'track'"),
        (partial(Replay, share=0), "share 0: expected a part of the time"),
        (partial(Replay, map="flat"), "the fold 'embedded' has its own"),
        (partial(make_env, "replay:fold=zara11"), "did you mean 'zara1'"),
        (partial(make_robot_env, "replay:stops=true"), r"stops=true: expected one robot .* stops=false"),
    ],
)
def test_settings_that_cannot_be(make: Any, message: str) -> None:
    with pytest.raises(UserError, match=message):
        make()


def test_a_recording_without_people_to_simulate(folder: Path) -> None:
    save(folder / "short.txt", straight(1, 0, 8, (1.0, 1.0), (0.3, 0.0)))
    with pytest.raises(UserError, match=r"no person in 'files' can be simulated: \{'too short': 1\}"):
        replay(folder, "short")


# Stops


def test_stops_by_hand() -> None:
    rows = np.array(STOPS)
    who, place, pause = stops_of(Tracks("made", rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2:]))
    assert who.tolist() == [0, 2, 2]
    # rows 12 to 27 are at (4.6, 1); the mean of three rows is there from 13 to 26, still from 14 on
    assert place.tolist() == [pytest.approx(xy) for xy in ([4.6, 1.0], [8.9, 3.0], [5.3, 3.0])]
    assert pause.tolist() == pytest.approx([13 * 0.4] * 3)


def test_goals_and_ways_lead_over_the_stops(folder: Path) -> None:
    scenario = replay(folder, "stops", stops=True)
    people, (waiter, in_wall) = scenario.persons, (person(scenario, one) for one in (WAITER, IN_WALL))
    assert float(people.path_length[waiter]) == pytest.approx(4.6 - 3.1 + np.hypot(2.4, 3.6), abs=0.1)
    # no path leads to the first stop in a wall: that person goes to the second one at once
    assert float(people.path_length[in_wall]) == pytest.approx(7.1 - 3.5, abs=0.1)
    assert (people.goals >= 0).sum(1).tolist() == [2, 1, 2, 1]
    assert people.pauses[[waiter, in_wall]].tolist() == [[pytest.approx(13 * 0.4)]] * 2


@pytest.mark.parametrize("policy", ["go_to_goal", "orca:radius=0.3", "social_walker.styled"])
def test_people_stand_at_their_stop_and_go_on(folder: Path, policy: str) -> None:
    def way(stops: bool) -> tuple[Tensor, Tensor]:
        """Return where the waiter was while a policy moved it (T, 2), and its speeds (T - 1,)."""
        scenario = replay(folder, "stops", stops=stops)
        result, _ = rollout(policy, scenario, "compiled", scenario.scenes)
        path = result.trace[(result.person == person(scenario, WAITER)) & result.controlled]
        return path, path.diff(dim=0).norm(dim=1) / 0.1

    path, speed = way(stops=True)
    stands = (speed < 0.25).nonzero()[:, 0]  # learned people come the last decimetres step by step
    # 5.2 s, less the first and the last step, in which they come and go
    assert 0.1 * len(stands) == pytest.approx(5.2, abs=0.9)
    assert float((path[stands] - torch.tensor([4.6, 1.0])).norm(dim=1).median()) < 0.1
    assert float((path[-1] - torch.tensor([7.0, 4.6])).norm()) < 0.31
    assert int((way(stops=False)[1] < 0.1).sum()) < 5


def test_a_scene_without_stops_is_as_before(folder: Path) -> None:
    save(folder / "walker.txt", [row for row in STOPS if row[1] == WALKER])
    without, stops = (run(replay(folder, "walker", stops=stops), GoToGoal()) for stops in (False, True))
    assert torch.equal(without.trace, stops.trace)


def test_waiting_people_go_to_their_place_others_by_the_model() -> None:
    desired = torch.tensor([[[1.3, 0.0], [0.0, 0.65], [0.0, 0.0]]])
    agents = {"desired_velocity": desired, "pref_speed": torch.full((1, 3, 1), 1.3)}
    step = torch.tensor([[[0.1, 0.2], [0.4, 0.0], [0.3, 0.3]]])
    # half of the usual speed: half of the model's step and half of what leads to the place
    expected = [pytest.approx([0.1, 0.2]), pytest.approx([0.2, 0.13]), [0, 0]]
    assert stay_in_place(TensorDict({"agents": agents}, [1]), step)[0].tolist() == expected
    without = TensorDict({"agents": {"pref_speed": torch.ones(1, 3, 1)}}, [1])
    assert torch.equal(stay_in_place(without, step), step)


# Recordings of others


def test_ways_on_coarser_cells_lead_to_the_same_goals() -> None:
    cells = np.zeros((100, 100), dtype=np.uint8)
    cells[40:60, :70] = OCCUPIED  # a wall with a way round its right end
    bank, start = MapBank([OccupancyGrid(cells, 0.05)]), torch.tensor([[1.0, 1.0], [1.1, 3.5]])
    goals = np.array([[1.02, 4.01], [1.11, 4.12], [1.19, 4.03], [4.0, 4.0]])
    map_id, pose = torch.full((8,), bank.grids[0].map_id), torch.tensor([[0.0, 1, 0, 0]]).repeat(8, 1)
    planners = [Planner(bank, cell=cell) for cell in (0.0, 0.1)]
    ids = [planner.add_goals(0, goals).repeat_interleave(2) for planner in planners]
    exact, rough = (
        planner.next_waypoints(start.repeat(4, 1), goal, map_id, pose)
        for planner, goal in zip(planners, ids, strict=True)
    )
    assert torch.allclose(rough.goal_point, torch.from_numpy(goals).float().repeat_interleave(2, 0))
    assert float((exact.distance - rough.distance).abs().max()) < 0.15
    assert torch.equal(exact.distance[1::2][:3], rough.distance[1::2][:3])  # in sight: to the goal itself


def test_recordings_of_a_fold(shared: Path, monkeypatch) -> None:
    monkeypatch.setenv("PEDZOO_DATA", str(shared / "data"))
    result, env = rollout("go_to_goal", "replay:fold=zara1,share=0.1", "compiled", 1)
    people: Any = env.prepared.persons  # type: ignore[attr-defined]
    assert sum(people.counts.values()) == 148 and people.counts["later"] > 100
    assert (people.first[people.controlled] * 10 <= people.last.max()).all()
    scored = result.person[result.controlled].unique()
    assert len(scored) == people.counts["controlled"] > 10
    assert len(result.person[result.controlled & (result.reached > 0)].unique()) > 0.9 * len(scored)
    assert 1.0 < float(people.pref_speed.median()) < 1.3


def test_coarser_floor_plans() -> None:
    cells = np.array([[0, 0, 2, 2, 0], [0, 1, 2, 2, 2], [0, 0, 0, 2, 0]])
    coarse = OccupancyGrid(cells.astype(np.uint8), 0.05, (1.0, 2.0, 0.0), name="small").coarser(0.1)
    assert coarse.cells.tolist() == [[OCCUPIED, UNKNOWN, FREE], [FREE, FREE, FREE]]
    assert (coarse.resolution, coarse.origin, coarse.name) == (0.1, (1.0, 2.0, 0.0), "small")
    assert coarse.coarser(0.15) is coarse
