"""The page of what was tried, and what kills are measured by."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from tools.reliability import page
from tools.reliability.kills import difference


def test_new_figures_take_the_place_of_their_own_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "RESULTS", tmp_path)

    def shown(name: str, state: object) -> str:
        (tmp_path / name).write_text(json.dumps(state))
        monkeypatch.setattr("sys.argv", ["page", str(tmp_path / name)])
        page.main()
        return (tmp_path / "RELIABILITY.md").read_text()

    shown("fuzz.json", {"ros": {"inputs": 1000, "complaints": {"ValueError": "ValueError: 7"}}})
    one = {"kills": 2, "not ended by itself": 0, "wrong": ""}
    shown("kills.json", {"sgan": [one, one | {"kills": 1, "wrong": "metrics.csv"}]})
    rows = [{"process": 0, "done": done, "memory": 100, "handles": 5} for done in (600, 1300)]
    text = shown("long_run.json", {"comings": rows, "torch": []})
    assert "| ros | 1,000 | ValueError |" in text and "still missing of tracks, " in text
    assert "| sgan | 2 | 3 | 0 | 1 |" in text
    assert "| comings | 1,300 of 2,000 | 1 | 0.00% over 700 | 0 | the same |" in text
    text = shown("fuzz.json", {"ros": {"inputs": 100_000, "complaints": {}}})
    assert "| ros | 100,000 | none |" in text and "ValueError" not in text and "| sgan | 2 |" in text


def test_what_a_kill_has_changed_is_told(tmp_path: Path) -> None:
    runs = tmp_path / "one", tmp_path / "two"
    for run in runs:
        (run / "checkpoints").mkdir(parents=True)
        torch.save({"state_dict": {"w": torch.ones(2)}}, run / "checkpoints" / "last.ckpt")
        (run / "metrics.csv").write_text("epoch,loss\n0,1\n")
    assert difference(*runs) == ""
    (runs[1] / "metrics.csv").write_text("epoch,loss\n0,1\n0,1\n")
    assert difference(*runs) == "metrics.csv"
    torch.save({"state_dict": {"w": torch.tensor([1, 1.0000001])}}, runs[1] / "checkpoints" / "last.ckpt")
    assert difference(*runs) == "weights ['w']"
