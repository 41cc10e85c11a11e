"""What has changed between two runs, as far as two runs can be compared."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pedzoo.core.errors import UserError
from tools.bench.figures import Measured, Row, is_ratio, more_is_better

LEAST = 1.05
"""Smaller factors are noise, however narrow the quartiles are."""

WARN_ABOVE = 1.1
"""Larger factors between the machine then and now give a warning."""

PARTS = ("protocol", "machine", "versions", "yardstick_ms")

Mark = Literal["faster", "slower", "more", "less", ""]


class Change(NamedTuple):
    """One figure in two runs.

    Attributes:
        row: Where it is in the new run.
        metric: Which of its metrics.
        old: Before.
        new: Now.
        machine: How many times as long a fixed job took on the machine in the new run as in the old one.
    """

    row: Row
    metric: str
    old: Measured
    new: Measured
    machine: float = 1.0

    @property
    def ratio(self) -> float:
        """New divided by old; NaN where old was nothing."""
        return self.new.value / self.old.value if self.old.value else float("nan")

    @property
    def mark(self) -> Mark:
        """Whether it is better or worse beyond noise.

        Noise is a change of less than 5 %, or one after which the quartiles still overlap. A time or a speed
        has to change by 5 % more than that of a fixed job on the machine.
        """
        apart = self.new.low > self.old.high or self.new.high < self.old.low
        within = is_ratio(self.metric) or self.metric.endswith("_mb")
        least = LEAST * (1.0 if within else max(self.machine, 1 / self.machine))
        if not apart or not self.ratio > 0 or max(self.ratio, 1 / self.ratio) <= least:
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
        gone: Titles of figures that only the old run has, of benchmarks that both ran.
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
        known = all(isinstance(content[key], dict) for key in PARTS)
    except OSError as error:
        raise UserError(f"--compare {str(file)!r}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"--compare {str(file)!r}: no report of `pedzoo bench --json`: {error!r}") from error
    if content.get("command") != "bench" or not known:
        raise UserError(f"--compare {str(file)!r}: a report, but not of `pedzoo bench`")
    return content


def compare(old: Mapping[str, Any], new: Mapping[str, Any]) -> Comparison:
    """Return what two reports of `tools.bench.run.Run` have in common, and what has changed in it.

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
    for name in sorted(({*old["versions"]} & {*new["versions"]}) - {"pedzoo", "commit"}):
        then, now = old["versions"][name], new["versions"][name]
        if then != now:
            warnings.append(f"another {name}: {then} then, {now} now")
    if foreign:
        warnings.append("only ratios measured within one run are compared: nothing else is comparable")

    before = {row.key: row for row in map(Row.from_json, old["rows"])}
    after = {row.key: row for row in map(Row.from_json, new["rows"])}
    machine = machine_changes(old["yardstick_ms"], new["yardstick_ms"])
    for name, factor in machine.items():
        if max(factor, 1 / factor) > WARN_ABOVE and not foreign:
            how = f"{max(factor, 1 / factor):.2f} times as {'slow' if factor > 1 else 'fast'}"
            warnings.append(f"{name}: the machine itself was {how} now: smaller changes are not marked")
    changes = [
        Change(row, metric, before[key].metrics[metric], result, machine.get(row.section, 1.0))
        for key, row in after.items()
        if key in before
        for metric, result in row.metrics.items()
        if metric in before[key].metrics and (is_ratio(metric) or not foreign)
    ]
    measured = {row.section for row in after.values()} & {row.section for row in before.values()}
    gone = [title(row) for key, row in before.items() if key not in after and row.section in measured]
    added = [title(row) for key, row in after.items() if key not in before and row.section in measured]
    return Comparison(warnings, changes, gone, added)


def machine_changes(old: Mapping[str, float], new: Mapping[str, float]) -> dict[str, float]:
    """Return by how much the machine itself was slower in each benchmark, from both runs' yardsticks."""
    return {name: now / old[name] for name, now in new.items() if name in old}


def title(row: Row) -> str:
    """Return a row's name and case in one line."""
    case = ", ".join(str(value) for value in row.case.values())
    return f"{row.section}: {row.name}" + (f" ({case})" if case else "")
