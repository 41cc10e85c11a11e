"""Metrics of robots against numbers computed by hand."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from helpers.walks import made
from torch import Tensor

from pedzoo.core.batch import PERSON, ROBOT
from pedzoo.core.bodies import Fleet, RobotBody
from pedzoo.metrics import robots as of_robots
from pedzoo.metrics.ratios import summarised
from pedzoo.metrics.robots import LEGEND, robot_metrics
from pedzoo.sim.rollout import RobotRollout, Rollout, joined


def straight(start: tuple[float, float], velocity: tuple[float, float], points: int) -> Tensor:
    """Return a path (points + 1, 2) at a constant velocity, m/s."""
    ticks = torch.arange(points + 1).unsqueeze(1) * 0.1
    return torch.tensor(start) + ticks * torch.tensor(velocity)


def rollout_of(paths: list[Tensor], robots: int = 1, **changed: Any) -> Rollout:
    """Return one episode of agents who walk as given; the last ones are robots of 0.3 m."""
    path = torch.stack(paths).unsqueeze(0)
    (agents, points), none = (path.shape[1], path.shape[2] - 1), torch.zeros(1, path.shape[1])
    robot = torch.arange(agents).unsqueeze(0) >= agents - robots
    values: dict[str, Any] = {
        "goal": torch.tensor([10.0, 0.0]).expand(1, agents, points, 2),
        "planned": torch.full((1, agents, points), 9.7),
        "pref_speed": none + 1.25,
        "first_path_length": none + 10.0,
        "radius": torch.where(robot, 0.3, 0.15),
        "kind": torch.where(robot, ROBOT, PERSON),
    }
    return made(path, **values | changed)


def robots_of(walked: Rollout, alone: Rollout | None = None, **changed: Any) -> RobotRollout:
    points, robots = walked.trace.shape[2], int((walked.kind == ROBOT).sum())
    never, no = torch.zeros(1, robots, points).bool(), torch.zeros(1, robots).bool()
    values: dict[str, Any] = {
        "walked": walked,
        "alone": walked if alone is None else alone,
        "heading": torch.zeros(1, robots, points + 1),
        "success": no,
        "timeout": no,
        "failed": no,
        "progress": torch.zeros_like(walked.pref_speed),
        "progress_alone": torch.zeros_like(walked.pref_speed),
        "goals": 1,
        "bodies": Fleet.of([RobotBody()] * robots),
    }
    values |= dict.fromkeys(("person_contact", "robot_contact", "wall_contact"), never)
    return RobotRollout(**values | changed)


def values_of(rollout: RobotRollout) -> dict[str, float]:
    return summarised(robot_metrics(rollout))[0]


def test_spl_and_stl_of_a_robot_that_arrives() -> None:
    """By hand: planned 4 m at 1 m/s; it drives 5 m in 5 s and arrives with the 50th point."""
    walked = rollout_of([straight((50, 0), (0, 0), 50), straight((0, 0), (1, 0), 50)])
    reached = walked.reached.clone()
    reached[:, -1, -1] = 1
    walked = replace(walked, reached=reached, planned=torch.full_like(walked.planned, 4.0))
    result = values_of(robots_of(walked, success=torch.ones(1, 1).bool()))
    assert result["success"] == 1 and result["timeout"] == 0
    assert result["spl"] == pytest.approx(0.8) and result["stl"] == pytest.approx(0.8)
    assert result["time_s"] == pytest.approx(5.0) == result["duration_s"]
    assert result["path_m"] == pytest.approx(5.0) and result["path_ratio"] == pytest.approx(1.25)
    assert result["speed_m_per_s"] == pytest.approx(1.0)
    assert result["jerk_m_per_s3"] == pytest.approx(0.0, abs=1e-3)
    assert result["final_goal_distance_m"] == pytest.approx(5.0)


def test_turning_and_standing_by_hand() -> None:
    """It turns left by 0.5 and right by 0.3 rad in place, then stands for 0.2 s, then drives."""
    heading = torch.tensor([[[3.0, 3.5 - 2 * math.pi, 3.2 - 2 * math.pi, *[3.2 - 2 * math.pi] * 3]]])
    path = torch.zeros(6, 2)
    path[5, 0] = 0.1
    walked = rollout_of([path], goal=torch.tensor([0.4, 0.0]).expand(1, 1, 5, 2))
    result = values_of(robots_of(walked, heading=heading))
    assert result["heading_change_rad"] == pytest.approx(0.8, abs=1e-5)
    assert result["standing_s"] == pytest.approx(0.2)
    assert result["least_goal_distance_m"] == pytest.approx(0.3) == result["final_goal_distance_m"]
    slowly = robots_of(rollout_of([torch.zeros(3, 2)]), heading=torch.tensor([[[0.0, 0.1, 0.1]]]))
    assert values_of(slowly)["standing_s"] == pytest.approx(0.1)


def test_distances_and_spaces_by_hand() -> None:
    """Bodies of 0.3 and 0.15 m, 0.6 m apart: 0.15 m between bodies, 0.3 m to the person's centre."""
    paths = [straight((0.6, 0), (1, 0), 20), straight((0, 0), (1, 0), 20)]
    result = values_of(robots_of(rollout_of(paths)))
    assert result["nearest_person_m"] == pytest.approx(0.15, abs=1e-5)
    assert result["least_person_m"] == pytest.approx(0.3, abs=1e-5)
    assert result["discomfort"] == 1 and result["space_intimate"] == 1 and result["space_personal"] == 0
    assert result["personal_space"] == 1
    near_by = [straight((0.45, 0), (1, 0), 20), paths[1]]
    assert values_of(robots_of(rollout_of(near_by)))["personal_space"] == 0


def test_intrusions_are_where_people_will_be() -> None:
    """By hand: a person comes at 1 m/s from 2 m; bodies touch 0.45 m apart, the future ends after 1.25 s.

    At point t the person is 2 - 0.1 t away, and 1.25 m nearer at most. So the robot intrudes from t = 4 on
    (1.6 m, 0.35 m in 1.25 s); at t = 3 it is 0.45 m away, and does not touch.
    """
    people = straight((2.0, 0), (-1, 0), 30)[1:].view(1, 1, 30, 2)
    robots = torch.zeros(1, 1, 30, 2)
    present = torch.ones(1, 1, 30).bool()
    intruded, least = of_robots.intrusions(robots, people, present, torch.tensor([[[0.449]]]))
    assert intruded[0, 0, :3].tolist() == [False, False, False] and intruded[0, 0, 3:16].all()
    assert least[0, 0, 3].item() == pytest.approx(0.35, abs=1e-5)
    gone, _ = of_robots.intrusions(robots, people, torch.zeros_like(present), torch.tensor([[[0.449]]]))
    assert not gone.any()


def test_social_force_by_hand_and_the_same_on_both() -> None:
    """Both stand, 1 m apart: D = e, B = 0.35, angle 0: the force is 2.1 exp(-1 / 0.35)."""
    apart, still = torch.tensor([1.0, 0.0]), torch.zeros(2)
    assert of_robots.social_force(apart, still).item() == pytest.approx(2.1 * math.exp(-1 / 0.35), rel=1e-5)
    velocity = torch.tensor([0.3, -0.8])
    torch.testing.assert_close(
        of_robots.social_force(apart, velocity), of_robots.social_force(-apart, -velocity)
    )
    # D = (1, 1): |D| = sqrt 2, angle 45 degrees
    reach, angle = 0.35 * math.sqrt(2), math.pi / 4
    ahead = math.exp(-1 / reach - (3 * reach * angle) ** 2)
    aside = math.exp(-1 / reach - (2 * reach * angle) ** 2)
    result = of_robots.social_force(apart, torch.tensor([0.0, 0.5])).item()
    assert result == pytest.approx(2.1 * math.hypot(ahead, aside), rel=1e-5)


@pytest.mark.parametrize(("robot", "person", "drives"), [(1.0, -0.5, True), (0.2, -1.0, False)])
def test_who_moves_faster_towards_the_other_drives_into_it(robot: float, person: float, drives: bool) -> None:
    paths = [straight((0.6, 0), (person, 0), 10), straight((0, 0), (robot, 0), 10)]
    touch = torch.zeros(1, 1, 10).bool()
    touch[..., 2:4] = True
    result = values_of(robots_of(rollout_of(paths), person_contact=touch, wall_contact=touch))
    assert (result["collision_person"], result["collision_wall"], result["collision_robot"]) == (1, 1, 0)
    assert (result["robot_on_person"], result["person_on_robot"]) == (float(drives), float(not drives))


def walk(arrived: bool, seconds: float, covered: float, walked: float) -> of_robots.WalkProgress:
    return of_robots.WalkProgress(
        torch.tensor([[arrived]]), *(torch.tensor([[v]]) for v in (seconds, covered, walked))
    )


@pytest.mark.parametrize(
    ("joined", "alone", "delay"),
    [
        # neither arrived: 2 m less at 1.25 m/s
        (walk(False, torch.inf, 6.0, 6.0), walk(False, torch.inf, 8.0, 8.0), 1.6),
        # both arrived
        (walk(True, 9.0, 10.0, 10.5), walk(True, 8.0, 10.0, 10.0), 1.0),
        # with the robot 2.5 m are left after 10 s, which take 2 s; without it it took 8 s
        (walk(False, torch.inf, 7.5, 8.0), walk(True, 8.0, 10.0, 10.0), 4.0),
        # the robot opens a deadlock
        (walk(True, 9.0, 10.0, 10.0), walk(False, torch.inf, 5.0, 5.0), -5.0),
    ],
)
def test_delay_by_hand(joined: of_robots.WalkProgress, alone: of_robots.WalkProgress, delay: float) -> None:
    for one, other, expected in ((joined, alone, delay), (alone, joined, -delay)):
        result = of_robots.delay(one, other, torch.tensor([[1.25]]), torch.tensor([10.0]))
        assert result.item() == pytest.approx(expected)


def test_detour_is_what_is_walked_beyond_the_progress() -> None:
    """Who waits has none; who walks 0.5 m more for the same progress has that."""
    waits = of_robots.detour(walk(False, torch.inf, 6.0, 6.0), walk(False, torch.inf, 8.0, 8.0))
    around = of_robots.detour(walk(True, 9.0, 10.0, 10.5), walk(True, 8.0, 10.0, 10.0))
    assert (waits.item(), around.item()) == pytest.approx((0.0, 0.5))


def test_effects_of_a_rollout() -> None:
    """A person stands for the robot: 3 m less after 3 s, and one touch more in 0.05 person-minutes."""
    robot = straight((0, 5), (1, 0), 30)
    walked = rollout_of([straight((0, 0), (0, 0), 30), robot])
    alone = rollout_of([straight((0, 0), (1, 0), 30), robot])
    contact, once = walked.agent_contact.clone(), walked.agent_contact.clone()
    contact[:, 0, [3, 4, 9]] = once[:, 0, 5] = True
    both = replace(walked, agent_contact=contact), replace(alone, agent_contact=once)
    progress = {"progress": torch.tensor([[0.0, 3.0]]), "progress_alone": torch.tensor([[3.0, 3.0]])}
    result = values_of(robots_of(*both, **progress))
    assert result["delay_s"] == pytest.approx(3 / 1.25) == result["delay_total_s"]
    assert result["detour_m"] == pytest.approx(0.0, abs=1e-5)
    assert result["contacts_more_per_min"] == pytest.approx((2 - 1) / 0.05)
    assert result["people_speed_m_per_s"] == 0
    played = replace(walked, controlled=walked.controlled & torch.tensor([False, True]).view(1, 2, 1))
    assert "delay_s" not in values_of(robots_of(played)), "who is played back cannot be delayed"


def bent(path: Tensor, at: int, velocity: tuple[float, float]) -> Tensor:
    """Return a path that goes on at another velocity from a point on."""
    rest = straight((0, 0), velocity, len(path) - 1 - at)
    return torch.cat((path[:at], path[at] + rest))


def test_who_changes_more_until_the_closest_approach_yields() -> None:
    """Head-on at 1 m/s each from 8 m: 7.55 m between bodies, 3 s before they touch at 6 m."""
    person, robot = straight((4, 0), (-1, 0), 60), straight((-4, 0), (1, 0), 60)
    for paths, share in (
        ([bent(person, 20, (-0.8, 0.8)), robot], 1.0),
        ([person, bent(robot, 20, (0.5, -0.8))], 0.0),
        ([bent(person, 20, (-0.95, 0.3)), bent(robot, 20, (0.5, -0.8))], 0.0),
    ):
        result = values_of(robots_of(rollout_of(paths)))
        assert result["encounters_per_min"] == pytest.approx(10.0)  # one in 6 s
        assert result["person_yields"] == share
    alone = values_of(robots_of(rollout_of([person, robot])))
    assert "person_yields" not in alone and alone["encounters_per_min"] == pytest.approx(10.0)
    apart = values_of(robots_of(rollout_of([straight((4, 2), (-1, 0), 60), robot])))
    assert apart["encounters_per_min"] == 0


def test_a_robot_that_sets_out_does_not_yield() -> None:
    """It goes from 0.5 to 1 m/s within the first second, and the person turns aside a second later."""
    person, robot = straight((4, 0), (-1, 0), 60), straight((-1, 0), (0.5, 0), 60)
    paths = [bent(person, 20, (-0.95, 0.3)), bent(robot, 9, (1, 0))]
    assert values_of(robots_of(rollout_of(paths)))["person_yields"] == 1


def test_people_who_fail_are_not_delayed() -> None:
    walked = rollout_of([straight((0, 0), (1, 0), 30), straight((0, 5), (1, 0), 30)])
    failed = robots_of(replace(walked, failed=torch.ones(1).bool()), progress_alone=torch.full((1, 2), 3.0))
    ratio = robot_metrics(failed)["delay_total_s"]
    assert ratio.above.tolist() == ratio.below.tolist() == [0.0]


@pytest.mark.parametrize("together", ["robots", "episodes"])
def test_numbers_of_two_are_means_of_those_of_each(together: str) -> None:
    """Of two robots among the same three people, and of two episodes; each touches somebody else."""
    ways = [((2, 0.4), (-1, 0.2)), ((1, 2), (0.2, -1)), ((0, 4), (0, 0)), ((0, 0), (1, 0.1))]
    ways.append(((0, 5), (0.3, -0.9)))
    *people, first, second = (straight(start, velocity, 40) for start, velocity in ways)
    touches = torch.zeros(2, 1, 1, 40).bool()
    touches[0, ..., 9:12] = touches[1, ..., 11] = True
    pairs = zip((first, second), touches, strict=True)
    each = [robots_of(rollout_of([*people, one]), person_contact=touch) for one, touch in pairs]
    both = joined(each)
    if together == "robots":
        walked = rollout_of([*people, first, second], robots=2)
        both = robots_of(walked, person_contact=touches[:, 0].transpose(0, 1))
    one, other, result = values_of(each[0]), values_of(each[1]), values_of(both)
    names = (
        "personal_space discomfort intrusion_ratio nearest_person_m social_force_m_per_s2 robot_on_person "
        "person_on_robot collision_person speed_m_per_s final_goal_distance_m least_goal_distance_m "
        "encounters_per_min path_m duration_s space_intimate space_personal space_social least_person_m "
        "acceleration_m_per_s2"
    )
    for name in names.split():
        assert result[name] == pytest.approx((one[name] + other[name]) / 2, abs=1e-5), name
    assert one["nearest_person_m"] != other["nearest_person_m"]


def test_each_robot_is_as_far_from_people_as_its_own_body() -> None:
    """A person is 1 m from both: 0.9 m and 0.4 m from the bodies."""
    paths = [straight((0, y), (1, 0), 9) for y in (1.0, 0.0, 2.0)]
    walked = rollout_of(paths, robots=2, radius=torch.tensor([[0.15, 0.1, 0.6]]))
    result = values_of(robots_of(walked))
    assert result["space_intimate"] == result["space_personal"] == 0.5
    assert result["least_person_m"] == pytest.approx((0.9 + 0.4) / 2, abs=1e-5)


def test_what_happens_after_the_episode_does_not_count() -> None:
    """Joined with a longer one, an episode says the same; so do its people in another order."""
    people = [straight((3, 0.4), (-1, 0), 30), straight((1, 2), (0, -1), 30)]
    robot = straight((0, 0), (1, 0), 30)
    short = robots_of(rollout_of([*people, robot]))
    long = robots_of(rollout_of([straight((9, 9), (0, 0), 50)] * 2 + [straight((0, 0), (1, 0), 50)]))
    both = joined([short, long])
    assert both.walked.trace.shape[2] == 50 and both.heading.shape[2] == 51
    alone, together = values_of(short), values_of(both.episodes(slice(0, 1)))
    swapped = values_of(robots_of(rollout_of([*people[::-1], robot])))
    assert alone.keys() == together.keys() == swapped.keys()
    for name, value in alone.items():
        assert together[name] == pytest.approx(value, abs=1e-5), name
        assert swapped[name] == pytest.approx(value, abs=1e-5), name


def test_a_robot_alone_has_all_metrics_that_need_no_people() -> None:
    result = robot_metrics(robots_of(rollout_of([straight((0, 0), (1, 0), 30)])))
    assert result.keys() == LEGEND.keys()
    values, _ = summarised(result)
    assert values["personal_space"] == 1 and values["discomfort"] == 0 and values["encounters_per_min"] == 0
    assert "delay_s" not in values and "nearest_person_m" not in values
