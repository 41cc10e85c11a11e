"""What controllers have to show: choices and targets by hand, cases, and the page that people read."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.walks import made, straight
from msgspec.structs import replace

from pedzoo.core.paths import CARD, shipped
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.suites.scenes import DRAWN
from pedzoo.metrics.ratios import summarised
from pedzoo.models.zoo.card import ModelCard, read_card, write_card
from pedzoo.sim.make import make_scenario
from tools.paper.loop import BASELINES, FORCE, ORCA, Loop, Target, _plans, forecasts, targets, verdict
from tools.paper.meetings import (
    OUTCOMES,
    bearing_sweep,
    first_through,
    outcome_ratios,
    outcomes,
    passing_side,
    varied,
)
from tools.paper.suites import DRAWS, OFFICES, LoopBuildings, LoopDoors, LoopNoise, LoopReplay

NAN = float("nan")
GATE = torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.85]], dtype=torch.float64)


def named(**metrics: float) -> dict[str, Any]:
    return {"metrics": metrics}


def meeting(lateral: float, late: int = 0) -> torch.Tensor:
    """Two people (1, 2, 81, 2) towards each other along x, the second ``lateral`` metres to its left."""
    first, second = straight(1.3, 80, (-4.0, 0.0)), straight(1.3, 80, (-4.0, -lateral))
    second = torch.cat((second[:1].expand(late, 2), second))[:81]
    return torch.stack((first, -second)).unsqueeze(0)


def test_who_passes_a_door_first() -> None:
    stays = meeting(0.3, 10)
    for path, first in ((stays, 0.0), (stays.flip(1), 0.0), (-stays, 1.0)):  # however numbered
        assert first_through(made(path, gate=GATE)).tolist() == [first]
    stays[:, 1] = stays[:, 1, :1]
    assert math.isnan(first_through(made(stays, gate=GATE)))
    with pytest.raises(ValueError, match="has none"):
        first_through(made(meeting(0.3)))


@pytest.mark.parametrize("angle", [0.0, 1.0, 3.0])
def test_passing_side_does_not_depend_on_the_frame(angle: float) -> None:
    turn = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]).double()
    for lateral, side in ((0.4, 1.0), (-0.4, 0.0)):
        path = meeting(lateral) @ turn
        assert passing_side(made(path)).tolist() == [side]
        assert passing_side(made(path.flip(1))).tolist() == [side]
    # they are not past each other yet, or one arrives before
    assert math.isnan(passing_side(made(meeting(0.4)[:, :, :25])))
    early = (torch.arange(80) >= 10).long().expand(1, 2, 80)
    assert math.isnan(passing_side(made(meeting(0.4), reached=early)))


def test_variety_by_hand() -> None:
    """Three of four draws agree in the first scene, all in the second; of the others too little is known."""
    settled = torch.tensor([[1, 1, 0, 1], [0, 0, 0, NAN], [1, NAN, NAN, NAN], [NAN] * 4]).double()
    result, intervals = summarised(varied(settled))
    assert result["varied"] == 0.5 and result["settled"] == pytest.approx(8 / 16)
    assert result["disagreement"] == pytest.approx((3 / 6 + 0) / 2)  # 3 of 6 pairs
    assert intervals["varied"][0] < 0.5 < intervals["varied"][1]


def test_targets_by_numbers_and_by_what_others_have() -> None:
    rows = {"mine": named(a=0.99, b=2.0), "one": named(a=0.5, b=1.0), "two": named(b=4.0)}
    assert Target("a", "at least", 0.99).met("mine", rows)
    assert not Target("a", "above", 0.99).met("mine", rows)
    mean = Target("b", "below", others=("one", "two"))
    least = mean._replace(of="least")
    assert mean.limit(rows) == 2.5 and mean.met("mine", rows) and least.limit(rows) == 1.0
    assert not least.met("mine", rows) and Target("b", "at most", 2, ("one",)).met("mine", rows)
    assert mean.text == "b below the mean of one, two" and least.text == "b below the least of one, two"
    assert Target("b", "at most", 1.1, ("one",)).text == "b at most 1.1 x one"
    unknown = Target("a", "at most", others=("two",))
    assert unknown.limit(rows) is None and unknown.met("mine", rows) is None
    assert verdict([mean], "mine", rows) == "met"
    assert verdict([mean, least], "mine", rows) == "b 2.000, not below 1.000"
    assert verdict([Target("a", "at least", 0.9)], "two", rows) == "a -, not at least 0.900"
    assert verdict([unknown], "mine", rows) == "nothing to compare a with"


def test_every_case_has_targets_and_its_scenario_can_be_made() -> None:
    usual = EvaluationOptions()
    cases = LoopDoors("loop_doors").cases(usual) + LoopNoise("loop_noise").cases(usual)
    assert [case.episodes for case in cases[:3]] == [1000, 500, 500]
    for case in cases:
        assert targets(case.table) and make_scenario(case.scenario).people >= 2
    assert {case.physics for case in cases[:7]} == {"bullet"}
    buildings = LoopBuildings("loop_buildings").cases(EvaluationOptions(maps=("flat",), quick=True))
    tables = list(dict.fromkeys(case.table for case in buildings))
    assert tables == [f"loop_buildings {name}" for name in ("drawn", "flat", "crowd of 20", "crowd of 50")]
    assert [t.key for t in targets(tables[0])] == [t.key for t in targets(tables[1])] != targets(tables[2])
    recorded = LoopReplay("loop_replay")
    assert "walk 3 x where all are simulated; others once" in recorded.notes(EvaluationOptions(), [])[1]
    folds = recorded.cases(EvaluationOptions(quick=True))
    assert all(case.case["simulated"] == "all" and targets(case.table)[0].key == "realism" for case in folds)
    assert {ORCA, FORCE} <= set(BASELINES)


def test_training_sees_none_of_the_floor_plans_of_the_tests() -> None:
    configs = list((Path(__file__).parents[2] / "configs" / "closed_loop").glob("*.yaml"))
    seen = set(re.findall(r"\b(?:apartment|office)\.\d+", " ".join(file.read_text() for file in configs)))
    assert not seen & {*DRAWN, *OFFICES}
    config = {"a": [{"scenario": "goals:map=[one.1,two.yaml],people=3"}, "goals:map=three"], "b": "door"}
    assert _plans(config) == ["one.1", "two.yaml", "three"]


def test_noise_changes_what_draws_do_in_the_same_scenes(monkeypatch) -> None:
    monkeypatch.setattr("tools.paper.suites.DRAWS", 3)
    suite = LoopNoise("loop_noise")
    case = suite.cases(EvaluationOptions(episodes=4))[1]
    names = ["go_to_goal", "sgan_goal.eth_ucy", "orca"]
    assert suite.units(case, names, (0,), True) == []
    (unit,) = suite.units(case, names, (0,), False)  # of those with noise
    assert unit.policy == "sgan_goal.eth_ucy"
    shares: list[float] = []
    (row,) = suite.rows(unit, shares.append)
    assert row["n"] == 4 and row["draws"] == 3 and shares[-1] == 1.0
    result = row["metrics"]
    assert set(result) == set(suite.columns) and result["settled"] > 0
    assert 0 <= result["clean"] <= result["contact_free"] <= 1
    assert (result["varied"] > 0) == (result["disagreement"] > 0)
    json.dumps(row, allow_nan=False)


def test_page_says_what_is_met_and_what_is_missing(monkeypatch) -> None:
    monkeypatch.setattr(Loop, "baselines", ())
    loop = Loop(models=["go_to_goal"], options=EvaluationOptions(quick=True))

    def scored(name: str, table: str, **metrics: float) -> dict[str, Any]:
        case = {"suite": table.split()[0], "physics": "compiled"}
        return {"name": name, "table": table, "case": case, "n": 3, "metrics": metrics, "ci95": {},
                "seconds": {"cpu": 7.4, "wall": 9.0}}  # fmt: skip

    door = "loop_doors varied"
    rows = [
        scored("mine", door, clean=0.997, time_ratio_median=1.05),
        scored(ORCA, door, clean=0.7, time_ratio_median=1.02),
        scored("mine", "loop_noise passing side", varied=0.1),
        scored("real", "loop_replay embedded", realism=0.0),
    ]
    overview, varied_door, *_ = pages = loop.pages({"summary": rows})
    assert len(pages) == 4 and overview.head == ["case", "target", "mine", ORCA]
    assert overview.rows[0] == ["doors: varied", "clean at least 0.995", "0.997 met", "0.700"]
    assert overview.rows[2][2:] == ["0.100", "-"]
    assert "clean at least 0.995; time_ratio_median at most 1.1" in varied_door.title
    assert varied_door.rows[0] == ["mine", "met", "3", "1.00", "1.05", "7"]
    assert varied_door.rows[1][1] == "clean 0.700, not at least 0.995"
    assert pages[-1].rows[0][1] == ""  # recorded people have nothing to show
    assert loop.pages({"summary": []}) == []
    assert f"walked {DRAWS} times" in " ".join(loop.notes()) and "office.2" in loop.notes()[1]
    given = Loop(models=["go_to_goal"], options=EvaluationOptions(quick=True, maps=("flat", "office.7")))
    assert "those that were given: flat, office.7" in given.notes()[1]


def test_forecasts_stand_beside_those_of_the_weights_before(tmp_path, monkeypatch) -> None:
    cards = [shipped("checkpoints") / f"sgan_goal_map.{tag}" / CARD for tag in ("zara1", "zara2")]
    before, after = map(read_card, cards)
    reports = [one for one in before.evaluations if one["command"] == "forecast"]

    def write(card: ModelCard, name: str, factor: float, **training: Any) -> None:
        result = []
        for one in reports:
            rows = [row | {"metrics": {"ade_m": factor * row["metrics"]["ade_m"]}} for row in one["rows"]]
            result.append(one | {"rows": rows})
        known = card.training | training
        write_card(replace(card, name=name, training=known, evaluations=result), tmp_path / name / CARD)

    write(before, "sgan_goal_map.before", 1.0)
    write(after, "sgan_goal_map.good", 1.1, overrides={"weights": "sgan_goal_map.before"})
    write(after, "sgan_goal_map.bad", 1.2, overrides={"weights": "sgan_goal_map.before"})
    write(after, "sgan_goal_map.alone", 1.2)
    monkeypatch.setenv("PEDZOO_ZOO", str(tmp_path))
    names = [f"sgan_goal_map.{tag}" for tag in ("before", "good:safety=false", "bad", "alone")]
    page = forecasts([*names, "go_to_goal", "orca:radius=0.3"])
    assert page is not None and len(page.rows) == 2 * len(reports)
    verdicts = {row[0]: row[2] for row in page.rows}
    assert verdicts == {"sgan_goal_map.good": "met", "sgan_goal_map.bad": "1.200, not at most 1.15"}
    assert all(row[4] == "sgan_goal_map.before" for row in page.rows)
    assert forecasts(["go_to_goal"]) is None


# How two get past each other at a door


def test_bearing_turns_while_two_are_close() -> None:
    """The second walks a quarter around the first at 0.5 m, with steps at 3 m that do not count."""
    far, angles = [[0.0, -3.0], [3.0, 0.0]], torch.linspace(0, math.pi / 2, 10)
    close = 0.5 * torch.stack((angles.cos(), angles.sin()), dim=-1)
    second = torch.cat((torch.tensor(far), close)).unsqueeze(0)
    trace = torch.stack((torch.zeros_like(second), second), dim=1)
    both = torch.ones(1, 12, dtype=torch.bool)
    assert float(bearing_sweep(trace, both)) == pytest.approx(math.pi / 2, abs=1e-5)
    back = torch.cat((trace, trace.flip(2)), dim=2)
    assert float(bearing_sweep(back, both.repeat(1, 2))) == pytest.approx(0.0, abs=1e-5)
    assert float(bearing_sweep(trace * 9, both)) == math.inf


def test_every_episode_has_one_outcome() -> None:
    nan = math.inf
    arrived = torch.tensor([False, False, True, True, True, True])
    stuck = torch.tensor([True, False, False, False, False, False])
    least = torch.tensor([1.0, 0.4, 0.1, 0.2, 0.5, nan])
    sweep = torch.deg2rad(torch.tensor([0.0, 170.0, 170.0, 120.0, 60.0, nan]))
    result = outcomes(arrived, stuck, least, sweep, torch.full((6,), 0.15))
    names = [next(name for name in OUTCOMES if result[name][i]) for i in range(6)]
    assert names == ["blocked", "lost", "through", "circle", "pass", "pass"]
    assert torch.stack(list(result.values())).sum(0).tolist() == [1] * 6


@pytest.mark.parametrize(("aside", "expected"), [(0.02, "through"), (0.1, "circle"), (0.4, "pass")])
def test_outcome_of_two_who_walk_straight_through_a_door(aside: float, expected: str) -> None:
    """They pass at 0.04, 0.2 and 0.8 m; the bearing turns by 2 acos(0.2 / 0.6) = 141 degrees at 0.2 m."""
    x = torch.linspace(-2, 2, 401)
    first = torch.stack((x, torch.full_like(x, aside)), dim=-1)
    path = torch.stack((first, -first)).unsqueeze(0)
    reached = torch.zeros(1, 2, 400, dtype=torch.long)
    reached[..., -1] = 1
    rollout = made(path, reached=reached, gate=torch.tensor([[0.0, 0.0, 1.0, 0.0, 0.85]]))
    metrics, _ = summarised(outcome_ratios(rollout))
    assert {name for name in OUTCOMES if metrics[f"outcome_{name}"] == 1} == {expected}
    if expected == "circle":
        assert metrics["bearing_sweep_deg"] == pytest.approx(math.degrees(2 * math.acos(1 / 3)), abs=2)
    alone = made(path[:, :1], reached=reached[:, :1], gate=rollout.gate)
    assert summarised(outcome_ratios(alone))[0]["outcome_pass"] == 1
