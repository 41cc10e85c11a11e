"""`pedzoo reproduce`: means over folds, by hand; what is missing and kept; and the pages that people read."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.core.spec import Spec
from pedzoo.eval.results import ResultTable
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.suites.scenes import CELLS
from pedzoo.policies.load import load_policy
from tools.paper import forecasts as module
from tools.paper.base import markdown
from tools.paper.crowdnav import TABLES, agreement_page
from tools.paper.figure4 import NARROW, PANELS, WIDE, Figure4, outcome
from tools.paper.forecast_pages import NATS, floor_pages, table1_pages
from tools.paper.forecasts import Table1, means
from tools.paper.meetings import OUTCOMES, one_slows
from tools.paper.method import PAPER, PAPERS_WORLD, WORLDS, World
from tools.paper.published import (
    FOLDS,
    ORCA_LOG,
    PEERS,
    RELEASED,
    SOCIAL_FORCE_LOG,
    TABLE_2_PARITY,
    TABLE_2_STEPS,
    mean_errors,
)
from tools.paper.table2 import Table2, middle_run, parity_text, run_text, steps_per_goal_at_most

pytestmark = pytest.mark.usefixtures("elsewhere")


@pytest.fixture
def recordings(tmp_path) -> str:
    """Social GAN's folders, zara1 alone: three people walk straight on at 1.25 m/s for 60 steps."""
    lines = [
        f"{10 * step}\t{person}\t{0.5 * step * (1 - 2 * (person % 2)):.4f}\t{2.0 * person:.4f}"
        for step in range(60)
        for person in range(3)
    ]
    for split in ("train", "val", "test"):
        folder = tmp_path / "recordings" / "zara1" / split
        folder.mkdir(parents=True)
        (folder / "walk.txt").write_text("\n".join(lines) + "\n")
    return str(tmp_path / "recordings")


# Table I


def scored(name: str, fold: str, ade: float, **case: str) -> dict[str, Any]:
    where = {"fold": fold, "goal": "none", "pred_len": "8"} | case
    metrics = {
        key.format(what): value
        for what, value in (("ade", ade), ("fde", 2 * ade))
        for key in ("{}_m", "{}_sampled_m", "min_{}_20_scene_m", "min_{}_20_agent_m")
    }
    row = {"name": name, "weights": name, "case": where, "n": 10, "blocks": 12, "metrics": metrics}
    return row | {"ci95": {"ade_m": (ade - 0.03, ade + 0.04)}}


def test_mean_over_folds_has_the_interval_of_a_mean() -> None:
    """Deviations of 0.03 and 0.04 to either side, twice: the mean's are divided by the root of two."""
    rows = [scored("sgan", "eth", 0.2), scored("sgan", "zara1", 0.4), scored("sgan_nopool", "eth", 0.2)]
    (mean,) = means(rows, ["eth", "zara1"])
    assert mean["name"] == "sgan" and mean["n"] == 20
    assert mean["metrics"]["ade_m"] == pytest.approx(0.3) and mean["metrics"]["fde_m"] == pytest.approx(0.6)
    assert mean["ci95"]["ade_m"] == pytest.approx((0.3 - 0.03 / 2**0.5, 0.3 + 0.04 / 2**0.5))
    assert means(rows, ["eth"]) == [] and mean["blocks"] == 12
    rows[0]["blocks"], rows[0]["ci95"] = 1, {}  # too short for an interval, and not exactly right
    assert means(rows, ["eth", "zara1"])[0]["ci95"] == {}


def test_released_models_have_the_printed_means() -> None:
    """As the facts have them: V .48/.96 and VP .53/1.04 for 12 steps, .34/.68 and .37/.71 for 8."""
    assert RELEASED[0]["errors"]["8"]["zara1"] == {"ade": 0.21, "fde": 0.42}
    result = [[mean_errors(model["errors"][steps]) for steps in ("12", "8")] for model in RELEASED]
    printed = [[(0.48, 0.96), (0.34, 0.68)], [(0.53, 1.04), (0.37, 0.71)]]
    assert [[tuple(round(value, 2) for value in one.values()) for one in row] for row in result] == printed


def test_ratio_of_means_and_seeds_on_the_pages() -> None:
    rows = [scored("sgan", fold, 0.5, pred_len="12") for fold in FOLDS]
    line = "constant_velocity"
    rows += [scored(line, fold, 0.6, pred_len=steps) for fold in FOLDS for steps in ("8", "12")]
    block = {"pred_len": "12", "goal": "none", "tag": "_pred12", "rows": [line, "sgan", "sgan_nopool"]}
    report = {
        "protocol": {"folds": list(FOLDS)},
        "rows": rows,
        "means": means(rows, FOLDS),
        "missing": {f"sgan_nopool.{fold}_pred12": "no such weights" for fold in FOLDS[1:]},
        "blocks": [block],
        "training_seeds": {"sgan_nopool.eth": {"seeds": {0: 0.1, 1: 0.3}, "seed": 0, "chosen_by": "val/ade"}},
    }
    rows[0]["blocks"] = 3
    for row in rows:
        if row["name"] == line or row["case"]["fold"] == "eth":
            row["metrics"][NATS] = -1.234
    pages = {page.title: page for page in table1_pages(report)}
    (ratio,) = pages["Best of 20 per scene beside released models, means"].rows
    assert ratio[-2:] == ["0.53\n1.04", "0.94\n0.97"]  # 0.5 / 0.534, 1 / 1.036
    overview = pages["Means over the folds, ADE / FDE"].rows
    named = [(row[0], row[2]) for row in overview]
    assert named == [("8 -> 8", line), ("8 -> 12", "sgan"), ("8 -> 12", line)]
    assert overview[1][3:] == ["0.500 / 1.000"] * 4 + ["-"]
    best = pages["8 -> 12, goal none: best of 20 per scene"]
    assert best.head == ["model", *(f"{fold} (10)" for fold in FOLDS), "mean (50)"]
    assert [row[0] for row in best.rows][1:3] == ["sgan", "sgan_nopool"]
    assert best.rows[2][1:] == ["-", *["no weights"] * 4, "-"]
    assert best.rows[3][1] == "0.71\n1.29"
    nats = next(page.rows for title, page in pages.items() if "negative log-likelihood" in title)
    assert nats == [["sgan", "-1.23", *["-"] * 5], [line, *["-1.23"] * 5, "-"]]
    likely = pages["8 -> 12, goal none: most likely"]
    assert likely.rows[1][1] == "0.500 ~[0.470, 0.540]\n1.000"  # of three blocks
    assert likely.rows[1][2] == "0.500 [0.470, 0.540]\n1.000"
    (seeds,) = pages["Spread over training seeds, in validation (from the model cards)"].rows
    assert seeds == ["sgan_nopool.eth", "2", "val/ade", "0.2000 ± 0.1414", "0: 0.1000, 1: 0.3000", "0"]
    paper = next(iter(pages.values()))
    assert paper.rows[1][:4] == ["Social-VRNN", "0.41\n0.70", "social_vrnn\ngoal none", "-"]


def test_present_models_are_scored_and_missing_ones_named(recordings: str, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(module, "find", lambda name: None)
    journal = tmp_path / "journal"
    table = Table1(["zara1"], root=recordings, journal=journal)
    seen = []
    table.run(progress=seen.append)
    report = table.report()
    assert [step.units for step in seen] == list(range(1, len(table.jobs) + 1)) and seen[-1].done == 1
    assert {row["name"] for row in report["rows"]} == {"constant_velocity", "straight_line", "bent_line"}
    for row in report["rows"]:  # who walks straight on goes where constant velocity goes
        assert row["metrics"]["ade_m"] == pytest.approx(0, abs=1e-5) or row["case"]["goal"] == "destination"
        if NATS in row["metrics"]:  # exactly right, with the smallest standard deviation that there is
            assert row["metrics"][NATS] == pytest.approx(math.log(2 * math.pi * 0.02**2), abs=1e-4)
        assert (NATS in row["metrics"]) == (row["case"]["goal"] == "none")
        assert row["blocks"] == row["windows"] // (8 + int(row["case"]["pred_len"]))
        assert row["n"] == 3 * row["windows"] == 3 * (60 - 8 - int(row["case"]["pred_len"]) + 1)
    assert set(report["missing"]) >= {"sgan_nopool.zara1", "sgan_goal.zara1_destination", "sgan.zara1_pred12"}
    assert "not here, no such weights: anchors.zara1, sgan_nopool.zara1, sgan.zara1" in report["notes"][-1]

    monkeypatch.setattr(module, "work", None)  # nothing is left to be done
    again = Table1(["zara1"], root=recordings, journal=journal)
    assert again.parts == (len(table.jobs), len(table.jobs))
    again.run()
    assert json.loads(json.dumps(again.report())) == json.loads(json.dumps(report))
    other = Table1(["zara1"], seed=1, root=recordings, journal=journal)
    assert (again.others, other.parts[0], other.others) == (0, 0, len(table.jobs))


def test_what_cannot_be_loaded_says_why_and_is_tried_again(recordings: str, tmp_path, monkeypatch) -> None:
    def broken(name: str, goal: str) -> Any:
        raise UserError(f"{name}: no convolutions")

    monkeypatch.setattr(module, "find", lambda name: None)
    monkeypatch.setattr(module, "load", broken)
    table = Table1(["zara1"], root=recordings, journal=tmp_path / "journal")
    table.run()
    report = table.report()
    assert report["rows"] == [] and report["missing"]["bent_line"] == "bent_line: no convolutions"
    assert Table1(["zara1"], root=recordings, journal=tmp_path / "journal").parts[0] == 0


# Forecasts with a floor


def test_forecasts_stand_beside_published_rows_and_targets() -> None:
    """Four folds at .1/.2 and eth at .5/.9: means of .18/.34, without eth .1/.2; two seeds differ by .02."""

    def metrics(fold: str, more: float = 0.0) -> dict[str, float]:
        ade, fde = (0.5, 0.9) if fold == "eth" else (0.1, 0.2)
        return {"min_ade_20_agent_m": ade + more, "min_fde_20_agent_m": fde + more, "miss_rate_20": 0.25}

    case = {"pred_len": "12", "goal": "none"}
    rows, training = [], []
    for fold in FOLDS:
        known = {"name": "anchor_net", "case": case | {"fold": fold}}
        rows.append(known | {"n": 1, "blocks": 1, "ci95": {}, "metrics": metrics(fold)})
        training.append(known | {"seeds": [metrics(fold), metrics(fold, 0.02)]})
    to_zara1 = {"fold": "zara1", "goal": "destination", "pred_len": "8"}
    for name, ade in (("anchor_net_goal", 0.21), ("sgan_goal", 0.2)):
        training.append({"name": name, "case": to_zara1, "seeds": [{"ade_m": ade, "fde_m": 0.4}]})
    mean = {"min_ade_20_agent_m": 0.18, "min_fde_20_agent_m": 0.34, "miss_rate_20": 0.25}
    training.append({"name": "anchor_net", "case": case | {"fold": "mean"}, "seeds": [mean, mean]})
    report = {
        "protocol": {"folds": list(FOLDS)},
        "rows": rows,
        "means": means(rows, FOLDS),
        "blocks": [case | {"rows": ["constant_velocity", "anchor_net"]}],
        "training": training,
        "published": PEERS,
    }
    targets, published, columns, seeds = floor_pages(report)
    said = {(row[0], row[2]): row[-2:] for row in targets.rows if row[1] == "8 -> 12, none"}
    assert said["anchor_net", "mean"] == ["0.180 / 0.340 (2 seeds)", "short by 0.005"]
    assert said["anchor_net", "without eth"] == ["0.110 / 0.210 (2 seeds)", "met"]
    assert said["anchors", "mean"] == ["-", "not measured"]
    beside_sgan = [row[2:] for row in targets.rows if row[1] == "8 -> 8, destination"]
    assert beside_sgan == [["zara1", "0.200 / 0.400", "0.210 / 0.400 (1 seeds)", "short by 0.010"]]
    ours, *others = published.rows
    assert ours[:3] == ["anchor_net", "0.500 / 0.900", "0.100 / 0.200"]
    assert ours[-3:] == ["0.180 / 0.340", "0.100 / 0.200", "none"]
    tutr = next(row for row in others if "TUTR" in row[0])
    assert tutr[1] == "0.40 / 0.61" and "test set" in tutr[-1]
    assert columns.rows == [["anchor_net", "-", "-", "0.180 / 0.340", "-", "0.250", "-", "-"]]
    assert seeds.rows[0][3] == "0.510 ± 0.014 / 0.910 ± 0.014"


# Table II and Figure 4


def test_steps_by_hand() -> None:

    assert steps_per_goal_at_most(2, 5) == 60  # 300 steps, 5 goals each
    assert steps_per_goal_at_most(5, 3) == 53  # 265 steps; the paper lists 5 goals where 3 were to be reached


def person(episode: int, agent: int, seconds: float | None, goals: int, seed: int = 0) -> dict[str, Any]:
    return {"seed": seed, "episode": episode, "agent": agent, "time_s": seconds, "goals": goals}


def test_the_run_that_is_told_is_the_middle_one() -> None:
    """Runs of 9, 22.7 and 30 s, and one that nobody ends: of four the second, of three by seed the second."""
    runs = [person(0, 0, 20.0, 3), person(0, 1, 22.7, 4), person(1, 0, None, 1), person(1, 1, 10.0, 3)]
    runs += [person(2, 1, 9.0, 3), person(2, 0, 8.0, 5)]
    middle = {"seed": 0, "episode": 0, "steps": 227, "goals": [3, 4]}
    assert middle_run(runs) == middle_run(runs[::-1]) == middle
    runs += [person(0, 0, 30.0, 3, seed=1), person(0, 1, 30.0, 3, seed=1)]
    assert middle_run(runs) == middle and run_text(middle) == ("227", "0: 3, 1: 4")
    stuck = middle_run([person(0, 0, None, 0), person(0, 1, 5.0, 3)])
    assert run_text(stuck) == ("not all reach all goals", "0: 0, 1: 3")


def test_the_papers_table_is_as_printed() -> None:
    """Rows of Table II in the paper's text, parity lines included."""
    printed = {
        (2, 3): (227, "0: 3, 1: 3"),
        (2, 5): (300, "0: 5, 1: 8"),
        (3, 3): (139, "0: 3, 1: 4, 2: 3"),
        (3, 5): (280, "0: 5, 1: 5, 2: 5"),
        (5, 3): (265, "0: 5, 1: 5, 2: 5, 3: 5, 4: 7"),
    }
    assert {cell: (TABLE_2_STEPS[cell], parity_text(TABLE_2_PARITY[cell])) for cell in CELLS} == printed


def test_the_papers_method_walks_as_in_the_paper() -> None:
    assert Table2.models[0] == Figure4.models[0] == PAPER and load_policy(PAPER).safety is False
    table = Table2(models=["go_to_goal", "orca"])
    papers = [unit for unit in table.evaluation.units if unit.case.case["world"] == PAPERS_WORLD]
    walked = {"go_to_goal", "orca", *Table2.baselines}
    assert {unit.policy for unit in papers} == walked and len(papers) == 10 * len(walked)
    figure = Figure4(models=["go_to_goal"])
    for unit in (*papers, *figure.evaluation.units):
        assert unit.case.physics == "bullet" and unit.case.planner == "astar"
        assert unit.case.warm_start == "igibson"
    usual = dict(zip(World._fields[1:], ("bullet", "astar", "igibson"), strict=True))
    for name, world in WORLDS.items():
        units = [unit for unit in table.evaluation.units if unit.case.case["world"] == name]
        assert name == PAPERS_WORLD or {unit.policy for unit in units} == {"go_to_goal"}
        changed = [key for key, value in usual.items() if getattr(units[0].case, key) != value]
        assert len(changed) == (name != PAPERS_WORLD), world.changes


def test_table_2_has_the_papers_form_and_one_row_per_change() -> None:
    """Two cells of one run each: steps, parity and contacts in a row, the paper's own numbers behind."""
    rows, summary = [], []
    for world in WORLDS:
        case = {"world": world, "speed": "0.5", "people": "2", "goals": "5", "suite": "table2"}
        metrics = {"success": 0.9, "episode_success": 0.8, "wall_contacts_per_min": 0.5}
        metrics["agent_contacts_per_min"] = 0.25
        row = {"name": "go_to_goal", "case": case, "metrics": metrics, "ci95": {}}
        rows.append(row | {"run": {"seed": 0, "episode": 3, "steps": 411, "goals": [5, 6]}})
        summary.append(row | {"table": f"table2 0.5 m/s, {world}"})
    table = Table2(models=["go_to_goal"])
    papers, changes, *_ = table.pages({"rows": rows, "summary": summary})
    assert papers.title == "The paper's method: go_to_goal"
    ours = ["0/3", "411", "0: 5, 1: 6", "0.90", "0.50", "0.25"]
    assert papers.rows == [["2/5", "0.5", *ours, "300", "0: 5, 1: 8"]]
    assert papers.head[3:5] == ["Total Time Steps", "Parity"] and len(papers.head) == len(papers.rows[0])
    assert [row[1] for row in changes.rows[1:]] == [world.changes for world in [*WORLDS.values()][1:]]
    assert changes.rows[1][2:] == ["0.90", "0.80", "0.50", "0.25"]


def test_table_2_has_the_papers_cells_in_both_units() -> None:
    row: dict[str, Any] = {"name": "walker"}
    row["case"] = {"world": PAPERS_WORLD, "speed": "1.3", "people": "2", "goals": "3"}
    row["metrics"] = {"time_s": 22.7, "seconds_per_goal": 7.5, "episode_success": 0.9}
    row["ci95"] = {"time_s": (20.0, 24.0)}
    table = Table2(models=["go_to_goal"])
    pages = {page.title: page.rows for page in table.pages({"rows": [row], "summary": []})}
    total, per_goal = (next(rows for title, rows in pages.items() if title.startswith(f"1.3 m/s: {start}"))
                       for start in ("total steps", "steps per goal"))  # fmt: skip
    assert total[0][1:] == ["227", "300", "139", "280", "265"]
    assert total[1] == ["walker", "227 [200, 240]\n57 [50, 60]", "-", "-", "-", "-"]
    assert per_goal[0][1:3] == ["at most 76 (76%)", "at most 60 (60%)"]
    goals = pages["1.3 m/s: goals per person, all episodes"][0][1::2]
    assert goals == ["at least 3", "at least 3", "at least 5"]
    assert per_goal[1][1] == "75 (75%)\n19 (19%)"
    assert table.printed()["total_steps"]["3/5"] == 280
    assert any("apartment.0, apartment.1, apartment.2" in note for note in table.notes())


def test_floor_plans_that_are_given_take_the_place_of_drawn_ones() -> None:
    options = EvaluationOptions(maps=("flat",), quick=True)
    units = Table2(models=["go_to_goal"], options=options).evaluation.units
    assert {(unit.case.case["map"], unit.case.episodes) for unit in units} == {("flat", 2)}
    settings = [unit.case.scenario.settings for unit in units if isinstance(unit.case.scenario, Spec)]
    assert len(settings) == len(units) and all(given["map"] == ["flat"] for given in settings)
    assert {(given["speed"], given["speed_std"]) for given in settings} == {(1.3, 0.2), (0.5, 0.0)}


def test_one_slows_where_exactly_one_does_before_the_door() -> None:
    """Four pairs of speed 1 and 0.5 m/s at 0.4 s steps, through after 1.3 s and, but for the last, 2.1 s."""
    quick, slow = [1.0, 1.0, 1.0, 1.0, 1.0], [0.5, 0.2, 0.2, 0.5, 0.5]
    late = [1.0, 1.0, 1.0, 0.1, 0.1]  # slow behind the door alone
    pairs = [
        (quick, slow),
        (quick, [0.5] * 5),
        ([1.0, 0.4, 1.0, 1.0, 1.0], slow),
        (late, slow),
        (quick, slow),
    ]
    speed = torch.tensor(pairs)
    velocity = torch.stack((speed, torch.zeros_like(speed)), -1)
    seconds = torch.tensor([[1.3, 2.1]] * 4 + [[1.3, torch.inf]], dtype=torch.float64)
    known, liked = torch.ones_like(speed, dtype=torch.bool), torch.tensor([[1.0, 0.5]] * 5)
    assert one_slows(velocity, known, seconds, liked).tolist() == [True, False, False, True, False]
    assert one_slows(velocity.flip(1), known, seconds.flip(1), liked.flip(1)).tolist()[0]
    known[0, 1, 1:3] = False
    assert not one_slows(velocity, known, seconds, liked)[0]


def test_the_papers_words_stand_beside_its_panels() -> None:
    assert [panel.label[:3] for panel in PANELS.values()] == ["(b)", "(c)", "(d)"] and PAPER in PANELS
    figure = Figure4(models=[PAPER])
    metrics = {f"outcome_{name}": float(name == "pass") for name in OUTCOMES} | {"as_in_paper": 0.25}
    where = {"suite": "figure4", "speed": "0.5", "speeds": "unequal"}
    row = {"name": PAPER, "case": where, "metrics": metrics, "ci95": {}, "n": 4, "table": "one", "cases": 1}
    line = figure.pages({"rows": [row], "summary": [row]})[0].rows[0]
    assert line[0] == f"(d) modified SGAN\n{PAPER}" and "the blue pedestrian stops" in line[1]
    assert line[2:7] == ["pass 1.00", "-", "-", "-", "0.25"]


def test_outcomes_that_are_not_rare_are_told() -> None:
    shares = {"outcome_lost": 0.25, "outcome_circle": 0.71, "outcome_pass": 0.04}
    metrics = {f"outcome_{name}": 0.0 for name in OUTCOMES} | shares
    assert outcome({"metrics": metrics}) == "circle 0.71, lost 0.25" and outcome(None) == "-"


@pytest.fixture
def small(monkeypatch) -> list[str]:
    """Figure 4 with one baseline and a model that is not there, one episode, without pybullet."""
    monkeypatch.setattr(Figure4, "models", ("sgan.nowhere",))
    monkeypatch.setattr(Figure4, "baselines", ("go_to_goal", NARROW))
    return ["reproduce", "figure4", "--episodes", "1", "--physics", "compiled", "--out", "made"]


def test_figure_4_writes_page_report_and_picture(small: list[str], capsys) -> None:
    assert main(small) == 0
    said, folder = capsys.readouterr().out, Path("made")
    assert sorted(path.name for path in folder.iterdir()) == ["FIGURE4.json", "FIGURE4.md", "FIGURE4.png"]
    report = json.loads((folder / "FIGURE4.json").read_text())
    assert (report["command"], report["seeds"], report["missing"]) == ("reproduce", [0], ["sgan.nowhere"])
    assert report["paper"][WIDE].startswith("the pedestrians are blocked")
    result = {(row["name"], *row["case"].values()): row["metrics"] for row in report["rows"]}
    where = "figure4", "compiled", "1.3", "equal"
    assert len(result) == 12 and result[(NARROW, *where)]["outcome_circle"] == 1
    assert result[("go_to_goal", *where)]["outcome_through"] == 1
    assert result[("go_to_goal", *where)]["as_in_paper"] == 0 == result[("go_to_goal", *where)]["no_contact"]
    page = (folder / "FIGURE4.md").read_text()
    for text in (page, said):
        assert "not here, no such weights: sgan.nowhere" in text
    assert "(c) ORCA, radius 0.1<br>orca:preset=igibson" in page and "form a circular pattern" in page
    assert "![FIGURE4](FIGURE4.png)" in page and "Made by `pedzoo reproduce figure4 --episodes 1" in page
    assert "* `outcome_circle`: in which both arrive and turn around each other" in page


def test_what_was_interrupted_goes_on(small: list[str], capsys, monkeypatch) -> None:
    whole = Figure4.run

    def stop(step: Any) -> None:
        if step.units == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(Figure4, "baselines", ("go_to_goal",))
    monkeypatch.setattr(Figure4, "run", lambda self, workers, _: whole(self, workers, stop))
    assert main(small) == 130
    assert "not finished: 2 of 6 parts" in capsys.readouterr().out
    assert [path.name for path in Path("made").iterdir()] == ["FIGURE4.json.partial"]
    monkeypatch.setattr(Figure4, "run", whole)
    monkeypatch.setattr(Figure4, "draw", lambda self, folder: [])
    assert main(small) == 0
    assert "2 of 6 parts were done before" in capsys.readouterr().out
    stored = Path("made/FIGURE4.json.partial")
    assert not stored.exists()
    stored.write_text('{"unit": "of a larger table", "rows": []}\n')
    assert main(small) == 0
    assert "with 1 parts of another request" in capsys.readouterr().out
    assert "of a larger table" in stored.read_text()


def test_page_has_command_notes_pictures_and_tables() -> None:
    table = ResultTable("numbers", ["name", "x"], [["one", "1\n[0, 2]"]], 1)
    made: Any = SimpleNamespace(title="A table", pages=lambda _: [table], legend=lambda: {"x": "how many"})
    versions = {"pedzoo": "1", "torch": "2", "commit": "abc"}
    report = {"seeds": [0, 1], "notes": ["a note"], "versions": versions}
    text = markdown(made, report, ["pedzoo", "reproduce", "a b"], [Path("out/A.png")])
    assert text.startswith(
        "# A table\n\nMade by `pedzoo reproduce 'a b'` with pedzoo 1, torch 2, commit abc;"
    )
    for part in ("seeds 0 1.", "* a note", "![A](A.png)", "| one | 1<br>[0, 2] |", "* `x`: how many."):
        assert part in text


# CrowdNav


def test_crowdnav_makes_page_and_report_of_any_robot(tmp_path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("class Still:\n    def __call__(self, robot, people):\n        return 0 * robot.goal\n")
    argv = ["reproduce", "crowdnav", "--episodes", "3", "--models", f"{file}:Still", "--out", str(tmp_path)]
    assert main(argv) == 0
    report = json.loads((tmp_path / "CROWDNAV.json").read_text())
    assert report["command"] == "reproduce" and "pedzoo" in report["versions"]
    assert [row["case"]["setting"] for row in report["rows"]] == list(TABLES)
    for row in report["rows"]:
        assert row["n"] == 3 and len(row["outcomes"]) == 3 and row["metrics"]["success"] == 0
        assert sum(row["metrics"][key] for key in ("collision", "timeout", "failed")) == pytest.approx(1)
        assert row["ci95"]["success"] == pytest.approx([0, 1.959964**2 / (3 + 1.959964**2)])
    page = (tmp_path / "CROWDNAV.md").read_text()
    assert "| GST, attention |" in page and ".43 / .57 / 10.86" in page


def test_cases_are_compared_with_a_published_log_one_by_one() -> None:
    theirs = SOCIAL_FORCE_LOG.outcomes[:4]
    other = {"s": "c", "c": "s", "t": "s"}[theirs[3]]
    row = {"name": "crowdnav_social_force", "case": {"setting": "crowdnav_pp"}}
    row["outcomes"] = "?".join((*theirs[:3], other))  # of the log is every second case
    (line,) = agreement_page([row]).rows
    assert line[:4] == ["SF_no_rand", "crowdnav_social_force", "4", "3"]
    assert agreement_page([]).rows == []


def test_published_logs_are_whole() -> None:
    for log, shares in ((SOCIAL_FORCE_LOG, (0.34, 0.64)), (ORCA_LOG, (0.69, 0.29))):
        assert len(log.outcomes) == 250 and set(log.outcomes) == set("sct")
        result = tuple(round(log.outcomes.count(letter) / 250, 2) for letter in "sc")
        assert result == shares
