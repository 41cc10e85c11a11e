"""The page of scores: what rows are called, and how means and seeds are put together."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tools.pages import score_page

REALISM = {"zara1": {"walker.zara1": 0.1, "a/best.ckpt": 0.2}, "eth": {"walker.eth": 0.3, "b/best.ckpt": 0.6}}


def written(folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> str:
    """Write a page of two recordings with a crowd and a checkpoint each, and return it."""
    files = []
    for against, values in REALISM.items():
        rows = [{"name": name, "metrics": {"realism": value}, "ci95": {}} for name, value in values.items()]
        versions = {"pedzoo": "1", "commit": "abc"}
        file = folder / f"{against}.json"
        file.write_text(json.dumps({"protocol": {"against": against}, "rows": rows, "versions": versions}))
        files.append(str(file))
    monkeypatch.setattr(sys, "argv", ["score_page", *files, "--out", str(folder / "S.md"), *options])
    score_page.main()
    return (folder / "S.md").read_text()


def test_rows_of_several_seeds_have_a_table_of_their_spread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = written(tmp_path, monkeypatch, "--named", "walker.SCENE-seed1")
    assert "| walker.SCENE | 0.200 |" in page and "| walker.SCENE-seed1 | 0.400 |" in page
    assert "| walker.SCENE, 2 seeds | 0.300 (0.200 to 0.400) | - |" in page
    assert "| walker.zara1-seed1 | 0.200 |" in page and "| walker.eth-seed1 | 0.600 |" in page


def test_one_seed_has_no_spread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = written(tmp_path, monkeypatch)
    assert "| walker.SCENE | 0.200 |" in page and "seeds" not in page
    assert "a/best.ckpt" in page


@pytest.mark.parametrize(
    ("name", "expected"),
    [("w.styled_eth", "w.styled_SCENE"), ("w.eth-seed2", "w.SCENE-seed2"), ("eth", "eth"), ("orca", "orca")],
)
def test_kinds_are_names_without_the_recording(name: str, expected: str) -> None:
    assert score_page.kind(name, "eth") == expected
