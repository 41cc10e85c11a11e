"""CrowdNav's cases and rules: RVO2 and published logs as oracles, steps by hand, invariances."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from pedzoo.core.errors import UserError
from pedzoo.policies.load import load_local_planner
from pedzoo.policies.robots._base import ObservedPeople, Robot
from pedzoo.sim.crowdnav import (
    COLLISION,
    CROWDNAV,
    CROWDNAV_PP,
    FAILED,
    GOES_ON,
    SUCCESS,
    TEST,
    TIME_STEP,
    TIMEOUT,
    Setting,
    State,
    begin,
    cases,
    step,
)
from tools.paper.crowdnav import CaseResults, run

NAMES = {SUCCESS: "success", COLLISION: "collision", TIMEOUT: "timeout", FAILED: "failed"}


def runs(name: str, setting: Setting, seeds: range) -> CaseResults:
    return run(load_local_planner(name, TIME_STEP), setting, cases(setting, seeds))


def ends(made: CaseResults) -> list[tuple[str, float]]:
    return [(NAMES[end], at) for end, at in zip(made.outcome.tolist(), made.seconds.tolist(), strict=True)]


def scene(
    people: list[list[float]],
    velocity: list[list[float]],
    goal: tuple[float, float] = (4.0, 0.0),
    setting: Setting = CROWDNAV,
) -> State:
    """One case of people who go nowhere, and a robot in the origin with its goal at (4, 0)."""
    place, moving = (torch.tensor([part], dtype=torch.float64) for part in (people, velocity))
    start, end = torch.zeros(1, 2).double(), torch.tensor([goal]).double()
    radius = place.new_full(place.shape[:2], 0.3)
    crowd = ObservedPeople(place, moving, radius, torch.ones(place.shape[:2], dtype=torch.bool))
    body = Robot(start, torch.zeros_like(start), end, radius[:, 0], torch.ones(1).double())
    return begin(setting, body, crowd, place.clone(), [np.random.RandomState(0)])


def stepped(setting: Setting, drawn: State, *velocity: float) -> tuple[State, str, float]:
    state, events = step(setting, drawn, torch.tensor([velocity]))
    return state, {GOES_ON: "goes on", **NAMES}[int(events.outcome)], float(events.reward)


# Cases


def test_cases_are_those_that_numpys_legacy_generator_draws() -> None:
    drawn = cases(CROWDNAV, range(TEST, TEST + 20))
    assert drawn.robot.position.unique(dim=0).tolist() == [[0, -4]] and drawn.robot.goal[0].tolist() == [0, 4]
    for case in range(20):
        np.random.seed(TEST + case)
        taken = [np.array([0.0, -4.0]), np.array([0.0, 4.0])]
        for person in range(5):
            while True:
                angle = np.random.random() * 2 * math.pi
                shift = np.array([np.random.random() - 0.5, np.random.random() - 0.5])
                place = 4 * np.array([math.cos(angle), math.sin(angle)]) + shift
                if min(np.linalg.norm(place - other) for other in taken) >= 0.8:
                    break
            taken += [place, -place]
            assert drawn.people.position[case, person].tolist() == pytest.approx(place.tolist(), abs=1e-12)
    assert torch.equal(drawn.goal, -drawn.people.position)


def test_a_run_is_the_same_in_any_batch_and_leaves_its_cases() -> None:
    drawn = cases(CROWDNAV_PP, range(1425, 1429))
    before = drawn.people.position.clone(), [one.random_sample() for one in drawn.copy().draws]
    many = run(load_local_planner("crowdnav_social_force", TIME_STEP), CROWDNAV_PP, drawn)
    assert torch.equal(before[0], drawn.people.position)
    assert before[1] == [one.random_sample() for one in drawn.draws]
    one = runs("crowdnav_social_force", CROWDNAV_PP, range(1427, 1428))
    assert ends(many)[2] == ends(one)[0]
    assert many.path[2].item() == pytest.approx(one.path[0].item(), abs=1e-5)


# RVO2 and published logs


@pytest.fixture
def rvo2() -> Any:
    """Return CrowdNav on RVO2, the oracle; tests skip where that is not installed."""
    pytest.importorskip("pyrvo")
    from tools.bench import crowdnav_rvo2

    return crowdnav_rvo2


def test_the_first_50_cases_of_orca_end_as_with_rvo2(rvo2: Any) -> None:
    seeds = range(TEST, TEST + 50)
    assert ends(runs("crowdnav_orca", CROWDNAV, seeds)) == [rvo2.crowdnav(seed) for seed in seeds]


@pytest.mark.slow
def test_all_500_cases_of_orca_end_as_with_rvo2_but_for_one_step(rvo2: Any) -> None:
    made = runs("crowdnav_orca", CROWDNAV, range(TEST, TEST + 500))
    theirs = [rvo2.crowdnav(TEST + case) for case in range(500)]
    other = [pair for pair in zip(ends(made), theirs, strict=True) if pair[0] != pair[1]]
    assert len(other) <= 1 and all(abs(ours[1] - oracle[1]) <= TIME_STEP for ours, oracle in other)
    won = made.outcome == SUCCESS
    assert (int(won.sum()), int((made.outcome == COLLISION).sum())) == (213, 284)
    assert made.seconds[won].mean().item() == pytest.approx(10.863, abs=0.01)


def test_orca_that_people_see_ends_as_with_rvo2(rvo2: Any) -> None:
    visible = replace(CROWDNAV, visible=True)
    for space in (0.0, 0.15):
        made = ends(runs(f"crowdnav_orca:safety_space={space}", visible, range(TEST, TEST + 10)))
        assert made == [rvo2.crowdnav(TEST + case, space, visible=True) for case in range(10)]


def test_social_forces_among_20_end_as_in_the_published_log() -> None:
    from tools.paper.published import SOCIAL_FORCE_LOG

    seeds = SOCIAL_FORCE_LOG.seeds[:20]
    made = run(load_local_planner("crowdnav_social_force", TIME_STEP), CROWDNAV_PP, cases(CROWDNAV_PP, seeds))
    assert "".join(end[0] for end, _ in ends(made)) == SOCIAL_FORCE_LOG.outcomes[:20]


def test_rvo2_ends_as_in_the_published_log_of_orca(rvo2: Any) -> None:
    from tools.paper.published import ORCA_LOG

    assert rvo2.compare(ORCA_LOG, "orca", random_people=True, cases=8) == 8


# Rules by hand


def test_a_collision_counts_on_the_way_of_a_step() -> None:
    # The person comes 0.25 m nearer and 1 m across: from (0.7, 0.5), 0.86 m, to (0.45, -0.5), 0.67 m. On the
    # way, after a share (0.7 * 0.25 + 0.5) / 1.0625 of it, it is at (0.541, -0.135), 0.558 m: less than 0.6.
    drawn = scene([[0.7, 0.5]], [[0.0, -4.0]])
    _, end, reward = stepped(CROWDNAV, drawn, 1.0, 0.0)
    assert (end, reward) == ("collision", -0.25)
    # past a robot at rest at 0.7 m: 0.1 m between bodies, 0.1 m too near, for 0.25 s
    for near in (drawn, scene([[0.0, 0.7]], [[0.0, 0.0]])):
        _, end, reward = stepped(CROWDNAV, near, 0.0, 0.0)
        assert (end, reward) == ("goes on", pytest.approx(-0.1 * 0.5 * 0.25))
    # CrowdNav++ looks at the beginning of a step alone
    assert stepped(replace(CROWDNAV_PP, foresight=0, replaced=False), drawn, 1.0, 0.0)[1] == "goes on"


def test_the_goal_counts_after_the_step_a_collision_counts_more() -> None:
    far = scene([[0.0, 9.0]], [[0.0, 0.0]], goal=(0.54, 0.0))
    assert stepped(CROWDNAV, far, 1.0, 0.0)[1:] == ("success", 1.0)
    assert stepped(CROWDNAV, far, 0.9, 0.0)[1:] == ("goes on", 0.0)
    near = scene([[0.55, 0.0]], [[0.0, 0.0]], goal=(0.5, 0.0))
    assert stepped(CROWDNAV, near, 1.0, 0.0)[1] == "collision"


def test_time_is_over_a_second_before_the_limit_whatever_happens() -> None:
    made = runs("stop", replace(CROWDNAV, time_limit=3.0), range(2))
    assert ends(made) == [("timeout", 2.25)] * 2  # the step that begins at 2 s
    reached = scene([[0.0, 9.0]], [[0.0, 0.0]], goal=(0.3, 0.0))._replace(seconds=24.0)
    assert stepped(CROWDNAV, reached, 1.0, 0.0)[1] == "timeout"


def test_robots_are_not_faster_than_they_can_and_nan_fails_alone() -> None:
    drawn = cases(CROWDNAV, range(TEST, TEST + 3))
    velocity = torch.tensor([[0.0, 30.0], [math.nan, 0.0], [0.0, 0.5]])
    state, events = step(CROWDNAV, drawn, velocity)
    assert events.outcome.tolist() == [GOES_ON, FAILED, GOES_ON]
    moved = (state.robot.position - drawn.robot.position)[:, 1].tolist()
    assert moved == pytest.approx([0.25, 0.0, 0.125])
    assert state.going.tolist() == [True, False, True]
    after, events = step(CROWDNAV, state, velocity)
    assert events.outcome[1] == GOES_ON
    assert torch.equal(after.people.position[1], state.people.position[1])


# The crowd of 20


def test_who_arrives_is_replaced_and_all_others_are_not() -> None:
    drawn = cases(CROWDNAV_PP, [1425])
    goal = drawn.goal.clone()
    goal[0, 3] = drawn.people.position[0, 3]
    setting = replace(CROWDNAV_PP, foresight=0)
    state, _ = step(setting, drawn._replace(goal=goal), torch.zeros(1, 2))
    changed = (state.goal != goal).any(-1)[0]
    assert changed.nonzero().flatten().tolist() == [3]
    assert torch.equal(state.goal[0, 3], -state.people.position[0, 3])
    others = torch.cat((state.people.position[0], state.goal[0], state.robot.position, state.robot.goal))
    apart = (others - state.people.position[0, 3]).norm(dim=-1)
    assert sorted(apart.tolist())[1] >= 0.85


def test_robots_take_people_out_of_sight_to_go_straight_on() -> None:
    setting = replace(CROWDNAV_PP, foresight=0, replaced=False)
    drawn = scene([[5.59, 0.0], [0.0, 5.61]], [[1.0, 0.0], [0.0, -1.0]], setting=setting)
    state = drawn._replace(goal=torch.tensor([[[9.0, 0.0], [0.0, -9.0]]]).double())
    assert state.known.mask.tolist() == [[True, False]]  # 5 m between bodies of 0.3 m
    state, _ = step(setting, state, torch.zeros(1, 2))
    assert state.known.mask.tolist() == [[True, True]]
    assert state.known.position[0, 0].tolist() == pytest.approx([5.84, 0.0])
    assert torch.equal(state.known.position[0, 1], state.people.position[0, 1])


def test_robots_intrude_where_people_will_be() -> None:
    # The person comes at 1 m/s: in five steps from 1.7 m to 0.45 m, less than 0.6 m.
    for place, expected in ((1.7, pytest.approx(0.45, abs=1e-5)), (1.9, math.inf)):
        drawn = scene([[place, 0.0]], [[-1.0, 0.0]])
        drawn = drawn._replace(goal=torch.tensor([[[-9.0, 0.0]]]).double())
        assert float(step(CROWDNAV_PP, drawn, torch.zeros(1, 2))[1].intruded) == expected


# Robots by name


def test_robots_of_a_file_and_wrong_ones(tmp_path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "class Slow:\n"
        "    def __init__(self, share: float = 0.5):\n        self.share = share\n"
        "    def __call__(self, robot, people):\n        way = robot.goal - robot.position\n"
        "        return self.share * way / way.norm(dim=-1, keepdim=True)\n"
        "class Nothing:\n    pass\n"
        "class Wrong:\n    def __call__(self, robot, people):\n        return robot.v_pref\n"
    )
    alone = scene([[0.0, 9.0]], [[0.0, 0.0]])
    made = run(load_local_planner(f"{file}:Slow:share=0.8", TIME_STEP), CROWDNAV, alone)
    assert ends(made) == [("success", 4.75)]  # 3.7 m at 0.2 m a step
    with pytest.raises(UserError, match="__call__"):
        load_local_planner(f"{file}:Nothing", TIME_STEP)
    with pytest.raises(ValueError, match=r"not \(1, 2\)"):
        run(load_local_planner(f"{file}:Wrong", TIME_STEP), CROWDNAV, alone)
    with pytest.raises(UserError, match="did you mean 'straight'"):
        load_local_planner("straigt", TIME_STEP)
