"""The command and its page, and what kills are measured by."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
import torch

from pedzoo.core.configs import load_config
from pedzoo.core.paths import config_names
from tools.reliability import __main__ as command
from tools.reliability import fuzz, kills, long_run, suite
from tools.reliability.kills import difference


@pytest.fixture
def little(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Parts that do nothing but say that they were called; readers complain once."""
    called: list[str] = []

    def fuzzed(name: str, inputs: int, done: dict[str, object], save: object) -> None:
        called.append(f"fuzz:{name}")
        done |= {"inputs": inputs, "read": inputs // 2, "complaints": {"ros-1": "ValueError: 7"}}

    one = {"kills": 2, "not ended by itself": 0, "wrong": ""}
    runs = [{"warm": {"done": 60, "memory": 100, "handles": 5}, "answers": ["a"]}]
    runs[0]["last"] = {"done": 200, "memory": 103, "handles": 5}
    monkeypatch.setattr(fuzz, "go_on", fuzzed)
    monkeypatch.setattr(kills, "go_on", lambda kind, number, done, save: done.append(one))
    monkeypatch.setattr(long_run, "go_on", lambda name, wanted, done, save: done.extend(runs))
    tests = {"tests": 5, "failed": ["test_x"]}
    monkeypatch.setattr(command, "attack", lambda done, quick: done.update({"two at once": tests}))
    monkeypatch.setattr(
        command.Run, "elsewhere", lambda run, one: command.main(["--to", str(run.folder), one])
    )
    return called


def test_what_was_done_is_kept_and_what_was_lost_is_told(
    little: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    to = ["--to", str(tmp_path)]
    assert command.main(["fuzz:ros", *to]) == 0 and little == ["fuzz:ros"]
    assert command.main(["kills:sgan", "long:comings", "suite", *to]) == 1
    text = (tmp_path / "RELIABILITY.md").read_text()
    assert "| ros | 100,000 | 50% | ValueError |" in text and "are wanted, and done" in text
    assert "| sgan | 1 of 10 | 2 | 0 | 0 |" in text and "| two at once | 5 | test_x |" in text
    assert "| comings | 200 of 2,000 | 1 | 3.00% over 140 | 0 | the same |" in text
    lost = capsys.readouterr().out.splitlines()[-3:]
    assert lost[:2] == ["two at once: test_x", "ros-1: ValueError: 7"] and "something grew" in lost[2]
    assert [*json.loads((tmp_path / "RELIABILITY.json").read_text())] == ["suite", "fuzz", "kills", "long"]


def test_words_that_are_no_parts_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for word, known in (("fuz", "suite, fuzz, kills, long"), ("long:walks", "comings, torch, bullet")):
        with pytest.raises(SystemExit):
            command.main([word])
        assert f"'{word}': expected one of {known}" in capsys.readouterr().err


def test_a_mended_complaint_is_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "CORPUS", tmp_path)
    (tmp_path / "homography-1").write_bytes(b"no numbers")
    done = {"inputs": 5, "read": 1, "complaints": {"homography-1": "ValueError: 7"}}
    fuzz.go_on("homography", 8, done, lambda: None)
    assert done["inputs"] == 8 and done["complaints"] == {}


def test_attacks_are_tests_of_the_suite() -> None:
    for node in (node for kind in suite.ATTACKS.values() for node in kind):
        file, _, test = node.partition("::")
        assert f"def {test}(" in (suite.ROOT / file).read_text() if test else (suite.ROOT / file).is_file()
    case = ElementTree.Element("testcase", classname="tests.train.test_signals", name="test_x[7]")
    assert suite._is(case, "tests/train/test_signals.py::test_x")
    assert suite._is(case, "tests/train/test_signals.py")
    assert not suite._is(case, "tests/train/test_signals.py::test_y")


def test_every_trainer_is_killed() -> None:
    def trainer(config: str) -> str:
        return load_config(config)["model"]["class_path"]

    killed = {words[words.index("--config") + 1] for words in kills.TRAININGS.values()}
    assert {*map(trainer, killed)} == {*map(trainer, config_names())}


def test_what_a_kill_has_changed_is_told(tmp_path: Path) -> None:
    runs = tmp_path / "one", tmp_path / "two"
    for run in runs:
        (run / "checkpoints").mkdir(parents=True)
        torch.save({"state_dict": {"w": torch.ones(2)}}, run / "checkpoints" / "last.ckpt")
        (run / "metrics.csv").write_text("epoch,loss\n0,1\n")
    assert difference(*runs) == ""
    (runs[1] / "metrics.csv").write_text("epoch,loss\n0,1\n0,1\n")
    assert difference(*runs) == "metrics.csv"
    (runs[0] / "metrics.csv").write_text("epoch,samples_per_s\n0,7\n")
    (runs[1] / "metrics.csv").write_text("epoch,samples_per_s\n0,8\n")
    assert difference(*runs) == ""
    torch.save({"state_dict": {"w": torch.tensor([1, 1.0000001])}}, runs[1] / "checkpoints" / "last.ckpt")
    assert difference(*runs) == "weights ['w']"
