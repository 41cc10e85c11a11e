"""Commands and suites of a checkout: absent from a wheel, where cards and all other commands still work."""

from __future__ import annotations

from pathlib import Path

import pytest

from pedzoo.cli.main import main, overview
from pedzoo.core import registry
from pedzoo.core.paths import CARD, shipped, weight_files
from pedzoo.core.registry import SUITES, Registry, folder_of
from pedzoo.eval.cards import about
from pedzoo.models.zoo.card import read_card


@pytest.mark.parametrize("words", [["bench", "loop"], ["bench", "--help"], ["reproduce", "table1"]])
def test_a_wheel_says_how_to_get_a_checkout(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = registry.folder_of
    nowhere = tmp_path / "tools"
    monkeypatch.setattr(registry, "folder_of", lambda name: nowhere if name[:5] == "tools" else folders(name))
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"pedzoo: {words[0]}: needs a checkout") and "run tools/setup" in line


def test_the_overview_has_the_commands_of_a_checkout() -> None:
    assert "pedzoo bench policies" in overview() and "pedzoo reproduce table2" in overview()


def test_a_second_folder_of_drop_ins() -> None:
    assert {"door", "table2"} <= set(SUITES.names())
    assert SUITES.describe("table2").startswith("Table II")
    assert SUITES.get("table2").__module__ == "tools.paper.suites"
    assert SUITES.get("door").__module__ == "pedzoo.eval.suites.door"
    nowhere = Registry("suite", "pedzoo.eval.suites", "tools.nowhere")
    assert "door" in nowhere.names() and "table2" not in nowhere.names()


def test_cards_name_no_suite_of_a_checkout() -> None:
    package = {path.stem for path in folder_of("pedzoo.eval.suites").glob("*.py")}
    for name in weight_files():
        for report in read_card(shipped("checkpoints") / name / CARD).evaluations:
            suites = report["protocol"].get("suites", [])
            assert package >= set(suites), f"{name}: {about(report['protocol'])}"
