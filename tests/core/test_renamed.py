"""Old spellings: ``world`` for ``physics``, ``grid`` for ``compiled``; each is told once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core import renamed
from pedzoo.core.errors import UserError
from pedzoo.eval.card_reports import Job, report_of
from pedzoo.eval.closed_loop import Comparison
from pedzoo.eval.rollout import rollout
from pedzoo.eval.suite import Request
from pedzoo.sim.physics.compiled import Compiled
from pedzoo.train.validation.closed_loop import ClosedLoopValidation


@pytest.fixture(autouse=True)
def unsaid() -> Iterator[None]:
    renamed.say.cache_clear()
    yield
    renamed.say.cache_clear()


def test_python_takes_the_old_spelling_and_tells_the_new_one_once(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        env = pedzoo.make_env("door", world="grid")
        assert type(env.physics) is Compiled
    assert capsys.readouterr().err == "pedzoo: world='grid' is now physics='compiled'\n"
    _, env = rollout("go_to_goal", "circle:people=2", world="grid", episodes=1)
    assert type(env.physics) is Compiled and capsys.readouterr().err == ""
    assert type(pedzoo.make_env("door", physics="grid").physics) is Compiled
    assert capsys.readouterr().err == "pedzoo: physics 'grid' is now 'compiled'\n"
    with pytest.raises(UserError, match="leave out world"):
        pedzoo.make_env("door", physics="torch", world="grid")


def test_protocols_say_it_anew() -> None:
    old: dict[str, Any] = {"world": "grid"}
    with Comparison(["go_to_goal"], "circle:people=2", episodes=1, **old) as comparison:
        assert comparison.report()["protocol"]["physics"] == "compiled"
    report = pedzoo.evaluate(["go_to_goal"], ["door"], episodes=1, **old)
    assert report["protocol"]["physics"] == "compiled" and "world" not in report["protocol"]
    assert report["rows"][0]["case"] == {"suite": "door", "physics": "compiled"}


@pytest.mark.parametrize("words", [["--world", "grid"], ["--world=grid"]])
def test_commands_take_it(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "out.json"
    walk = ["rollout", "go_to_goal", "--scenario", "circle:people=2", "--episodes", "1"]
    assert main([*walk, *words, "--json", str(file)]) == 0
    assert capsys.readouterr().err == "pedzoo: --world grid is now --physics compiled\n"
    assert json.loads(file.read_text())["protocol"]["physics"] == "compiled"


def test_configs_take_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert ClosedLoopValidation(["door"], world="grid").physics == "compiled"
    assert ClosedLoopValidation(["door"]).physics == "compiled"
    with pytest.raises(UserError, match="did you mean 'bullet'"):
        ClosedLoopValidation(["door"], world="bulet")


def test_cards_are_measured_again_by_it() -> None:
    protocol: dict[str, Any] = {"suites": ["door"], "episodes": 2, "world": "grid"}
    old = report_of("evaluate", Job("bent_line", protocol, [0]))
    new = report_of(
        "evaluate", Job("bent_line", {"suites": ["door"], "episodes": 2, "physics": "compiled"}, [0])
    )
    for report in (old, new):
        assert report["protocol"]["physics"] == "compiled"
    assert old["rows"][0]["metrics"] == new["rows"][0]["metrics"]
    assert "world" not in Request._fields
