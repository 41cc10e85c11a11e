"""All closed-loop metrics of a rollout: values computed by hand, what they must not depend on, and sums."""

import math
from dataclasses import fields, replace

import pytest
import torch
from helpers.walks import made, straight
from torch import Tensor

from pedzoo.eval.comparison import row
from pedzoo.metrics.arrival import time_ratios
from pedzoo.metrics.closed_loop import NAMES, closed_loop
from pedzoo.metrics.ratios import summarised, wilson
from pedzoo.sim.rollout import OVER_TIME, Rollout, joined


def bits(*rows: str) -> torch.Tensor:
    return torch.tensor([[letter == "1" for letter in row] for row in rows])


def two_episodes() -> Rollout:
    """Two people in each: both arrive in the first one, in the second one is late and the other absent."""
    path = torch.zeros(2, 2, 6, 2)
    path[0, 0, :, 0] = torch.tensor([0.0, 0.0, 0.1, 0.2, 0.3, 0.3])
    path[0, 1, :, 0] = torch.tensor([0.0, 1.0, 0.9, 0.6, 0.4, 0.3])
    path[0, 1, 1:, 1] = 0.3
    return made(
        path,
        torch.stack((bits("11100", "11110"), bits("11111", "00000"))),
        agent_contact=torch.stack((bits("00100", "00110"), bits("00000", "00000"))),
        wall_contact=torch.stack((bits("10100", "00000"), bits("11101", "00000"))),
        reached=torch.tensor([[[0, 0, 1, 1, 1], [0, 0, 0, 1, 1]], [[0, 0, 0, 0, 0], [9, 9, 9, 9, 9]]]),
        overdue=torch.tensor([[False, False], [True, False]]),
        mask=torch.tensor([[True, True], [True, False]]),
    )


def busy() -> Rollout:
    """Three people each meander through a door, touch things and arrive, in five episodes and in double.

    In the first one a person begins where they have to wait.
    """
    generator = torch.Generator().manual_seed(0)
    wander = torch.randn(5, 3, 30, 2, generator=generator, dtype=torch.float64).repeat_interleave(4, dim=2)
    side = torch.tensor([-1.0, 1.0, -1.0]).double().view(1, 3, 1, 1)
    toward = side * torch.tensor([-2.6, 0.0]).double() * (torch.rand(5, 3, 1, 1, generator=generator) + 0.6)
    start = side * torch.tensor([2.5, 0.1]).double() + torch.tensor([[[0.0, 0.0]], [[0.0, 0.0]], [[-1, 0.2]]])
    steps = (toward / 2 + 0.6 * wander) * 0.1
    path = torch.cat((start.expand(5, 3, 1, 2), steps), dim=2).cumsum(2)
    length = torch.tensor([120, 120, 100, 88, 120]).view(5, 1, 1)
    present = (torch.arange(120) < length).expand(5, 3, 120)
    when = torch.tensor([[60, 70, 80], [50, 60, 70], [40, 45, 49], [30, 80, 500], [10, 20, 30]]).unsqueeze(2)
    speeds = 1.0 + torch.rand(5, 3, generator=generator, dtype=torch.float64)
    speeds[0] = 1.3  # no person is faster
    return made(
        path,
        present,
        planned=torch.rand(5, 3, 1, generator=generator, dtype=torch.float64).expand(5, 3, 120) + 4.0,
        agent_contact=present & (torch.rand(5, 3, 120, generator=generator) < 0.05),
        wall_contact=present & (torch.rand(5, 3, 120, generator=generator) < 0.05),
        reached=(torch.arange(120) >= when).long() + (torch.arange(120) >= 2 * when).long(),
        pref_speed=speeds,
        first_path_length=(torch.arange(15) > 0).double().view(5, 3),
        gate=torch.tensor([0.0, 0.0, 1.0, 0.0, 3.0], dtype=torch.float64).expand(5, 5),
        changed=0.1 * torch.rand(5, 3, 120, generator=generator, dtype=torch.float64),
    )


def permuted(walked: Rollout, order: list[int]) -> Rollout:
    """Return the rollout with its people in another order."""
    values = {field.name: getattr(walked, field.name) for field in fields(walked)}
    people = {*OVER_TIME, "changed", "overdue", "mask", "past", "pref_speed", "first_path_length"}
    return replace(walked, **{name: value[:, order] for name, value in values.items() if name in people})


def turned(walked: Rollout, angle: float, shift: tuple[float, float]) -> Rollout:
    """Return the rollout, turned about the origin and shifted."""
    turn = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]).double()

    def moved(points: Tensor) -> Tensor:
        return points @ turn + torch.tensor(shift).double()

    assert walked.gate is not None
    centre, normal, width = walked.gate.split((2, 2, 1), dim=1)
    places = {name: moved(getattr(walked, name)) for name in ("trace", "goal", "past")}
    return replace(walked, **places, gate=torch.cat((moved(centre), normal @ turn, width), dim=1))


def metrics(walked: Rollout) -> dict[str, float]:
    return summarised(closed_loop(walked))[0]


def test_row_of_two_episodes() -> None:
    result = row("policy", two_episodes())
    minutes = (3 + 4 + 5) / 600
    second = 1.09**0.5 + 0.1 + 0.3 + 0.2  # metres that the second person walks until the goal
    assert result["metrics"] == pytest.approx(
        {
            "success": 2 / 3,
            "episode_success": 0.5,
            "clean": 0.0,
            "contact_free": 0.0,
            "failed": 0.0,
            "deadlock": 0.0,
            "goals_per_person": 2 / 3,
            "goals_per_person_min": 0.5,
            "goals_per_person_max": 0.5,
            "goals_parity": 1.0,
            "time_s": 0.4,
            "decisions": 1.0,
            "time_ratio": (0.3 + 0.4) / 2,
            "path_ratio": (0.2 + second) / 2,
            "spl": (1 + 1 / second + 0) / 3,
            "stl": (1 + 1 + 0) / 3,
            "agent_contacts_per_min": 2 / minutes,
            "wall_contacts_per_min": 4 / minutes,
            "agent_contacts_per_episode": 1.0,
            "wall_contacts_per_episode": 2.0,
            "agent_contact_episodes": 0.5,
            "wall_contact_episodes": 1.0,
            "personal_space": 1.0,
            "personal_space_igibson": 1.0,
            "least_distance_m": 0.5,
            "speed_m_per_s": (0.5 / 0.4 + 0) / 2,  # two people are there for a whole window
            "path_irregularity_rad_per_m": 0.0,
            "time_ratio_median": 0.3,  # the lower one of two
        }
    )
    ordered = [name for name in NAMES if name in result["metrics"]]
    assert list(result["metrics"]) == [*ordered, "time_ratio_median"]
    assert result["name"] == "policy" and result["n"] == 2 and result["decision_dt_s"] == 0.4
    assert result["ci95"]["episode_success"] == wilson(0.5, 2)
    assert "time_s" not in result["ci95"]  # one episode says nothing about others
    first, _, third = people = result["per_agent"]
    known = [(one["episode"], one["agent"], one["time_s"], one["wall_contacts"]) for one in people]
    assert known == [(0, 0, 0.3, 2), (0, 1, 0.4, 0), (1, 0, None, 2)] and first["agent_contacts"] == 1
    assert third["least_distance_m"] is None and third["success"] is False


def test_clean_episodes_have_arrivals_and_no_touch() -> None:
    """Of five episodes one is clean; in the others a person touches, is late, or the policy fails."""
    path = torch.stack((straight(points=5), straight(points=5, start=(0.0, 2.0)))).expand(5, 2, 6, 2)
    none = torch.zeros(5, 2, 5, dtype=torch.bool)
    agents, walls = none.clone(), none.clone()
    agents[1, 0, 2] = walls[2, 1, 0] = True
    overdue, failed = torch.zeros(5, 2, dtype=torch.bool), torch.zeros(5, dtype=torch.bool)
    overdue[3, 1] = failed[4] = True
    ends = {"reached": torch.ones(5, 2, 5, dtype=torch.long), "overdue": overdue, "failed": failed}
    walked = made(path, agent_contact=agents, wall_contact=walls, **ends)
    result = metrics(walked)
    assert result["clean"] == pytest.approx(1 / 5) and result["contact_free"] == pytest.approx(3 / 5)
    assert result["episode_success"] == pytest.approx(3 / 5)
    # who is played back may touch: only people whom the policy moves are scored
    played = replace(walked, controlled=walked.controlled & torch.tensor([[False], [True]]))
    assert metrics(played)["contact_free"] == pytest.approx(4 / 5)


def test_median_time_is_of_those_who_arrive() -> None:
    walked = busy()
    value, known = time_ratios(walked)
    arrived = sorted(value[known].tolist())
    result = row("policy", walked)
    middle = result["metrics"]["time_ratio_median"]
    assert middle == pytest.approx(arrived[(len(arrived) - 1) // 2]) and 0 < len(arrived) < 15
    assert "time_ratio_median" not in result["ci95"]  # five episodes are too few
    twice = joined([walked, walked])
    low, high = row("policy", twice)["ci95"]["time_ratio_median"]
    assert low <= middle <= high and low in arrived and high in arrived
    in_time = replace(walked, overdue=~walked.overdue)
    assert "time_ratio_median" not in row("policy", in_time)["metrics"]


def test_no_person_who_fails_at_once_has_rates() -> None:
    walked, nothing = two_episodes(), ("present", "controlled", "agent_contact", "wall_contact", "reached")
    none = {name: torch.zeros_like(getattr(walked, name)) for name in nothing}
    metrics = row("broken", replace(walked, failed=torch.tensor([True, True]), **none))["metrics"]
    assert metrics["failed"] == 1.0 and metrics["success"] == metrics["episode_success"] == 0.0
    assert not {"time_s", "least_distance_m", "agent_contacts_per_min"} & set(metrics)


def test_metrics_depend_on_neither_frame_nor_numbers() -> None:
    walked = busy()
    expected = metrics(walked)
    assert tuple(expected) == NAMES
    trivial = {key for key, value in expected.items() if value in (0.0, 1.0)}
    touched = {"agent_contact_episodes", "wall_contact_episodes", "clean", "contact_free"}
    assert trivial == {"failed", "deadlock", "through", "all_through"} | touched
    assert metrics(turned(walked, 2.0, (3.0, -7.0))) == pytest.approx(expected, rel=1e-6)
    assert metrics(permuted(walked, [2, 0, 1])) == pytest.approx(expected, rel=1e-9)
    assert walked.gate is not None
    around = walked.gate * torch.tensor([1, 1, -1, -1, 1])
    assert metrics(replace(walked, gate=around)) == pytest.approx(expected, rel=1e-9)


def test_neither_the_warm_start_counts_nor_what_follows_the_end() -> None:
    walked = busy()
    after = ~walked.present.unsqueeze(-1)
    noise = torch.randn(walked.trace.shape, generator=torch.Generator().manual_seed(1)).double()
    elsewhere = torch.where(after, noise, walked.trace)
    result = replace(walked, trace=elsewhere, wall_contact=walked.wall_contact | after[..., 0])
    assert metrics(result) == pytest.approx(metrics(walked), rel=1e-12)
    warm_start = torch.cat((noise[:, :, :28], walked.past[:, :, 28:]), dim=2)
    assert metrics(replace(walked, past=warm_start)) == pytest.approx(metrics(walked), rel=1e-12)
    longer = joined([walked, two_episodes_with_door()]).episodes(slice(5))
    assert metrics(longer) == pytest.approx(metrics(walked), rel=1e-12)


def two_episodes_with_door() -> Rollout:
    """Return three people who stand for 20 s beside a door."""
    path = torch.tensor([[-1.0, 0.0], [1.0, 0.0], [-2.0, 0.0]], dtype=torch.float64)
    path = path.view(1, 3, 1, 2).expand(2, 3, 201, 2)
    gate = torch.tensor([0.0, 0.0, 1.0, 0.0, 0.85], dtype=torch.float64)
    return made(path, gate=gate.expand(2, 5), changed=torch.zeros(2, 3, 200, dtype=torch.float64))


def test_ratios_of_times_and_ways_are_ratios_of_sums() -> None:
    """One person walks 4.5 m in 3 s for a way of 3 m and 2 s, another one 0.1 m in 0.1 s for 4 mm."""
    walked = made(
        torch.stack((straight(1.5, 40), straight(1.0, 40, (9.0, 0.0)))).unsqueeze(0),
        reached=(torch.arange(40) >= torch.tensor([[29], [0]])).long().unsqueeze(0),
        planned=torch.tensor([3.0, 0.004]).double().view(1, 2, 1).expand(1, 2, 40),
        pref_speed=torch.tensor([[1.5, 1.0]]).double(),
    )
    result = metrics(walked)
    assert result["time_ratio"] == pytest.approx(3.1 / 2.004)
    assert result["path_ratio"] == pytest.approx(4.6 / 3.004)
    ratios = closed_loop(joined([walked, walked]))
    assert ratios["time_ratio"].above.tolist() == pytest.approx([3.1, 3.1])
    assert ratios["time_ratio"].below.tolist() == pytest.approx([2.004, 2.004])
    assert time_ratios(walked)[0].tolist() == [pytest.approx([1.5, 25.0])]
    overdue = replace(walked, overdue=torch.tensor([[True, False]]))
    assert metrics(overdue)["time_ratio"] == pytest.approx(0.1 / 0.004)
    assert not {"time_ratio", "path_ratio"} & set(metrics(replace(overdue, planned=overdue.planned * 0.0)))
    # a replay has two people in one slot: 19 steps of 0.1 m for 1 m, and 18 of 0.3 m for 5 m
    path = torch.cat((straight(1.0, 20), straight(3.0, 20, (30.0, 0.0))[1:])).view(1, 1, 41, 2)
    turn, reached = (torch.arange(40) >= 20).view(1, 1, 40), torch.arange(40) % 20 >= 18
    planned = torch.where(turn, 5.0, 1.0).double()
    replay = made(path, person=turn.long(), reached=reached.long().view(1, 1, 40), planned=planned)
    assert replay.replayed and metrics(replay)["path_ratio"] == pytest.approx((1.9 + 5.4) / (1 + 5))


def test_a_frozen_crowd_is_deadlocked_and_gets_nowhere() -> None:
    frozen = two_episodes_with_door()
    result = metrics(replace(frozen, goal=frozen.goal + 5.0, overdue=~frozen.overdue))
    assert result["deadlock"] == 1.0 and result["success"] == result["spl"] == result["stl"] == 0.0
    assert result["speed_m_per_s"] == 0.0 and result["symmetry_index"] == pytest.approx(0.0)
    undefined = {"path_ratio", "time_ratio", "yield_delay_s", "path_irregularity_rad_per_m"}
    assert not undefined & set(result)


def test_a_replay_scores_people_and_not_slots() -> None:
    # slot 0: one person until 4 s, another one from then on, 30 m away; slot 1: played back, 0.4 m beside
    first, second = straight(1.0, 40), straight(1.5, 40, (30.0, 0.0))
    path = torch.stack(
        (torch.cat((first, second[1:])), torch.cat((first, first[1:])) + 0.4 * torch.tensor([0, 1]))
    )
    person = torch.tensor([5] * 40 + [8] * 40)
    controlled = torch.stack((torch.ones(80), torch.zeros(80))).bool()
    walked = made(
        path.unsqueeze(0),
        controlled=controlled.unsqueeze(0),
        person=torch.stack((person, torch.full((80,), 6))).unsqueeze(0),
        wall_contact=torch.ones(1, 2, 80, dtype=torch.bool),
        reached=(torch.arange(80) // 2 == 19).long() * torch.tensor([[[1], [0]]]),
        planned=torch.full((1, 2, 80), 3.2),
        gate=torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.85]]),
    )
    assert walked.replayed and not busy().replayed
    result = metrics(walked)
    # the second's first 0.1 s has no point before it, so that the first of their windows is not whole
    assert walked.scored.sum() == 79
    assert result["speed_m_per_s"] == pytest.approx((10 * 1.0 + 9 * 1.5) / 19)
    assert result["acceleration_m_per_s2"] == pytest.approx(0.0, abs=1e-6)
    assert result["personal_space"] == pytest.approx(39 / 79)
    assert result["wall_contacts_per_episode"] == 2.0  # not those of who is played back
    assert result["least_distance_m"] == pytest.approx(0.4)
    # the first person arrives after 3.9 m, one point before the end of the decision; the second never does
    assert walked.underway.sum() == 79 and not walked.underway[0, 0, 39]
    assert result["success"] == 0.5 and result["failed"] == result["deadlock"] == 0.0
    assert result["path_ratio"] == pytest.approx(3.9 / 3.2) and result["spl"] == pytest.approx(3.2 / 3.9 / 2)
    assert not {"time_ratio", "goals_per_person", "symmetry_index", "personal_space_igibson"} & set(result)


def test_score_has_only_what_some_episode_says_something_about() -> None:
    result = metrics(made(straight()[None, None]))
    assert result["success"] == 0.0 and result["speed_m_per_s"] == pytest.approx(1.3)
    assert not {"time_s", "least_distance_m", "time_to_collision_s", "symmetry_index"} & set(result)
    # an episode may be shorter than a window
    result = metrics(made(torch.stack((straight(1.0, 3), straight(1.0, 3, (0.0, 1.0)))).unsqueeze(0)))
    assert result["least_distance_m"] == pytest.approx(1.0) and result["personal_space"] == 1.0
    assert not {"speed_m_per_s", "jerk_m_per_s3", "time_to_collision_s"} & set(result)


def test_shares_have_intervals_of_as_many_trials_as_there_are() -> None:
    walked = busy()
    values, intervals = summarised(closed_loop(walked))
    both_through = int((closed_loop(walked)["faster_first"].below > 0).sum())
    assert 0 < both_through < 5
    assert intervals["faster_first"] == wilson(values["faster_first"], both_through)
    assert intervals["success"] == wilson(values["success"], 5)
    for name, (low, high) in intervals.items():
        assert low <= values[name] <= high
