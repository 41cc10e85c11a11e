"""docs/evaluate.md explains every metric."""

from __future__ import annotations

import re

from helpers.pages import PAGES

from pedzoo.metrics.closed_loop import NAMES

PAGE = PAGES["docs/evaluate.md"]


def test_every_metric_has_a_row_with_formula_and_unit() -> None:
    rows = re.findall(r"^\| (`.*?) \| (.+?) \| (.+?) \| (.+?) \| (.+?) \|$", PAGE, re.MULTILINE)
    explained: set[str] = set()
    for cell, formula, unit, better, _ in rows:
        names = re.findall(r"`(\w+)`", cell)
        explained |= {name if not name.startswith("_") else names[0] + name for name in names}
        assert formula and unit and better in ("higher", "lower", "real", "1", "-"), cell
    assert set(NAMES) - explained == set()
