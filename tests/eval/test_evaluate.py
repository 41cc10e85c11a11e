"""`pedzoo evaluate`: the same table however it is run, parts that are kept, and what people read."""

import json
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.model_cards import make_card
from helpers.walks import BROKEN

import pedzoo
from pedzoo.cli.main import main
from pedzoo.core.errors import UserError
from pedzoo.core.registry import SUITES
from pedzoo.core.spec import Spec
from pedzoo.eval import evaluate as module
from pedzoo.eval import suite as keeping
from pedzoo.eval import trained_on
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.results import SuiteColumns, cell, markdown, mean_interval, pages, summary
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, WorkUnit
from pedzoo.eval.suites.scenes import CELLS, POOL
from pedzoo.eval.work_units import Journal, ProgressReport, code_sum, digest, work
from pedzoo.maps.formats import write_ros
from pedzoo.maps.plans import flat
from pedzoo.models.zoo.card import write_card
from pedzoo.viz.plots import plot_density_speed

SMALL = '''
from pedzoo.eval.suite import EvaluationCase, Suite

CASES = {"circle": "circle", "two": "overtaking"}


class Small(Suite):
    """Two encounters: a suite from a file of one's own."""

    def cases(self, options):
        physics, number = options.physics or "compiled", options.number(20)
        return [
            EvaluationCase(self.name, key, name, physics, number, {"card": key})
            for key, name in CASES.items()
        ]
'''


@pytest.fixture
def small(tmp_path) -> str:
    file = tmp_path / "small.py"
    file.write_text(SMALL)
    return f"{file}:Small"


def compared(report: dict[str, Any]) -> dict[str, Any]:
    """Return a report without versions and times."""
    result = json.loads(json.dumps(report))
    for row in result["rows"] + result["summary"]:
        del row["seconds"]
    return {key: value for key, value in result.items() if key not in ("versions", "command")}


def test_a_resumed_command_and_python_give_the_same_table(small: str, tmp_path, capsys, monkeypatch) -> None:
    policies, file = ["go_to_goal", "sgan_goal.zara1"], tmp_path / "out.json"
    command = ["evaluate", *policies, "--suite", small, "--quick", "--seeds", "0,3", "--json", str(file)]
    (page := tmp_path / "page.md").write_text("the page of a whole evaluation")
    command += ["--markdown", str(page)]
    done: list[str] = []
    real = module.work

    def interrupted(unit: Any, tell: Any) -> Any:
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(unit.label)
        return real(unit, tell)

    monkeypatch.setattr(module, "work", interrupted)
    assert main(command) == 130
    assert "not finished: 3 of 4 parts" in (said := capsys.readouterr().out)
    assert "the same command goes on from there" in said
    assert json.loads(file.read_text())["interrupted"] is True
    assert "go_to_goal (not all cases)" not in said and "sgan_goal.zara1 (not all cases)" in said
    assert page.read_text() == "the page of a whole evaluation"

    monkeypatch.setattr(module, "work", real)
    assert main(command) == 0
    assert "3 of 4 parts were done before" in (said := capsys.readouterr().out)
    assert "of other commands" not in said
    resumed = json.loads(file.read_text())
    assert "interrupted" not in resumed and list(tmp_path.glob("*.partial")) == []
    assert "| go_to_goal | 8 |" in page.read_text()

    alone = pedzoo.evaluate(policies, [small], quick=True, seeds=[0, 3])
    assert compared(resumed) == compared(alone)
    row = alone["rows"][0]
    assert (row["name"], row["n"]) == ("go_to_goal", 4)
    assert row["case"] == {"suite": small, "physics": "compiled", "card": "circle"}
    assert {(person["seed"], person["episode"]) for person in row["per_agent"]} == {
        (seed, episode) for seed in (0, 3) for episode in (0, 1)
    }


def test_kept_parts_of_another_command_stay(small: str, tmp_path) -> None:
    stored = tmp_path / "out.json.partial"
    Journal(stored).add("another", [{"n": 1}])
    command = ["evaluate", "go_to_goal", "--suite", small, "--episodes", "1"]
    assert main([*command, "--json", str(tmp_path / "out.json")]) == 0
    assert "another" in Journal(stored).done and len(Journal(stored).done) == 3


def test_parts_are_kept_when_a_worker_is_killed(small: str, tmp_path, capsys, monkeypatch) -> None:
    def results(units: Any, *_: Any) -> Iterator[tuple[int, Any]]:
        yield 0, work(units[0])
        raise RuntimeError("worker 1 of 2 is killed by SIGKILL")

    file = tmp_path / "out.json"
    monkeypatch.setattr(module, "finished", results)
    with pytest.raises(RuntimeError, match="SIGKILL"):
        main(["evaluate", "go_to_goal", "--suite", small, "--episodes", "1", "--json", str(file)])
    assert "not finished: 1 of 2 parts" in (said := capsys.readouterr().out) and "is kept in" in said
    assert len(Journal(Path(f"{file}.partial")).done) == 1


def test_workers_end_when_a_part_cannot_be_kept(small: str, monkeypatch) -> None:
    ended: list[int] = []

    def results(*_: Any) -> Iterator[tuple[int, Any]]:
        try:
            yield 0, [{"seconds": {"wall": 1.0}}]
        finally:
            ended.append(1)

    monkeypatch.setattr(module, "finished", results)
    monkeypatch.setattr(Journal, "add", lambda *_: (_ for _ in ()).throw(UserError("cannot write")))
    with pytest.raises(UserError, match="cannot write") as caught:
        pedzoo.evaluate(["go_to_goal"], [small])
    assert ended and caught.traceback  # though the caught error holds on to the iterator


def test_what_is_no_list_of_policies_is_refused() -> None:
    for policies in ([["orca", "go_to_goal"]], [None], 3):
        with pytest.raises(UserError, match=r"policies.*\['orca', 'go_to_goal'\]"):
            pedzoo.evaluate(policies, ["encounters"])  # pyright: ignore[reportArgumentType]


def test_a_policy_without_numbers_fails_and_others_go_on(small: str, tmp_path) -> None:
    file = tmp_path / "broken.py"
    file.write_text(BROKEN)
    with pytest.warns(UserWarning, match="the scene ends as failed"):
        report = pedzoo.evaluate([f"{file}:Broken", "go_to_goal"], [small], episodes=1)
    broken, fine = report["summary"]
    assert (broken["metrics"]["failed"], broken["metrics"]["success"]) == (1.0, 0.0)
    assert (fine["metrics"]["failed"], fine["metrics"]["success"]) == (0.0, 1.0)
    assert "time_ratio" not in broken["metrics"]


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("pass", "has no cases: write its method cases"),
        (
            "def __init__(self, name): pass\n    def cases(self, options): return []",
            r"does not keep its name: call super\(\).__init__",
        ),
        ("def cases(self, options): return None", "returned None, expected a list of one or more"),
        ("def cases(self, options): return []", r"returned \[\], expected a list of one or more"),
        ("def cases(self, options): return ['circle']", r"returned \['circle'\], expected"),
        (
            "def cases(self, options): return [EvaluationCase('door', 'door', 'circle', 'compiled', 2, {})]",
            "its case 'door' is of the suite 'door'.*EvaluationCase.suite=self.name",
        ),
    ],
)
def test_what_a_suite_in_a_file_lacks_is_said(code: str, message: str, tmp_path) -> None:
    file = tmp_path / "wrong.py"
    file.write_text(f"from pedzoo.eval.suite import EvaluationCase, Suite\nclass Mine(Suite):\n    {code}\n")
    with pytest.raises(UserError, match=message) as error:
        Evaluation(["go_to_goal"], ["door", f"{file}:Mine"], EvaluationOptions(physics="compiled"))
    assert f"{file}:Mine" in str(error.value)


def test_suites_have_the_cases_of_papers() -> None:
    def cases(name: str, **options: Any) -> list[EvaluationCase]:
        return SUITES.get(name)(name).cases(EvaluationOptions(**options))

    (door,) = cases("door")
    assert (door.physics, door.episodes) == ("bullet", 200) and cases("door", quick=True)[0].episodes == 20
    goals = cases("goals", maps=("flat",))
    assert len(goals) == 2 * len(CELLS) and {case.case["map"] for case in goals} == {"drawn", "flat"}
    assert [(int(case.case["people"]), int(case.case["goals"])) for case in goals[:5]] == list(CELLS)
    both = cases("goals", maps=("flat", "office.3"))
    assert len(both) == 2 * len(CELLS) and both[-1].case["map"] == "given"
    given = {"map": ["flat", "office.3"], "people": 5, "goals": 3, "pool": POOL}
    assert both[-1].scenario == Spec("goals", given)
    assert [case.physics for case in cases("encounters", physics="compiled")] == ["compiled"] * 8


ODD = "a,b=[c:d,people=1"
"""A folder that would mean something else in a text of settings."""


@pytest.mark.parametrize("suite", ["goals", "table2"])
def test_floor_plans_may_have_any_path(suite: str, tmp_path) -> None:
    file = tmp_path / ODD / "plan.yaml"
    file.parent.mkdir()
    write_ros(flat(), file)
    evaluation = Evaluation(["go_to_goal"], [suite], EvaluationOptions(1, True, "compiled", (str(file),)))
    unit = next(unit for unit in evaluation.units if unit.case.case["map"] == "plan")
    (row,) = work(unit)
    assert row["n"] == 1 and len(row["per_agent"]) == 2


def test_recordings_may_have_any_root(shared: Path, tmp_path) -> None:
    (tmp_path / ODD).symlink_to(shared / "data")
    options = EvaluationOptions(quick=True, root=str(tmp_path / ODD / "eth_ucy"))
    evaluation = Evaluation(["go_to_goal"], ["replay"], options)
    unit = next(unit for unit in evaluation.units if unit.case.name == "eth all")
    (row,) = work(unit)
    assert row["n"] > 0 and row["case"]["fold"] == "eth"
    again = Evaluation(["go_to_goal"], ["replay"], options)
    assert digest(again.units[evaluation.units.index(unit)]) == digest(unit)


def test_cases_on_one_floor_plan_find_its_ways_once(monkeypatch) -> None:
    monkeypatch.setattr(keeping, "_kept", {})
    first = keeping.prepared("goals:map=flat,people=2,goals=3,pool=6")
    second = keeping.prepared("goals:map=flat,people=5,goals=3,pool=6")
    other = keeping.prepared("goals:map=flat,people=2,goals=3,pool=7")
    assert second.planner is first.planner and other.planner is not first.planner
    assert (first.people, second.people) == (2, 5)
    assert keeping.prepared("goals:map=flat,people=2,goals=3,pool=6") is first
    assert keeping.prepared("goals:map=flat,people=2,goals=3,pool=6", "the file has changed") is not first
    with pytest.raises(UserError, match="500 people do not fit"):
        keeping.prepared("goals:map=flat,people=500,goals=3,pool=6")


def test_without_recordings_the_embedded_crowd_is_replayed(monkeypatch) -> None:
    monkeypatch.delenv("PEDZOO_DATA", raising=False)
    report = pedzoo.evaluate(["go_to_goal"], ["replay"], quick=True)
    real, rounds, missing = report["notes"]
    assert "models with noise walk 1 x where all" in rounds
    assert "real halves one half of them against the other" in real
    assert "no recordings of ETH/UCY (get them: pedzoo download eth_ucy): the embedded ones alone" in missing
    assert report["protocol"]["warm_start"] == {"replay": "recorded"}
    names = [(row["name"], row["case"]["simulated"]) for row in report["rows"]]
    assert names == [
        (name, kind) for kind in ("all", "one") for name in ("go_to_goal", "real", "real halves")
    ]
    (ours, real, halves), one = report["summary"][:3], report["summary"][3]
    assert (ours["table"], one["table"], one["name"]) == ("replay all", "replay one", "go_to_goal")
    assert real["metrics"]["realism"] == 0.0 and halves["metrics"]["realism"] > 0.0
    assert ours["metrics"]["success"] == 1.0


HELD_OUT = {
    **{"a.zara1": "zara1", "a.hotel": "hotel", "a.zara1_destination": "zara1", "a.eth_ucy": "eth_ucy"},
    **{"b.eth_ucy": "eth_ucy", "b.indoor": "eth_ucy", "b.indoor_hotel": "hotel"},
}
"""The folds that weights did not see."""


@pytest.mark.parametrize(
    ("policy", "fold", "walks", "seen"),
    [
        ("a.zara1:noise=step", "hotel", "a.hotel:noise=step", True),
        ("a.zara1", "zara1", "a.zara1", False),
        ("a.zara1", "univ", "a.zara1", True),
        ("a.zara1", "embedded", "a.zara1", False),
        ("a.hotel", "hotel", "a.hotel", False),
        ("a.zara1_destination", "hotel", "a.zara1_destination", True),
        ("a.eth_ucy:noise=none", "hotel", "a.hotel:noise=none", True),
        ("b.eth_ucy", "zara2", "b.eth_ucy", True),
        ("b.indoor:noise=step", "hotel", "b.indoor_hotel:noise=step", True),
        ("b.indoor", "zara1", "b.indoor", True),
        ("orca:radius=0.3", "hotel", "orca:radius=0.3", False),
    ],
)
def test_weights_that_saw_a_fold_make_way_for_others(
    policy: str, fold: str, walks: str, seen: bool, monkeypatch
) -> None:
    monkeypatch.setattr(trained_on, "weight_files", lambda: {name: Path(name) for name in HELD_OUT})
    monkeypatch.setattr(trained_on, "read_config", lambda path: {"training": {"fold": HELD_OUT[str(path)]}})
    assert (trained_on.for_fold(policy, fold), trained_on.has_seen(policy, fold)) == (walks, seen)


def test_own_weights_are_known_by_checkpoint_or_card(tmp_path) -> None:
    file, name = tmp_path / "best.ckpt", f"{tmp_path}/sgan_goal.mall"
    record = {"architecture": "sgan", "init": {}, "protocol": {"fold": "zara1"}}
    torch.save({"pedzoo": record, "state_dict": {}}, file)
    write_card(make_card("sgan_goal.mall"), f"{name}/card.yaml")
    for weights in (str(file), name):
        assert trained_on.has_seen(f"{weights}:noise=step", "hotel")
        assert not trained_on.has_seen(weights, "zara1")
    assert trained_on.for_fold(name, "hotel") == name


def test_a_journal_is_on_the_disk_and_refuses_other_files(tmp_path, monkeypatch) -> None:
    file, synchronised = tmp_path / "parts", []
    monkeypatch.setattr(os, "fsync", lambda handle: synchronised.append(os.fstat(handle).st_size))
    journal = Journal(file)
    journal.add("one", [{"n": 1}])
    assert synchronised == [file.stat().st_size]
    journal.add("two", [{"n": 2}])
    whole = file.read_bytes()
    file.write_bytes(whole[:-5])  # cut off in a write
    again = Journal(file)
    assert again.done == {"one": [{"n": 1}]}
    again.add("two", [{"n": 2}])
    assert file.read_bytes() == whole
    file.write_text("something else\n")
    with pytest.raises(UserError, match="no finished parts"):
        Journal(file)
    assert file.read_text() == "something else\n"


TORN = (
    *(b'{"unit": "two", "ro', b"\0" * 4096, b"\xff\xfe", b"[" * 100_000, b'{"unit": "two", "rows": 7}'),
    *(b'{"unit": 2, "rows": []}', b'{"unit": "two", "rows": [1' + b"0" * 5000 + b"]}", b"null", b""),
)


@pytest.mark.parametrize("torn", TORN)
def test_a_journal_does_again_what_is_torn(torn: bytes, tmp_path, capsys) -> None:
    for place in range(3):
        file, units = tmp_path / f"parts{place}", ["one", "two", "three"]
        for unit in units:
            Journal(file).add(unit, [{"n": unit}])
        lines = file.read_bytes().splitlines(keepends=True)
        lines[place] = torn + b"\n"
        file.write_bytes(b"".join(lines))
        again, lost = Journal(file), units.pop(place)
        assert again.done == {unit: [{"n": unit}] for unit in units}
        assert "1 finished part" in (error := capsys.readouterr().err) and "once more" in error
        again.add(lost, [{"n": lost}])
        assert set(Journal(file).done) == {"one", "two", "three"} and not capsys.readouterr().err


def test_the_key_of_a_part_has_all_that_numbers_depend_on(small: str) -> None:
    unit = Evaluation(["go_to_goal"], [small]).units[0]
    others = [
        unit._replace(policy="go_to_goal:dt=0.1", walks="go_to_goal:dt=0.1"),
        unit._replace(seeds=(1,)),
        unit._replace(deterministic=True),
        unit._replace(case=unit.case._replace(episodes=7)),
        unit._replace(case=unit.case._replace(inputs="another floor plan")),
    ]
    assert len({digest(one) for one in [unit, *others]}) == 6
    assert digest(unit) == digest(Evaluation(["go_to_goal"], [small]).units[0])
    model, digests = f"{Path(small).parent}/sgan.mall", []
    for digit in "01":
        write_card(make_card("sgan.mall", sha256=64 * digit), f"{model}/card.yaml")
        digests.append(digest(unit._replace(policy=model, walks=model)))
    assert digests[0] != digests[1], "other weights under the same name"
    before = digest(unit)
    Path(small.rpartition(":")[0]).write_text(f"{SMALL}# changed")
    assert digest(unit) == before
    Path(small.rpartition(":")[0]).write_text(f"{SMALL}changed = 1")
    assert digest(unit) != before


CODE = '''
"""About it."""
import math

class Mine:
    """More."""
    size: int = 3

    def area(self, side=2.0, *, known=frozenset("abc")):
        """And more."""
        return math.pi * side if side in {1.0, 2.0} else (lambda x: x + 1)(side)
'''


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("About it", "Other words", True),
        ('"""More."""', "", True),
        ("And more", "And \\n more", True),
        ('        """And more."""\n', "", True),
        ("import math", "import math  # for pi\n\n\n# and nothing else", True),
        ("side in {1.0, 2.0}", "(side\n            in {1.0, 2.0, })", True),
        ("2.0}", "3.0}", False),
        ("side=2.0", "side=2", False),
        ("*,", "", False),
        ("x + 1", "x - 1", False),
        ("math.pi", "math.tau", False),
        ("import math", "import cmath as math", False),
        ("size: int = 3", "size: int = 4", False),
        ('"abc"', '"abd"', False),
        ("def area", "def areas", False),
        ("class Mine", "class Mine(dict)", False),
        ("(lambda x: x + 1)", "(lambda x: 1 + x)", False),
    ],
)
def test_code_is_known_by_what_it_does(old: str, new: str, same: bool) -> None:
    assert old in CODE
    assert (code_sum(CODE.replace(old, new).encode()) == code_sum(CODE.encode())) is same
    assert code_sum(b"1 +") != code_sum(b"1 -")  # no Python at all


def test_the_key_of_a_part_has_what_users_code_imports(small: str, tmp_path, monkeypatch) -> None:
    (home := tmp_path / "home").mkdir()
    (elsewhere := tmp_path / "elsewhere").mkdir()
    monkeypatch.syspath_prepend(elsewhere)
    files = {
        home / "beside.py": "import deeper",
        home / "deeper.py": "import beside\nimport own.tools.one as one",
        elsewhere / "on_path.py": "x = 1",
        elsewhere / "late.py": "x = 1",
        elsewhere / "own/__init__.py": "from . import more",
        elsewhere / "own/more.py": "x = 1",
        elsewhere / "own/tools/__init__.py": "",
        elsewhere / "own/tools/one.py": "from ..sibling import x\nfrom .two import y",
        elsewhere / "own/tools/two.py": "y = 1",
        elsewhere / "own/sibling.py": "x = 1",
        home / "policy.py": (
            "import json, torch, pedzoo.core.errors\nimport beside, absent\nfrom on_path import x\n"
            "def f():\n    import late\n"
        ),
    }
    strangers = {home / "other.py": "x = 1", elsewhere / "own/unused.py": "x = 1", home / "notes.txt": ""}
    for file, text in (files | strangers).items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    policy = f"{home / 'policy.py'}:Mine"
    unit = Evaluation(["go_to_goal"], [small]).units[0]._replace(policy=policy, walks=policy)
    before = digest(unit)
    assert len({before, digest(unit)}) == 1
    for file, text in files.items():
        file.write_text(f"{text}\n# a comment\n")
        assert digest(unit) == before, file
        file.write_text(f"{text}\nz = 1\n")
        assert digest(unit) != before, file
        file.write_text(text)
    for file in strangers:
        file.write_text("z = 1")
    assert digest(unit) == before


def test_the_mean_of_cases_and_its_interval_by_hand() -> None:
    # deviations 0.3, 0.4 below and 0.06, 0.08 above add up in squares: 0.5 / 2 and 0.1 / 2
    assert mean_interval([0.5, 0.9], [(0.2, 0.56), (0.5, 0.98)]) == pytest.approx((0.45, 0.75))
    case = {"suite": "goals", "physics": "compiled"}
    seconds = {"wall": 1.0, "cpu": 0.5}
    common = {"table": "t", "case": case, "n": 20, "seconds": seconds}
    rows = [
        {"name": name, **common, "metrics": metrics, "ci95": ci95}
        for name, metrics, ci95 in (
            ("orca", {"success": 0.5, "time_s": 9.0}, {"success": (0.2, 0.56)}),
            ("orca", {"success": 0.9}, {"success": (0.5, 0.98)}),
            ("go_to_goal", {"success": 1.0}, {}),
        )
    ]
    mine, other = summary(rows)
    assert (mine["name"], mine["n"], mine["cases"], other["n"]) == ("orca", 40, 2, 20)
    assert mine["metrics"] == pytest.approx({"success": 0.7})  # not every person has a time
    assert mine["ci95"]["success"] == pytest.approx((0.45, 0.75))
    assert other["ci95"] == {} and mine["seconds"] == {"wall": 2.0, "cpu": 1.0}


def test_tables_and_pages_show_the_same_cells(small: str) -> None:
    for metrics, ci95, case, text in (
        ({"x": 0.926}, {"x": (0.88, 0.961)}, {}, "0.93 [0.88, 0.96]"),
        ({"x": 123.4}, {}, {"seen": "yes"}, "123*"),
        ({}, {}, {}, "-"),
    ):
        assert cell({"case": case, "metrics": metrics, "ci95": ci95}, "x") == text
    evaluation = Evaluation(["go_to_goal", "constant_velocity"], [small], EvaluationOptions(episodes=2))
    steps: list[ProgressReport] = []
    evaluation.run(progress=steps.append)
    done = [step.done for step in steps]
    assert (done[0], steps[0].label) == (0.0, f"{small} circle: go_to_goal")
    assert done == sorted(done) and math.isclose(done[-1], 1.0)
    assert (steps[-1].units, steps[-1].total, steps[-1].left) == (4, 4, pytest.approx(0.0, abs=1e-6))
    report = {**evaluation.report(), "versions": {"pedzoo": "0", "torch": "0"}}
    shown = {small: SuiteColumns(("success",), ("success", "failed", "no_row_has_it"), "episodes")}
    head, own, each = pages(report, shown)
    assert [row[0] for row in head.rows] == ["go_to_goal", "constant_velocity"]
    assert own.head == ["policy", "n", "success"] and each.head == ["policy", "circle", "two"]
    assert own.rows[0][1:] == ["4", head.rows[0][1]]
    text = markdown(report, shown, ["pedzoo", "evaluate", "a b"])
    assert "Made by `pedzoo evaluate 'a b'`" in text
    assert all(f"| {' | '.join(row)} |" in text for page in (head, own, each) for row in page.rows)


@pytest.mark.parametrize("columns", [80, 200])
def test_tables_fit_the_terminal(columns: int, small: str, capsys, monkeypatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal, as far as rich is concerned
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main(["evaluate", "go_to_goal", "--suite", small, "--episodes", "2"]) == 0
    plain = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert max(map(len, plain.splitlines())) <= columns
    assert ("[0.34," in plain or "[0.34, 1.00]" in plain) and "…" not in plain


def test_density_and_speed_of_a_replay_are_drawn(tmp_path) -> None:
    file = tmp_path / "density.png"
    curve = [{"density_per_m2": 0.1, "speed_m_per_s": None, "real_speed_m_per_s": 1.0, "real_share": 1.0}]
    case = {"suite": "replay", "fold": "embedded", "simulated": "all"}
    plot_density_speed([{"name": name, "case": case, "density_speed": curve} for name in ("a", "real")], file)
    assert file.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(UserError, match="evaluate the suite replay"):
        plot_density_speed([{"name": "a", "case": case}], file)


def test_clearance_and_deadline_are_those_of_all_cases() -> None:
    def units(*suites: str, **options: Any) -> list[WorkUnit]:
        return Evaluation(["go_to_goal"], suites, EvaluationOptions(**options)).units

    assert {unit.case.clearance for unit in units("door", "queues", clearance=0.15)} == {0.15}
    assert 0.15 not in {unit.case.clearance for unit in units("door", "queues")}
    known = {(unit.case.suite, unit.case.deadline) for unit in units("door", "replay", deadline=9.0)}
    assert known == {("door", 9.0), ("replay", None)}  # people of recordings have their own time
    report = pedzoo.evaluate(["go_to_goal"], ["door"], episodes=1, physics="compiled", deadline=1.0)
    assert {row["metrics"]["success"] for row in report["rows"]} == {0.0}
    assert report["protocol"]["deadline"] == 1.0
    for policy, suite, option, message in (
        ("straight", "robots", ("clearance", 0.2), "clearance: ways beside robots keep that of the bodies"),
        ("go_to_goal", "door", ("clearance", -1), "clearance -1: expected at least 0 m"),
        ("straight", "robots", ("deadline", 9.0), "deadline: robots have their own times"),
        ("go_to_goal", "door", ("deadline", -1), "deadline -1: expected a number of seconds above 0"),
    ):
        with pytest.raises(UserError, match=message):
            Evaluation([policy], [suite], EvaluationOptions()._replace(**dict([option])))
