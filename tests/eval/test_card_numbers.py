"""Numbers on model cards: what is measured, when it is the same, and the command that does all again."""

import json
import shutil
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval import cards as card_numbers
from pedzoo.eval.cards import Job, compare, measure, report_of
from pedzoo.eval.forecast import forecast
from pedzoo.models.zoo.card import ModelCard, read_card, write_card
from pedzoo.models.zoo.store import find, weights_of

NAME = "sgan_goal.zara1"
DOOR = {"suites": ["door"], "episodes": 3, "physics": "compiled"}


@pytest.fixture(autouse=True)
def nothing_at_hand(elsewhere, monkeypatch) -> None:
    """No recordings but the embedded ones, and few samples and walks."""
    monkeypatch.delenv("PEDZOO_DATA", raising=False)
    monkeypatch.setenv("PEDZOO_HOME", str(elsewhere / "home"))
    monkeypatch.setattr(card_numbers, "SAMPLES", 2)
    monkeypatch.setattr(card_numbers, "WALKS", [DOOR])


@pytest.fixture(scope="module")
def reports() -> dict[str, Any]:
    """What was measured of a model without its recordings, and what was said meanwhile."""
    return {}


@pytest.fixture
def measured(reports: dict[str, Any]) -> list[dict[str, Any]]:
    if not reports:
        reports["said"] = []
        reports["made"] = measure(NAME, tell=reports["said"].append, commands=("forecast", "evaluate"))
    return deepcopy(reports["made"])


def card_with(reports: list[dict[str, Any]], folder: str = "zoo") -> str:
    """Put the model into a folder, with a card that has these reports; return its name."""
    entry = find(NAME)
    assert entry
    own = Path(folder) / NAME
    write_card(replace(entry.card, evaluations=reports), own / "card.yaml")
    shutil.copy(weights_of(entry), own)
    return f"{folder}/{NAME}"


def again(capsys: pytest.CaptureFixture[str], name: str, *more: str) -> tuple[int, str]:
    capsys.readouterr()
    code = main(["evaluate", name, "--from-card", *more])
    return code, capsys.readouterr().out


def test_a_card_gets_what_the_commands_say(measured: list[dict[str, Any]], reports: dict[str, Any]) -> None:
    forecasts, walks = measured
    data = TrajectoryDataModule(fold="embedded", goal="window_end")
    report = forecast([NAME], data, samples=2)
    assert forecasts["protocol"] == report["protocol"] and forecasts["seeds"] == report["seeds"] == [0]
    (row,) = forecasts["rows"]
    assert row["name"] == NAME and row["n"] == report["rows"][1]["n"]
    assert row["metrics"] == pytest.approx(report["rows"][1]["metrics"], rel=1e-5)
    walked = pedzoo.evaluate([NAME], ["door"], episodes=3, physics="compiled")["summary"][0]
    (row,) = walks["rows"]
    assert row["case"] == {"suite": "door", "physics": "compiled"} and row["n"] == 3
    shown = {key: walked["metrics"][key] for key in row["metrics"]}
    assert row["metrics"] == pytest.approx(shown, rel=1e-5) and {"success", "time_ratio"} <= shown.keys()
    (said,) = reports["said"]  # the fold that its weights did not see
    assert said.startswith("not measured, zara1 test: ") and "PEDZOO_DATA" in said


def test_weights_of_all_scenes_have_validation_windows(shared: Path, monkeypatch) -> None:
    monkeypatch.setattr(card_numbers, "WALKS", [])
    result = measure("sgan_goal.eth_ucy", "mine.all", root=str(shared / "data"))
    assert [report["command"] for report in result] == ["inputs", "forecast", "forecast"]
    assert [report["protocol"]["fold"] for report in result] == ["eth_ucy", "eth_ucy", "embedded"]
    assert result[0]["protocol"]["split"] == "val" and result[0]["protocol"]["clock"] == "true"
    assert {row["name"] for report in result for row in report["rows"]} == {"mine.all"}
    entry = find("sgan_goal.eth_ucy")
    assert entry
    # by which these weights were chosen
    assert result[1]["rows"][0]["metrics"]["ade_m"] == pytest.approx(entry.card.training["value"], 1e-3)


def test_the_numbers_of_a_card_are_found_again_or_not(measured: list[dict[str, Any]], capsys) -> None:
    code, printed = again(capsys, card_with(measured), "--json", "again.json")
    count = sum(1 + len(row["metrics"]) for report in measured for row in report["rows"])
    assert code == 0 and f"zoo/{NAME}: {count} of {count} numbers are those of the card" in printed
    report = json.loads(Path("again.json").read_text())
    assert report["command"] == "evaluate" and report["protocol"] == {"from_card": [f"zoo/{NAME}"]}
    assert [row["case"]["evaluation"] for row in report["rows"]] == ["embedded test", "door"]
    for row, before in zip(report["rows"], measured, strict=True):
        assert row["card"] == before["rows"][0]["metrics"] == pytest.approx(row["metrics"], rel=1e-5)
        assert set(row["same"].values()) == {True}
    measured[0]["rows"][0]["metrics"]["ade_m"] *= 1.01
    code, printed = again(capsys, card_with(measured[:1]))
    (line,) = [line for line in printed.splitlines() if " NO " in line]
    assert code == 1 and "ade_m" in line and "13 of 14 numbers" in printed


def test_what_cannot_be_done_here_is_skipped_and_says_why(measured: list[dict[str, Any]], capsys) -> None:
    elsewhere = deepcopy(measured[0])
    elsewhere["protocol"]["fold"] = "zara1"
    code, printed = again(capsys, card_with([elsewhere, measured[0]]))
    assert code == 0 and "zara1 test: skipped, no recordings" in printed and "14 of 14 numbers" in printed
    assert "pedzoo download eth_ucy" in printed
    code, printed = again(capsys, card_with([elsewhere]))
    assert code == 1 and "nothing of its card could be done again" in printed
    older = measured[0] | {"command": "measure", "versions": {"torch": "1.0"}}
    code, printed = again(capsys, card_with([older]))
    assert code == 1 and "no way to do 'measure' again: expected forecast or inputs or evaluate" in printed
    del measured[0]["protocol"]["goal"], measured[0]["protocol"]["samples"]
    code, printed = again(capsys, card_with([measured[0]]))
    assert code == 1 and "protocol of forecast: Object missing required field `goal`" in printed


FORECAST = {"samples": 2, "split": "test"}
DOOR_ALONE = {"suites": ["door"]}


@pytest.mark.parametrize(
    ("usual", "changed", "message"),
    [
        (FORECAST, {"split": "all"}, "unknown split 'all'"),
        (FORECAST, {"clock": "tru"}, "unknown clock 'tru': did you mean 'true'"),
        (FORECAST, {"samples": "many"}, "protocol of forecast.samples: Expected `int`, got `str`"),
        (FORECAST, {"fold": "own.py:Mine:a"}, "own.py:Mine:a' is in a file of code, and no other file"),
        (DOOR_ALONE, {"suites": ["own.py:Mine"]}, "protocol of evaluate: 'own.py:Mine' is in a file of code"),
        (DOOR_ALONE, {"people": ["orca", "own.py:Mine"]}, "'own.py:Mine' is in a file"),
        (DOOR_ALONE, {"robot": "own.py:Mine:radius=1"}, "with pedzoo evaluate"),
        (DOOR_ALONE, {"physics": "own.py:Mine"}, "'own.py:Mine' is in a file"),
        (DOOR_ALONE, {"suites": ["suite"]}, "unknown suite 'suite'"),
        (DOOR_ALONE, {"suites": "door"}, "protocol of evaluate.suites: Expected `array`, got `str`"),
        (DOOR_ALONE, {"quick": "yes"}, "protocol of evaluate.quick: Expected `bool`, got `str`"),
        (DOOR_ALONE, {"episodes": "few"}, "protocol of evaluate.episodes: Expected `int`, got `str`"),
    ],
)
def test_a_strange_protocol_is_refused_and_runs_nothing(
    usual: dict[str, Any], changed: dict[str, Any], message: str
) -> None:
    Path("own.py").write_text("raise SystemExit('this must not run')")
    data = TrajectoryDataModule(fold="embedded").protocol if usual is FORECAST else {}
    with pytest.raises(UserError, match=message):
        command = "forecast" if usual is FORECAST else "evaluate"
        report_of(command, Job("constant_velocity", data | usual | changed, [0]))


def test_who_has_no_card_or_asks_for_something_else_is_refused(refused) -> None:
    for words, message in (
        (["orca"], "unknown model with a card 'orca'"),
        (["sgan_goal.zara11"], "did you mean 'sgan_goal.zara1'"),
        ([NAME, "--suite", "door"], "--suite: --from-card does what the card says"),
        ([card_with([])], "has no evaluations"),
    ):
        assert message in refused("evaluate", *words, "--from-card")


def report(command: str, n: int = 20, **numbers: tuple[float, list[float] | None]) -> dict[str, Any]:
    """Return a report of one row with these numbers and intervals."""
    intervals = {key: ends for key, (_, ends) in numbers.items() if ends}
    metrics = {key: value for key, (value, _) in numbers.items()}
    row = {"name": "a.b", "case": {"suite": "door"}, "n": n, "metrics": metrics, "ci95": intervals}
    return {"command": command, "rows": [row]}


@pytest.mark.parametrize(
    ("command", "card", "ends", "now", "same"),
    [
        ("forecast", 0.2, None, 0.2001, True),
        ("forecast", 0.2, None, 0.2003, False),
        ("forecast", 0.2, [0.1, 0.3], 0.2003, False),  # its interval is about other recordings
        ("forecast", 0.0009, None, 0.000909, True),  # a hundredth of a millimetre
        ("evaluate", 0.9, [0.8, 0.95], 0.8, True),
        ("evaluate", 0.9, [0.8, 0.95], 0.79, False),
        ("evaluate", 2.0, None, 2.001, True),
        ("evaluate", 2.0, None, 2.1, None),
    ],
)
def test_when_a_number_is_the_same(
    command: str, card: float, ends: list[float] | None, now: float, same: bool | None
) -> None:
    count, number = compare(report(command, x=(card, ends)), report(command, x=(now, None)))
    assert (number.card, number.now, number.same) == (card, now, same)
    assert count.metric == "n" and count.same is True


def test_gone_numbers_and_other_numbers_of_episodes_differ() -> None:
    before = report("evaluate", success=(1.0, [0.8, 1.0]), time_ratio=(2.0, None))
    after = report("evaluate", n=19, success=(1.0, None))
    assert [one.same for one in compare(before, after)] == [False, True, False]
    assert {one.now for one in compare(before, after | {"rows": []})} == {None}


def test_the_card_of_a_shipped_model_is_true(capsys) -> None:
    """What needs no recordings and little time; the whole card takes a minute."""
    here = [one for one in shipped().evaluations if one["protocol"].get("fold") == "embedded"]
    here += [one for one in shipped().evaluations if one["protocol"].get("suites") == ["door"]]
    code, printed = again(capsys, card_with(here))
    assert code == 0 and " NO " not in printed and len(here) == 2


def test_the_card_of_a_shipped_model_is_true_on_recordings(capsys, shared: Path) -> None:
    here = [one for one in shipped().evaluations if one["protocol"].get("fold") == "zara1"]
    assert [one["command"] for one in here] == ["inputs", "forecast"]
    code, printed = again(capsys, card_with(here), "--data.root", str(shared / "data"))
    assert code == 0 and "zara1 test" in printed and "44 of 44 numbers" in printed


def shipped() -> ModelCard:
    entry = find(NAME)
    assert entry
    return read_card(entry.path)
