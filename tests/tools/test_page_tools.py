"""Pages that `tools/pages` makes: tables of README and docs/, of scores, of joined results, and the site."""

import json
import re
import runpy
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from pedzoo.models.zoo.card import read_card
from tools.pages import score_page, tables
from tools.pages.join_results import joined

SITE = Path(__file__).parents[2] / "tools" / "pages" / "site"


def test_no_page_is_out_of_date() -> None:
    assert tables.main(["--check"]) == 0, "python -m tools.pages.tables"


def test_readme_tables_have_six_rows_and_five_columns() -> None:
    parts = tables.models(), tables.results()
    models, results = ([line for line in part.splitlines() if line.startswith("|")] for part in parts)
    assert len(models) == 2 + 6 and len(results) <= 2 + 6
    assert results[0].count("|") <= 1 + 5


def test_cells_are_the_numbers_of_the_results_and_of_the_card() -> None:
    page = (tables.RESULTS / "RESULTS.md").read_text().partition("## goals drawn: mean")[2]
    there = re.search(r"^\| sgan_goal_map\.zara1 \|[^|]*\| (\S+)", page, re.MULTILINE)
    robot = read_card(tables.ROOT / "checkpoints" / "robot_ppo.mix" / "card.yaml")
    success = f"{tables.walked(robot, 'robots')['success']:.2f} (of robots)"
    for name, cell in (("sgan_goal_map.zara1", there and there[1]), ("robot_ppo.mix", success)):
        (row,) = (line for line in tables.models().splitlines() if f"`{name}`" in line)
        assert f"| {cell} |" in row


def test_the_zoo_lists_every_model_with_its_held_out_scene() -> None:
    page = tables.zoo()
    assert all(f"| `{name}` |" in page for name in tables.shipped())
    (row,) = (
        line for line in page.splitlines() if line.startswith("| `approach_net_goal_map.indoor_zara1` |")
    )
    assert "| zara1 | window_end, true |" in row and "| yes |" in row


def test_a_page_without_its_markers_is_refused(tmp_path, monkeypatch) -> None:
    (tmp_path / "README.md").write_text("nothing")
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    with pytest.raises(SystemExit, match="expected the markers"):
        tables.filled("README.md")


# Scores

REALISM = {"zara1": {"walker.zara1": 0.1, "a/best.ckpt": 0.2}, "eth": {"walker.eth": 0.3, "b/best.ckpt": 0.6}}


def test_rows_of_several_seeds_have_a_table_of_their_spread(tmp_path, monkeypatch) -> None:
    """Of two recordings with a crowd and a checkpoint each; one seed alone has no spread."""
    files = []
    for against, values in REALISM.items():
        rows = [{"name": name, "metrics": {"realism": value}, "ci95": {}} for name, value in values.items()]
        versions = {"pedzoo": "1", "commit": "abc"}
        file = tmp_path / f"{against}.json"
        file.write_text(json.dumps({"protocol": {"against": against}, "rows": rows, "versions": versions}))
        files.append(str(file))

    def page(*options: str) -> str:
        monkeypatch.setattr(sys, "argv", ["score_page", *files, "--out", str(tmp_path / "S.md"), *options])
        score_page.main()
        return (tmp_path / "S.md").read_text()

    several = page("--named", "walker.SCENE-seed1")
    assert "| walker.SCENE | 0.200 |" in several and "| walker.SCENE-seed1 | 0.400 |" in several
    assert "| walker.SCENE, 2 seeds | 0.300 (0.200 to 0.400) | - |" in several
    assert "| walker.zara1-seed1 | 0.200 |" in several and "| walker.eth-seed1 | 0.600 |" in several
    one = page()
    assert "| walker.SCENE | 0.200 |" in one and "seeds" not in one and "a/best.ckpt" in one


@pytest.mark.parametrize(
    ("name", "expected"),
    [("w.styled_eth", "w.styled_SCENE"), ("w.eth-seed2", "w.SCENE-seed2"), ("eth", "eth"), ("orca", "orca")],
)
def test_kinds_are_names_without_the_recording(name: str, expected: str) -> None:
    assert score_page.kind(name, "eth") == expected


# Joined results


def report(commit: str, protocol: str = "door", **success: float) -> dict[str, Any]:
    """Return a report with a row of one case for each policy."""
    case = {"suite": "door", "physics": "torch"}
    same = {"table": "door", "case": case, "n": 5, "ci95": {}, "seconds": {"wall": 1.0, "cpu": 1.0}}
    rows = [{"name": name, "metrics": {"success": value}, **same} for name, value in success.items()]
    about = {"protocol": {"suites": [protocol]}, "seeds": [0], "notes": [], "versions": {"commit": commit}}
    return {**about, "rows": rows, "summary": rows}


def test_later_rows_take_the_place_of_those_of_the_same_policies() -> None:
    result = joined(report("old", orca=0.5, walker=0.6, force=0.7), report("new", walker=0.9))
    assert [(row["name"], row["metrics"]["success"]) for row in result["rows"]] == [
        ("orca", 0.5), ("walker", 0.9), ("force", 0.7),
    ]  # fmt: skip
    assert [row["metrics"]["success"] for row in result["summary"]] == [0.5, 0.9, 0.7]
    assert result["notes"] == ["by commit new: walker"] and result["versions"]["commit"] == "old"


def test_reports_of_other_suites_are_refused() -> None:
    with pytest.raises(SystemExit, match="not of one protocol"):
        joined(report("old", orca=0.5), report("new", protocol="goals", orca=0.9))


# The site


@pytest.fixture(scope="module")
def site() -> dict[str, Any]:
    return runpy.run_path(str(SITE / "__main__.py"), run_name="site")


def test_the_site_has_every_page_and_all_that_it_names(site: dict[str, Any]) -> None:
    listed = set(re.findall(r": docs/(\w+\.md)$", (SITE / "mkdocs.yml").read_text(), re.MULTILINE))
    assert listed == {page.name for page in (site["ROOT"] / "docs").glob("*.md")} - {"README.md"}
    assert [name for name in site["COPIED"] if not (site["ROOT"] / name).exists()] == []
    for name in (name for line in site["API"].values() for name in line.partition(": ")[2].split()):
        module, _, last = f"pedzoo.{name}".rpartition(".")
        assert hasattr(import_module(module), last) or import_module(f"pedzoo.{name}"), name
