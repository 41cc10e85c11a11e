"""`tools/pages/scenario_table.py`: only the whole run replaces the shipped page and has conclusions."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """Return the script, which walks nowhere and whose checkpoints are in a folder of their own."""
    module = import_module("tools.pages.scenario_table")
    monkeypatch.setattr(module, "walked", lambda options: {})
    monkeypatch.setattr(module, "picture", lambda result: b"picture")
    monkeypatch.setattr(module, "shipped", lambda folder: tmp_path / folder)
    return module


def called(tool: ModuleType, monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    """Run it with a command line."""
    monkeypatch.setattr(sys, "argv", ["scenario_table.py", *words])
    tool.main()


@pytest.mark.parametrize("words", [(), ("--workers", "1"), ("--episodes", "20", "--physics", "compiled")])
def test_the_whole_run_makes_the_page(
    tool: ModuleType, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    called(tool, monkeypatch, *words)
    page = (tmp_path / "checkpoints" / "results" / "SCENARIOS.md").read_text()
    assert "What fails, and why" in page and "(./scenarios_walked.png)" in page and "*stuck*" in page
    assert (tmp_path / "checkpoints" / "results" / "scenarios_walked.png").read_bytes() == b"picture"


@pytest.mark.parametrize(
    "words", [("door",), ("--policies", "go_to_goal"), ("--episodes", "2"), ("--physics", "bullet")]
)
def test_other_runs_print(
    tool: ModuleType,
    words: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    called(tool, monkeypatch, *words)
    printed = capsys.readouterr().out
    assert f"`python tools/pages/scenario_table.py {' '.join(words)}`" in printed and "*stuck*" in printed
    assert "What fails" not in printed and "picture" not in printed and not list(tmp_path.iterdir())
    called(tool, monkeypatch, *words, "--out", str(tmp_path / "mine.md"))
    assert "What fails" not in (tmp_path / "mine.md").read_text()
    assert not (tmp_path / "checkpoints").exists()
