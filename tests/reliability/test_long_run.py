"""Long runs: what grew is counted in each process, from the time at which it is warm."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.reliability import long_run


def row(process: int, done: int, memory: int, handles: int = 5, answer: str = "same") -> long_run.Row:
    return {"process": process, "done": done, "memory": memory, "handles": handles, "answer": answer}


def test_growth_is_counted_in_each_process_from_when_it_is_warm() -> None:
    rows = [row(0, 10, 50), row(0, 30, 100), row(0, 60, 102, handles=6), row(1, 70, 10), row(1, 80, 40)]
    result = long_run.grown(rows, 100)
    assert result["memory"] == pytest.approx(0.02)
    assert result == {
        "done": 80,
        "processes": 2,
        "judged": 30,
        "memory": result["memory"],
        "handles": 1,
        "same": True,
    }
    assert not long_run.grown([*rows, row(1, 90, 40, answer="other")], 100)["same"]
    assert long_run.grown([*rows, row(1, 90, 40), row(1, 100, 60)], 100)["memory"] == pytest.approx(0.5)


def test_a_run_goes_on_where_it_was_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    def comings(done: int) -> object:
        begun.append(done)
        return ({"done": done + 50 * more, "memory": 100, "handles": 5} for more in range(1, 100))

    monkeypatch.setattr(long_run, "comings", comings)
    state = tmp_path / "long_run.json"
    assert long_run.go_on("comings", 100, state)["done"] == 100
    assert long_run.go_on("comings", 300, state) == {
        "done": 300, "processes": 2, "judged": 100, "memory": 0.0, "handles": 0, "same": True
    }  # fmt: skip
    assert begun == [0, 100] and len(json.loads(state.read_text())["comings"]) == 6
    assert long_run.go_on("comings", 300, state)["done"] == 300 and begun == [0, 100]
