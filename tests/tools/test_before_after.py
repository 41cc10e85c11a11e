"""The comparison of a commit with the working tree: its table, and one side that answers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pedzoo.core.errors import UserError
from tools.bench import comparison
from tools.bench.peer import Peer, PeerCase, Scenes
from tools.bench.tables import print_bench
from tools.bench.turns import Side

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "tools" / "bench"


def case(name: str, *speeds: float, peer: str = "pedzoo", scenes: int = 64, physics: str = "") -> PeerCase:
    """Return a case that has one given speed after the other."""
    turns = iter(speeds)
    side: Side = lambda seconds: next(turns)  # noqa: E731
    return PeerCase(peer, name, scenes, 5, 0.4, physics, side)


def test_ratios_are_taken_turn_by_turn() -> None:
    before, after = case("env orca", 100, 200, 400), case("env orca", 300, 400, 1600)
    timed, failed = comparison.measure([("before", before), ("after", after)], 3, 0.1, lambda line: None)
    (row,) = comparison.rows(timed)
    assert not failed
    # turns: 3, 2, 4; the ratio of the medians would be 2
    assert row.metrics["times_before"].value == 3.0
    assert row.metrics["times_before"][1:3] == (2.5, 3.5)
    assert row.metrics["before_agent_steps_per_s"].value == 200
    # 64 x 5 agents at 400 agent-steps/s
    assert row.metrics["after_ms"].value == pytest.approx(800)
    assert [bar.ok for bar in row.bars] == [True]
    assert "times_before >= 1.5" in row.bars[0].bar


def test_both_sides_take_turns_and_peers_follow() -> None:
    cases = [
        ("before", case("env b", 1, 1)),
        ("before", case("env a", 1, 1)),
        ("after", case("env a", 1, 1)),
        ("after", case("env b", 1, 1)),
        ("X", case("a peer", 1, 1, peer="X")),
    ]
    lines: list[str] = []
    comparison.measure(cases, 2, 0.1, lines.append)
    order = ["before: env a", "after: env a", "before: env b", "after: env b", "X: a peer"]
    assert [line.split(", ")[1] for line in lines] == order + order[::-1]


def test_every_physics_is_compared_with_the_one_before() -> None:
    cases = [
        ("before", case("env go_to_goal", 10, physics="grid")),
        ("after", case("env go_to_goal", 40, physics="torch")),
        ("after", case("env go_to_goal", 40, physics="compiled")),
    ]
    timed, _ = comparison.measure(cases, 1, 0.1, lambda line: None)
    verdicts = {row.case["physics"]: row for row in comparison.rows(timed)}
    assert [row.metrics["times_before"].value for row in verdicts.values()] == [4.0, 4.0]
    assert verdicts["torch"].bars[0].ok is True  # 3 are asked
    assert verdicts["compiled"].bars[0].ok is False  # 5 are asked


def test_the_share_of_the_safety_layer() -> None:
    cases = [
        ("before", case("env model", 60, 50)),
        ("after", case("env model", 80, 80)),
        ("before", case("env model:safety=false", 100, 100)),
        ("after", case("env model:safety=false", 100, 100)),
    ]
    timed, _ = comparison.measure(cases, 2, 0.1, lambda line: None)
    (share,) = comparison.shares(timed)
    # a step of 1/100 s without it and of 1/80 s with it: a fifth of the time is the layer's
    assert share.metrics["after_percent"].value == pytest.approx(20)
    assert share.metrics["before_percent"].value == pytest.approx(45)
    assert share.bars[0].ok is True


def test_a_case_that_fails_is_left_out_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    def broken(seconds: float) -> float:
        raise UserError("no such physics")

    cases = [
        ("before", case("env a", 5, 5)),
        ("after", case("env a", 5, 5)._replace(side=broken)),
        ("X", case("bare", 7, 7, peer="X")),
    ]
    timed, failed = comparison.measure(cases, 2, 0.1, lambda line: None)
    assert failed == {"after: env a, 64 x 5": "no such physics"}
    result = comparison.rows(timed)
    assert [row.name for row in result] == ["X, bare"]
    machine = {"load_before": 0.0, "load_after": 0.0}
    report = {"protocol": {"threads": 1}, "machine": machine, "versions": {}, "skipped": failed}
    print_bench(report | {"rows": [row.as_json() for row in result]})
    assert "after: env a, 64 x 5: skipped: no such physics" in capsys.readouterr().out


def test_a_side_answers_for_this_checkout() -> None:
    side = Peer(BENCH / "side.py", sys.executable, 1, environment={"PYTHONPATH": str(ROOT)})
    try:
        (result, *more) = side.cases([Scenes("environment", 1, 5, {}, [], [], [], [], [])])
        assert (result.name, result.scenes, result.people) == ("env go_to_goal", 1, 5)
        assert len({one.note for one in (result, *more)}) == 1 + len(more)
        assert side.versions["tree"] == str(ROOT)
        assert result.side(0.01) > 0
    finally:
        side.close()


def test_wrong_sizes_are_refused() -> None:
    command = [sys.executable, str(BENCH / "before_after.py"), "--sections", "policies", "--size", "3x3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--size 3x3: none is measured in policies" in done.stderr
