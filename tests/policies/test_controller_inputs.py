"""What a controller says about misspelt ids, arguments that are no mapping, and people in walls."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pedzoo.core.errors import UserError
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy

HALL = rectangles([*room((0, 0), (15, 6), 0.2), (4.0, 2.0, 6.0, 4.0)], resolution=0.1)
"""15 x 6 m with a block of 2 x 2 m in the middle."""

PLAN = replace(HALL, origin=(HALL.origin[0] - 5, HALL.origin[1] - 3, 0.0))
"""The same 5 m to the left and 3 m down: the block is about (0, 0)."""

OFF = r"is at \(40\.00, 1\.00\), outside map"
"""The warning of a person there."""


def controller(plan: Any = PLAN) -> Controller:
    return Controller(load_policy("go_to_goal"), plan)


@pytest.mark.parametrize(
    ("radius", "message"),
    [
        ({"rbot": 1.0}, r"^unknown id in radius 'rbot': did you mean 'robot'\? known: anna, robot$"),
        ({"robot": 1.0, "Anna": 0.2}, "id in radius 'Anna': did you mean 'anna'"),
        ({7: 0.2}, "id in radius '7': known: 'anna', 'robot'"),
    ],
)
def test_a_radius_of_nobody_is_refused_and_changes_nothing(radius: Any, message: str) -> None:
    walk = controller()
    people, goals, others = {"anna": (-4, -2)}, {"anna": (-4, 2)}, {"robot": (-3, 0)}
    with pytest.raises(UserError, match=message):
        walk.step(people, goals, others=others, radius=radius)
    with pytest.raises(UserError, match="no goal for 'anna'"):
        walk.step(people)
    walk.step(people, goals, others=others, radius={"robot": 1.0, "anna": 0.2})
    assert walk._agents.radius.tolist() == pytest.approx([0.2, 1.0])


def test_a_radius_of_people_who_have_left_does_not_matter() -> None:
    walk = controller()
    radius = {"anna": 0.2, 7: 0.3}
    walk.step({"anna": (-4, -2), 7: (-3, -2)}, {"anna": (-4, 2), 7: (-3, 2)}, radius=radius)
    assert list(walk.step({"anna": (-4, -1.9)}, radius=radius)) == ["anna"]
    walk.reset()
    with pytest.raises(UserError, match="unknown id in radius '7'"):
        walk.step({"anna": (-4, -2)}, {"anna": (-4, 2)}, radius=radius)


@pytest.mark.parametrize("what", ["people", "goals", "velocities", "others", "radius", "groups"])
@pytest.mark.parametrize("value", [0.3, [(1, 2)]])
def test_arguments_that_are_no_mapping_are_named(what: str, value: Any) -> None:
    given: dict[str, Any] = {"people": {"anna": (-4, -2)}, "goals": {"anna": (-4, 2)}} | {what: value}
    with pytest.raises(
        UserError, match=rf"^{what} .*: expected a mapping by id, {what}=\{{'anna': \.\.\.\}}$"
    ):
        controller().step(**given)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ((40, 1), r"goal \(40\.00, 1\.00\) is outside .* is \(9\.\d\d, \d\.\d\d\)"),
        ((0.0, 0.1), r"goal \(0\.00, 0\.10\) is in a wall .* is \(-1\.\d\d, 0\.\d\d\)"),
    ],
)
def test_goals_are_refused_in_the_frame_of_the_floor_plan(goal: Any, message: str) -> None:
    with pytest.raises(UserError, match=message):
        controller().step({"anna": (-4, -2)}, {"anna": goal})


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (
            (40, 1),
            rf"^'anna' {OFF} 'plan': .* nearest free place, \(9\.\d\d, \d\.\d\d\); .* frame, in metres\?$",
        ),
        (
            (0.1, 0.6),
            r"'anna' is at \(0\.10, 0\.60\), in a wall of map 'plan': .* place, \(0\.\d\d, 1\.\d\d\)",
        ),
    ],
)
@pytest.mark.parametrize("goal", [(-4, 2), None])
def test_people_in_walls_or_off_the_map_are_warned_of_once(place: Any, goal: Any, message: str) -> None:
    walk = controller()
    walk.step({"bo": (-4, -2)}, {"bo": (-4, 2)})
    with pytest.warns(UserWarning, match=message) as told:
        walk.step({"bo": (-4, -1.5), "anna": place}, {"anna": goal})
    assert len(told) == 1 and told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        walk.step({"bo": (-4, -1.0), "anna": place, "cy": (60, 60)}, {"cy": None})
        walk.reset()
        walk.step({"cy": (60, 60)}, {"cy": None})


def test_several_people_are_counted_and_other_agents_are_not() -> None:
    people = {"anna": (-4, -2), "bo": (40, 1), "cy": (41, 1)}
    with pytest.warns(UserWarning, match=rf"^'bo' \(and 1 more\) {OFF}|^'cy' \(and 1 more\) is at"):
        controller().step(people, dict.fromkeys(people, (-4, 2)), others={"robot": (60, 60)})


@pytest.mark.parametrize("place", [(-0.9, 0.0), (-5.12, 1.0), (-5.2, 1.0), (9.9, 2.9)])
def test_people_may_brush_walls_and_walk_in_from_outside(place: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller().step({"anna": place}, {"anna": (-4, 2)}, others={"robot": (60, 60), "box": (0, 0)})
        controller(None).step({"anna": (900, 900)}, {"anna": (-4, 2)})


def test_who_is_known_may_go_anywhere() -> None:
    walk = controller()
    walk.step({"anna": (-4, -2)}, {"anna": (-4, 2)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        walk.step({"anna": (40, 1)})


EDGE = rectangles(room((0, 0), (8, 6), 0.1) + wall((4, 0), (4, 6), 0.1), 0.05, name="edge")


@pytest.mark.parametrize("name", ["go_to_goal", "orca", "sgan_goal_map.indoor"])
@pytest.mark.parametrize("goal", [(3.2, 0.1), (3.9, 3.0), (3.95, 3.0), (3.8, 4.0), (0.07, 5.93)])
def test_a_goal_at_a_wall_is_moved_with_a_warning(name: str, goal: Any) -> None:
    walk = Controller(load_policy(name), EDGE, dt=0.1)
    place, asked = np.array([1.5, 1.5]), np.array(goal)
    with pytest.warns(UserWarning, match="goal of 'a'.*0.25 m from a wall of map 'edge'.*moved by") as said:
        place = place + 0.1 * walk.step({"a": place}, {"a": goal})["a"]
    with warnings.catch_warnings(record=True) as again:
        for _ in range(200):
            place = place + 0.1 * walk.step({"a": place}, {"a": goal})["a"]
        walk.step({"a": place, "b": (2, 2)}, {"b": goal})
    assert (len(said), again) == (1, [])
    moved = np.array([float(part) for part in re.findall(r"to \((.*), (.*)\)$", str(said[0].message))[0]])
    assert bool(walk._agents.stands[walk._agents.row["a"]])
    away = np.linalg.norm(moved - asked)
    assert np.linalg.norm(place - asked) < max(0.31, away + 0.16)
    assert place[0] < 4  # on this side of the wall
