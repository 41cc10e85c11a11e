"""`tools/pages/tables.py`: the tables of README and docs/ are those of cards and results."""

from __future__ import annotations

from pathlib import Path

import pytest

from pedzoo.models.zoo.card import read_card
from tools.pages import tables


def test_no_page_is_out_of_date() -> None:
    assert tables.main(["--check"]) == 0, "python -m tools.pages.tables"


def test_the_readme_has_six_models_and_at_most_six_results_in_five_columns() -> None:
    parts = tables.models(), tables.results()
    models, results = ([line for line in part.splitlines() if line.startswith("|")] for part in parts)
    assert len(models) == 2 + 6 and len(results) <= 2 + 6
    assert results[0].count("|") <= 1 + 5


def test_cells_are_the_numbers_of_the_results_and_of_the_card() -> None:
    page = (tables.RESULTS / "RESULTS.md").read_text().partition("## goals drawn: mean")[2]
    (there,) = (
        line for line in page.partition("\n\n## ")[0].splitlines() if "| sgan_goal_map.zara1 |" in line
    )
    success = there.split("|")[3].split()[0]
    robot = read_card(tables.ROOT / "checkpoints" / "robot_ppo.mix" / "card.yaml")
    for name, cell in (
        ("sgan_goal_map.zara1", success),
        ("robot_ppo.mix", f"{tables.walked(robot, 'robots')['success']:.2f} (of robots)"),
    ):
        (row,) = (line for line in tables.models().splitlines() if f"`{name}`" in line)
        assert f"| {cell} |" in row


def test_the_zoo_lists_every_model_with_its_held_out_scene() -> None:
    page = tables.zoo()
    assert all(f"| `{name}` |" in page for name in tables.shipped())
    (row,) = (line for line in page.splitlines() if line.startswith("| `sgan_goal_map.indoor_zara1` |"))
    assert "| zara1 | window_end, true |" in row and "| yes |" in row


def test_a_page_without_its_markers_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "README.md").write_text("nothing")
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    with pytest.raises(SystemExit, match="expected the markers"):
        tables.filled("README.md")
