"""Long runs: what grew is counted in each process, from the time at which it is warm."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tools.reliability import long_run


def row(done: int, memory: int, handles: int = 5) -> long_run.Row:
    return {"done": done, "memory": memory, "handles": handles}


def process(warm: long_run.Row | None, last: long_run.Row, *answers: str) -> long_run.Row:
    return {"warm": warm, "last": last, "answers": list(answers)}


def test_growth_is_counted_in_each_process_from_when_it_is_warm() -> None:
    begun = process(row(30, 100), row(60, 102, handles=6), "same")
    result = long_run.grown([begun, process(None, row(80, 40), "same")])
    expected = {"done": 80, "processes": 2, "judged": 30, "memory": 0.02, "handles": 1, "same": True}
    assert result == pytest.approx(expected)
    assert not long_run.grown([begun, process(None, row(80, 40), "other")])["same"]
    more = long_run.grown([begun, process(row(90, 40), row(100, 60), "same")])
    assert more["memory"] == pytest.approx(0.5) and more["judged"] == 40
    assert long_run.grown([])["done"] == 0


def test_a_run_goes_on_where_it_was_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    def comings(done: int) -> Iterator[long_run.Row]:
        begun.append(done)
        return (row(done + 50 * more, 100) for more in range(1, 100))

    monkeypatch.setattr(long_run, "comings", comings)
    runs: list[long_run.Row] = []
    saved: list[int] = []
    for wanted in (100, 300, 300):
        long_run.go_on("comings", wanted, runs, lambda: saved.append(runs[-1]["last"]["done"]))
    expected = {"done": 300, "processes": 2, "judged": 150, "memory": 0.0, "handles": 0, "same": True}
    assert long_run.grown(runs) == expected
    assert begun == [0, 100] and saved == [50, 100, 150, 200, 250, 300]
