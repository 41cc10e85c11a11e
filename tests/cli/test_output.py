"""What commands print and write: any text as it is, and results before anything else can go wrong."""

import io
import json
from typing import Any

import pytest
from rich.console import Console

import pedzoo
from pedzoo.cli import output
from pedzoo.cli.main import main
from pedzoo.cli.output import check_outputs, plain_console, print_report, print_tables, write_and_print
from pedzoo.core.errors import UserError
from pedzoo.eval.results import ResultTable
from pedzoo.eval.work_units import ProgressReport
from pedzoo.maps.formats import write_ros
from pedzoo.maps.plans import flat

ODD = "[/a/b.yaml,[bold]c[/]]:door:"
"""Rich would fail at it, or draw a door."""

WALK = ["--scenario", "circle:people=2", "--physics", "compiled", "--episodes", "1"]


def test_a_scenario_on_several_files_is_printed(tmp_path, capsys) -> None:
    write_ros(flat(), tmp_path / "a.yaml")
    scenario, file = f"goals:map=[{tmp_path}/a.yaml,apartment.1],people=2,goals=1,pool=4", tmp_path / "r.json"
    words = ["rollout", "go_to_goal", "--scenario", scenario, "--physics", "compiled", "--episodes", "1"]
    assert main([*words, "--json", str(file)]) == 0
    assert scenario in capsys.readouterr().out.replace("\n", "")
    assert json.loads(file.read_text())["protocol"]["scenario"] == scenario


def test_tables_print_text_as_it_is(capsys) -> None:
    row = {"name": ODD, "case": {"map": ODD}, "n": 1, "metrics": {"x_m": 1.0}}
    print_report({"protocol": {"scenario": ODD}, "rows": [row]})
    assert capsys.readouterr().out.count(ODD) == 3
    print_tables([ResultTable(ODD, [ODD, ODD], [[ODD, ODD]], 1)])
    assert capsys.readouterr().out.count(ODD) == 5


def test_bars_show_text_as_it_is(monkeypatch) -> None:
    screen = io.StringIO()

    def terminal(**_: Any) -> Console:
        console = plain_console()
        return Console(file=screen, force_terminal=True, width=150, markup=console._markup, emoji=False)

    monkeypatch.setattr(output, "plain_console", terminal)
    with output.progress_bar() as update:
        update(ODD, 1, 2)
    with output.overall_bar() as tell:
        tell(ProgressReport(f"goals {ODD}", 0.5, 1, 2, None, None))
    assert screen.getvalue().count(ODD) >= 2


@pytest.mark.parametrize(
    ("words", "printer"),
    [
        (["rollout", "go_to_goal", *WALK], "walk.print_report"),
        (["evaluate", "go_to_goal", "--suite", "door", *WALK[2:]], "evaluate.print_pages"),
        (
            ["forecast", "constant_velocity", "--data.fold", "embedded", "--samples", "1"],
            "forecast.print_report",
        ),
        (["models", "sgan_goal.zara1"], "lists.print_tables"),
    ],
)
def test_results_are_written_before_they_are_printed(words, printer, tmp_path, monkeypatch):
    def dies(*_: Any) -> None:
        raise BufferError

    monkeypatch.setattr(f"pedzoo.cli.commands.{printer}", dies)
    file = tmp_path / "report.json"
    more = ["--markdown", str(tmp_path / "page.md")] if words[0] == "evaluate" else []
    with pytest.raises(BufferError):
        main([*words, "--json", str(file), *more])
    assert json.loads(file.read_text())["command"] == words[0]
    assert not more or "go_to_goal" in (tmp_path / "page.md").read_text()


def test_a_report_for_the_terminal_comes_last(capsys) -> None:
    write_and_print({"a": 1}, "-", lambda: print("table"))
    assert capsys.readouterr().out.startswith("table\n{")
    write_and_print({"a": 1}, None, lambda: print("table"))
    assert capsys.readouterr().out == "table\n" and output.check_outputs() is None


def test_wide_tables_are_transposed_where_that_needs_fewer_parts(capsys) -> None:
    """Twenty metrics of two policies become one table in a log; three of sixty models stay as they are."""
    metrics = {f"metric_{number}_per_min": float(number) for number in range(20)}
    rows = [{"name": name, "case": {}, "n": 5, "metrics": metrics} for name in ("orca", "go_to_goal")]
    print_report({"protocol": {"scenario": "door"}, "rows": rows})
    lines = capsys.readouterr().out.splitlines()
    cells = [line.strip("│").replace("│", " ").split() for line in lines if line.startswith("│")]
    assert cells == [["n", "5", "5"], *([name, *[f"{value:.3f}"] * 2] for name, value in metrics.items())]
    assert max(map(len, lines)) <= 120 and any("orca" in line and "go_to_goal" in line for line in lines)

    print_tables([ResultTable("", ["name", "x", "y"], [[f"model_{i}", "1", "2"] for i in range(60)], 1)])
    assert sum(line.startswith("│") for line in capsys.readouterr().out.splitlines()) == 60
    print_tables([ResultTable("", ["name", *"ab" * 40], [[f"model_{i}", *"12" * 40] for i in range(2)], 1)])
    assert sum(line.startswith("│") for line in capsys.readouterr().out.splitlines()) == 80


def test_pages_and_reports_need_their_endings(tmp_path) -> None:
    with pytest.raises(UserError, match=r"--html .*walk\.txt: expected a file that ends in \.html"):
        check_outputs(html=str(tmp_path / "walk.txt"))
    with pytest.raises(UserError, match=r"--json .*walk\.csv: expected a file that ends in \.json$"):
        check_outputs(json=str(tmp_path / "walk.csv"))
    check_outputs(html=str(tmp_path / "walk.HTML"), json=str(tmp_path / "walk.JSON"))
    check_outputs(html="/dev/null", json="-")
    with pytest.raises(UserError, match=r"--plot /dev/null: expected a file that ends in \.png"):
        check_outputs(plot="/dev/null")
    with pytest.raises(UserError, match=r"page '.*w\.png': expected a file that ends in \.html or \.htm"):
        pedzoo.rollout("go_to_goal", "circle:people=2", "compiled", 1).save(tmp_path / "w.png")
