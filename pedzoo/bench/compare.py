"""What has changed between two runs, as far as two runs can be compared."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pedzoo.bench.figures import Measured, Row, is_ratio, more_is_better
from pedzoo.errors import UserError

LEAST = 0.05
"""Smaller changes are noise, however narrow the quartiles are."""

Mark = Literal["faster", "slower", "more", "less", ""]


class Change(NamedTuple):
    """One figure in two runs.

    Attributes:
        row: Where it is in the new run.
        metric: Which of its metrics.
        old: Before.
        new: Now.
    """

    row: Row
    metric: str
    old: Measured
    new: Measured

    @property
    def ratio(self) -> float:
        """New divided by old; NaN where old was nothing."""
        return self.new.value / self.old.value if self.old.value else float("nan")

    @property
    def mark(self) -> Mark:
        """Whether it is better or worse beyond noise.

        Noise is a change of less than 5 %, or one after which the quartiles still overlap.
        """
        apart = self.new.low > self.old.high or self.new.high < self.old.low
        if not apart or not abs(self.new.value - self.old.value) > LEAST * abs(self.old.value):
            return ""
        up = self.new.value > self.old.value
        if self.metric.endswith(("_mb", "percent")):
            return "more" if up else "less"
        return "faster" if up == more_is_better(self.metric) else "slower"


class Comparison(NamedTuple):
    """Two runs side by side.

    Attributes:
        warnings: What differs between the runs besides the code, and what follows from it.
        changes: Figures that both have, as far as they can be compared.
        gone: Titles of figures that only the old run has.
        added: And of those that only the new run has.
    """

    warnings: list[str]
    changes: list[Change]
    gone: list[str]
    added: list[str]


def read_report(file: str | Path) -> dict[str, Any]:
    """Return a report that ``pedzoo bench --json`` wrote.

    Raises:
        UserError: It is not there, or something else.
    """
    try:
        content = json.loads(Path(file).read_text())
        for row in content["rows"]:
            Row.from_json(row)
        known = all(isinstance(content[key], dict) for key in ("protocol", "machine", "versions"))
    except OSError as error:
        raise UserError(f"--compare {str(file)!r}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"--compare {str(file)!r}: no report of `pedzoo bench --json`: {error!r}") from error
    if content.get("command") != "bench" or not known:
        raise UserError(f"--compare {str(file)!r}: a report, but not of `pedzoo bench`")
    return content


def compare(old: Mapping[str, Any], new: Mapping[str, Any]) -> Comparison:
    """Return what two reports of `pedzoo.bench.run.Run` have in common, and what has changed in it.

    Where the machine or the number of threads differs, only ratios within a run are compared: milliseconds
    of two machines say nothing about the code.
    """
    warnings = []
    for key in ("cpu", "cores", "system"):
        if old["machine"].get(key) != new["machine"].get(key):
            warnings.append(f"another {key}: {old['machine'].get(key)} then, {new['machine'].get(key)} now")
    foreign = [word for word in warnings if word.startswith(("another cpu", "another cores"))]
    protocol = {**old["protocol"]}, {**new["protocol"]}
    for key in ("threads", "device", "clock"):
        if protocol[0].get(key) != protocol[1].get(key):
            warnings.append(f"another {key}: {protocol[0].get(key)} then, {protocol[1].get(key)} now")
            foreign.append(warnings[-1])
    for key in ("quick", "seconds_per_turn", "turns"):
        if protocol[0].get(key) != protocol[1].get(key):
            warnings.append(f"measured with {key} {protocol[0].get(key)} then, {protocol[1].get(key)} now")
    for name in sorted({*old["versions"], *new["versions"]} - {"pedzoo", "commit"}):
        then, now = old["versions"].get(name, "absent"), new["versions"].get(name, "absent")
        if then != now:
            warnings.append(f"another {name}: {then} then, {now} now")
    if foreign:
        warnings.append("only ratios measured within one run are compared: nothing else is comparable")

    before = {row.key: row for row in map(Row.from_json, old["rows"])}
    after = {row.key: row for row in map(Row.from_json, new["rows"])}
    changes = [
        Change(row, metric, before[key].metrics[metric], found)
        for key, row in after.items()
        if key in before
        for metric, found in row.metrics.items()
        if metric in before[key].metrics and (is_ratio(metric) or not foreign)
    ]
    gone = [title(row) for key, row in before.items() if key not in after]
    return Comparison(
        warnings, changes, gone, [title(row) for key, row in after.items() if key not in before]
    )


def title(row: Row) -> str:
    """Return a row's name and case in one line."""
    case = ", ".join(str(value) for value in row.case.values())
    return f"{row.section}: {row.name}" + (f" ({case})" if case else "")
