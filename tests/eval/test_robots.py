"""Robots beside the same scenes without them, the suite of robots, and its command."""

import json
from collections.abc import Mapping
from typing import Any

import pytest
import torch
from msgspec.structs import replace

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.eval import cards as card_numbers
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.robots import robot_rollout, robot_row
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.suites import robots as suite
from pedzoo.eval.work_units import digest, work
from pedzoo.metrics.robots import LEGEND
from pedzoo.models.zoo.store import find
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.sim.rollout import RobotRollout

SMALL: Mapping[str, tuple[str, float]] = {
    "open": ("circle:people=3", 4.0),
    "corridor": ("hallway:people=2", 3.0),
}


@pytest.fixture
def small(monkeypatch) -> None:
    """Let the suite have few and quick scenes."""
    monkeypatch.setattr(suite, "SCENES", SMALL)


def driven(policy: str = "straight", scenario: str = "hallway:people=4", **settings: Any) -> RobotRollout:
    settings = {"episodes": 6, "people": "orca"} | settings
    return robot_rollout(policy, scenario, **settings)[0]


def test_both_begin_alike_and_last_as_long() -> None:
    both = driven()
    people = slice(0, 4)
    assert torch.equal(both.walked.past[:, people], both.alone.past[:, people])
    assert torch.equal(both.walked.pref_speed, both.alone.pref_speed)
    assert both.walked.mask[:, -1].all() and not both.alone.present[:, -1].any()
    for episode, length in enumerate(both.walked.length.tolist()):
        assert not both.alone.present[episode, :, length:].any()
        there = both.alone.present[episode, people].any(0)
        assert there[:length].all() or (both.alone.reached[episode, people, length - 1] >= 1).all()
    moved = (both.walked.trace - both.alone.trace)[:, people].norm(dim=-1)
    assert moved[..., 0].max() < 0.2 < moved.max(), "they part little by little"


def test_people_who_heed_no_robot_are_not_delayed() -> None:
    both = driven("straight", people="go_to_goal", ends_at="none")
    row = robot_row("straight", both)
    assert row["metrics"]["delay_s"] == pytest.approx(0.0, abs=1e-4)
    assert row["metrics"]["detour_m"] == pytest.approx(0.0, abs=1e-3)
    assert row["metrics"]["collision_person"] > 0, "it goes through them"


def test_a_robot_that_gives_no_way_delays_people() -> None:
    """It drives through the middle of 1.5 m: people go back, or wait. Standing aside costs them less."""
    drives = robot_row("straight", driven("straight", "hallway:people=4,width=1.5"))["metrics"]
    assert drives["delay_s"] > 0.5 and drives["detour_m"] > 0.3 and drives["person_yields"] == 1
    stands = robot_row("stop", driven("stop", "hallway:people=4,width=1.5", time_limit=4.0))["metrics"]
    assert stands["timeout"] == 1 and stands["success"] == 0
    assert abs(stands["delay_s"]) < drives["delay_s"]
    assert stands["standing_s"] == pytest.approx(stands["duration_s"]) == pytest.approx(4.0)


def test_episodes_are_the_same_however_many_walk_together(monkeypatch) -> None:
    settings = {"scenario": "hallway:people=2", "robot": "turtlebot4", "episodes": 3}
    together = driven(**settings)
    monkeypatch.setattr(Compiled, "scenes_at_once", 2)
    parts = driven(**settings)
    points = min(together.heading.shape[2], parts.heading.shape[2])
    torch.testing.assert_close(together.progress, parts.progress, atol=1e-4, rtol=0)
    torch.testing.assert_close(together.progress_alone, parts.progress_alone, atol=1e-4, rtol=0)
    torch.testing.assert_close(together.heading[..., :points], parts.heading[..., :points], atol=1e-4, rtol=0)
    assert torch.equal(together.walked.length, parts.walked.length)


def test_a_robot_in_a_recording_meets_people_who_do_not_react() -> None:
    both = driven("straight", "replay:fold=embedded,share=0.1", episodes=5)
    first = slice(0, both.walked.mask.shape[1] - 1)
    torch.testing.assert_close(both.walked.trace[:, first], both.alone.trace[:, first])
    metrics = robot_row("straight", both)["metrics"]
    assert "delay_s" not in metrics and "person_yields" not in metrics
    assert metrics["nearest_person_m"] > 0


def test_headings_are_between_decisions() -> None:
    both = driven("orca", "circle:people=2", robot="diff_drive", episodes=2)
    turned = both.heading.diff(dim=-1)
    turned = torch.atan2(turned.sin(), turned.cos()).abs()
    assert turned.max() <= 2.0 * 0.1 + 1e-4, "no faster than the body turns"


def test_the_command_its_table_and_its_page(small: None, tmp_path) -> None:
    file, page = tmp_path / "robots.json", tmp_path / "robots.md"
    command = ["evaluate", "straight", "stop", "--suite", "robots", "--episodes", "2"]
    command += ["--people", "go_to_goal,replay:fold=embedded,share=0.04", "--robot", "diff_drive:radius=0.35"]
    assert main([*command, "--json", str(file), "--markdown", str(page)]) == 0
    report = json.loads(file.read_text())
    assert report["protocol"]["people"] == ["go_to_goal", "replay:fold=embedded,share=0.04"]
    assert report["protocol"]["robot"] == "diff_drive:radius=0.35"
    tables = {row["table"]: row for row in report["summary"] if row["name"] == "straight"}
    assert list(tables) == ["robots go_to_goal", "robots replay:fold=embedded,share=0.04"]
    walked, replayed = tables.values()
    assert (walked["cases"], walked["n"]) == (2, 4)
    assert "delay_s" in walked["metrics"] and "delay_s" not in replayed["metrics"]
    assert {row["case"]["scene"] for row in report["rows"]} == {"open", "corridor", "replay"}
    assert {person["seed"] for row in report["rows"] for person in row["per_agent"]} == {0}
    text = page.read_text()
    assert f"* `success`: {LEGEND['success']}." in text and "share of people who reach" not in text


def test_parts_are_known_by_people_and_body(small: None) -> None:
    def units(**options: Any) -> list[Any]:
        return Evaluation(
            ["stop"], ["robots"], EvaluationOptions(2, people=("orca",))._replace(**options)
        ).units

    first, *_ = units()
    crowd = "orca:share=0.5+social_force:preset=indoor,share=0.5"
    others = [units(people=(crowd,))[0], units(robot="jackal")[0], units()[1]]
    assert len({digest(unit) for unit in [first, *others]}) == 4 and others[0].case.people == crowd
    assert digest(first) == digest(units()[0])
    (row,) = work(first._replace(seeds=(0, 4)))
    assert row["n"] == 4 and [robot["seed"] for robot in row["per_agent"]] == [0, 0, 4, 4]


@pytest.mark.parametrize(
    ("policy", "name", "options", "message"),
    [
        ("stop", "robots", {"people": ("orka",)}, "did you mean 'orca'"),
        ("stop", "robots", {"robot": "husk"}, "husky"),
        ("stop", "robots", {"people": ("replay:fold=embeded",)}, "embedded"),
        ("stop", "robots", {"maps": ("flat",)}, "maps: no use for them in robots"),
        ("strait", "robots", {}, "did you mean 'straight'"),
        ("orca", "door", {"people": ("orca",)}, "people: no use for them in door; robots would have"),
    ],
)
def test_whatever_is_misspelt_is_refused_before_anything_drives(
    policy: str, name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        Evaluation([policy], [name], EvaluationOptions()._replace(**options))


def test_numbers_of_a_robots_card_are_done_again(monkeypatch) -> None:
    monkeypatch.setattr(card_numbers, "ROBOT_EPISODES", 1)
    monkeypatch.setattr(suite, "SCENES", {"open": suite.SCENES["open"]})
    report = card_numbers.measure_robot("robot_ppo.circle", "orca", "disc")
    assert report["protocol"]["people"] == ["orca"] and report["rows"][0]["n"] == 1
    entry = find("robot_ppo.circle")
    assert entry
    (result,) = card_numbers.again(replace(entry.card, evaluations=[report]))
    assert result.now and all(one.same for one in card_numbers.compare(report, result.now))
