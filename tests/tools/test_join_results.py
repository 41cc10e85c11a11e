"""A page of an evaluation whose policies were evaluated at different times."""

from __future__ import annotations

from typing import Any

import pytest

from tools.pages.join_results import joined


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
