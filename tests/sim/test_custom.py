"""Scenarios written in YAML: people with starts and goals of their own."""

from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import pedzoo
from pedzoo.core.errors import UserError
from pedzoo.core.spec import Spec, setting_types
from pedzoo.eval.comparison import Comparison
from pedzoo.eval.rollout import rollout
from pedzoo.maps.formats import write_ros
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.sim.make import KEYS, make_env
from pedzoo.sim.scenarios.custom import SWAP, Custom

ANNA = {"from": [1.0, 2.0], "to": [7.0, 2.0]}
BEN = {"from": [7.0, 3.0], "to": [1.0, 3.0], "speed": 0.8}


def in_rooms(person: dict[str, Any], end: str, x: float, y: float) -> dict[str, Any]:
    """Return a scenario in the rooms below, with another place."""
    return {"people": [person | {end: [x, y]}], "map": "rooms.yaml"}


def write(path: Path, **keys: Any) -> str:
    path.write_text(yaml.safe_dump(keys))
    return str(path)


@pytest.fixture
def rooms(tmp_path) -> str:
    """Two rooms of 4 x 4 m with a door between them, and a third one without a door."""
    walls = (
        room((0, 0), (12, 4), 0.2) + wall((4, 0), (4, 4), 0.2, doors=[(2, 0.9)]) + wall((8, 0), (8, 4), 0.2)
    )
    write_ros(rectangles(walls, 0.05, name="rooms"), tmp_path / "rooms.yaml")
    return "rooms.yaml"


def test_people_begin_where_the_file_says_on_their_way(tmp_path) -> None:
    file = write(tmp_path / "mine.yaml", people=[ANNA, BEN], speed=1.2, speed_std=0.0)
    env = make_env(file, 2)
    history = env.reset()["agents", "history"]
    steps = 0.4 * torch.arange(-7, 1)
    anna = torch.stack((1 + 1.2 * steps, torch.full((8,), 2.0)), 1)
    ben = torch.stack((7 - 0.8 * steps, torch.full((8,), 3.0)), 1)
    torch.testing.assert_close(history, torch.stack((anna, ben)).expand(2, 2, 8, 2))
    torch.testing.assert_close(env.state.remaining_path, torch.full((2, 2), 6.0))
    torch.testing.assert_close(env.state.velocity[0], torch.tensor([[1.2, 0.0], [-0.8, 0.0]]))
    slower = make_env(f"{file}:speed=1.0", 1)
    assert slower.reset()["agents", "pref_speed"].flatten().tolist() == pytest.approx([1.0, 0.8])


def test_people_pass_the_door_of_a_map_beside_the_file(tmp_path, rooms: str) -> None:
    """Nobody has come through a wall: who has no free floor behind them stands at first."""
    file = write(tmp_path / "mine.yaml", people=[ANNA, BEN], map=rooms)
    assert bool((make_env(file).reset()["agents", "velocity"] == 0).all())
    walked, _ = rollout("go_to_goal", file, "compiled", 2)
    assert bool((walked.reached[:, :, -1] == 1).all())


def test_a_place_at_a_wall_is_moved_with_a_warning(tmp_path, rooms: str) -> None:
    for end in ("from", "to"):
        file = write(tmp_path / "mine.yaml", **in_rooms(ANNA, end, 3.0, 3.8))
        with pytest.warns(UserWarning, match=rf"person 1: {end}: \(3.00, 3.80\) is less than 0.25 m") as said:
            make_env(file)
        assert len(said) == 1


def test_a_table_says_that_no_warm_start_moved_people() -> None:
    with Comparison(["go_to_goal"], "custom", "compiled", 1) as comparison:
        assert comparison.report()["protocol"]["warm_start"] == "recorded"


def test_a_robot_takes_the_place_of_the_last_person(tmp_path) -> None:
    file = write(tmp_path / "mine.yaml", people=[ANNA, BEN])
    env = pedzoo.make_robot_env(file, "disc", "orca", 1)
    history = env.reset()["agents", "history"][0]
    assert history[1].tolist() == [[7.0, 3.0]] * 8 and history[0, -1].tolist() == [1.0, 2.0]
    with pytest.raises(UserError, match="1 people and 2 robots: robots take the places of the last people"):
        pedzoo.make_robot_env(write(tmp_path / "one.yaml", people=[ANNA]), ["disc", "disc"], "orca", 1)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"peple": [ANNA]}, "unknown key of scenario .*mine.yaml 'peple': did you mean 'people'"),
        ({"map": "flat"}, r"mine.yaml: no people: expected people: \[\{from"),
        ({"people": []}, r"mine.yaml: people: \[\]: expected people"),
        ({"people": [ANNA, {**BEN, "too": 1}]}, "unknown key of person 2 'too': did you mean 'to'"),
        ({"people": [{"from": [0, 0]}]}, r"person 1: no to: expected \{from: \[x, y\]"),
        ({"people": [{**ANNA, "to": [1, 2, 3]}]}, r"person 1: to: \[1, 2, 3\]: expected"),
        ({"people": [{**ANNA, "to": [1, float("nan")]}]}, r"person 1: to: \[1, nan\]: expected"),
        ({"people": [{**ANNA, "speed": "fast"}]}, "person 1: speed 'fast': expected at least 0.3 m/s"),
        ({"people": [ANNA, {**ANNA, "to": [0, 0]}]}, "persons 1 and 2 start 0.00 m apart"),
        ({"people": [ANNA], "speed": "fast"}, "custom:speed='fast': expected float"),
        (in_rooms(ANNA, "from", 4.0, 0.5), r"person 1: from: \(4.00, 0.50\) is inside a wall"),
        (in_rooms(ANNA, "to", 9.0, 9.0), r"person 1: to: \(9.00, 9.00\) is inside a wall .* or outside it"),
        (in_rooms(ANNA, "to", 10.0, 2.0), r"person 1: no way from \(1.00, 2.00\) to \(10"),
        ({"people": [ANNA], "map": "no.yaml"}, "no.yaml"),
        ({"image": "a.png", "resolution": 0.05, "origin": [0, 0, 0]}, "is a floor plan, .* write goals:map"),
    ],
)
def test_mistakes_in_the_file(keys: dict[str, Any], message: str, tmp_path, rooms: str) -> None:
    with pytest.raises(UserError, match=message) as error:
        make_env(write(tmp_path / "mine.yaml", **keys))
    assert "\n" not in str(error.value)


def test_wrong_scenario_files_are_refused(tmp_path) -> None:
    for text, message in (("people: [", "is no YAML"), ("- 1", r"expected people: \[")):
        (tmp_path / "mine.yaml").write_text(text)
        with pytest.raises(UserError, match=message):
            make_env(f"{tmp_path}/mine.yaml")
    with pytest.raises(UserError, match=r"scenario 'no.yaml' cannot be read: No such file"):
        make_env("no.yaml")


def test_the_keys_are_the_settings_of_the_scenario() -> None:
    assert set(KEYS) == set(setting_types(Custom))
    made = make_env(Spec("custom", {"people": SWAP, "speed": 1.0}))
    assert made.prepared.people == 2


HALF = """
import torch
from pedzoo.sim.scenario import Layout, Scenario


class NoLayout(Scenario):
    def plans(self):
        return []


class OtherPlan(NoLayout):
    def layout(self, prepared, draws):
        scenes = len(draws.key)
        mask = torch.ones(scenes, self.people, dtype=torch.bool)
        start = torch.zeros(scenes, self.people, 2)
        goal = torch.zeros(scenes, self.people, dtype=torch.long)
        return Layout(torch.full((scenes,), 7), start, mask, self.speeds(draws), goal)


class Nowhere(OtherPlan):
    def layout(self, prepared, draws):
        layout = super().layout(prepared, draws)
        return layout._replace(start=layout.start / 0)


class Unhurried(OtherPlan):
    def layout(self, prepared, draws):
        layout = super().layout(prepared, draws)
        return layout._replace(pref_speed=layout.pref_speed / 0)


class Forgetful(NoLayout):
    def layout(self, prepared, draws):
        pass
"""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("NoLayout", r"NoLayout has no layout: a Scenario needs layout\(self, prepared: .*pedzoo\.sim\.scen"),
        ("OtherPlan", r"map_id 7 in the layout of OtherPlan: expected -1 for open floor: OtherPlan\.plans"),
        ("Nowhere", "start of an agent in the layout of Nowhere is not finite: expected a number"),
        ("Unhurried", "pref_speed of an agent in the layout of Unhurried is not finite"),
        ("Forgetful", r"Forgetful\.layout returned NoneType: expected a pedzoo\.sim\..*\.Layout"),
    ],
)
def test_mistakes_in_a_class(name: str, message: str, tmp_path) -> None:
    (tmp_path / "half.py").write_text(HALF)
    with pytest.raises(UserError, match=message) as error:
        make_env(f"{tmp_path}/half.py:{name}:people=1").reset()
    assert "\n" not in str(error.value)
