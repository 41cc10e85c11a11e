"""How `pedzoo bench` prints what was measured, and what has changed since another run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from rich.console import Console
from rich.table import Table

from pedzoo.cli.progress import plain_console
from tools.bench.compare import Comparison, title
from tools.bench.figures import Measured, Row


def print_bench(report: dict[str, Any]) -> None:
    """Print a report of `tools.bench.run.Run`: one table per benchmark, then where it was measured."""
    console = plain_console()
    rows = [Row.from_json(row) for row in report["rows"]]
    for section, result in groupby(rows, lambda row: row.section):
        _print_section(console, section, list(result))
    for section, why in report["skipped"].items():
        console.print(f"{section}: skipped: {why}")
    for part in ("protocol", "machine", "versions"):
        facts = ", ".join(f"{key} {value}" for key, value in report[part].items() if value not in ([], None))
        console.print(f"{part}: {facts}")
    busy = max(report["machine"][key] or 0.0 for key in ("load_before", "load_after"))
    if busy > report["protocol"]["threads"] + 0.5:
        console.print(f"the machine was busy (load {busy:g}): trust the ratios, not the speeds")
    verdicts = [(row, verdict) for row in rows for verdict in row.bars]
    judged = [verdict.ok for _, verdict in verdicts if verdict.ok is not None]
    total = f"{sum(judged)} of {len(judged)} bars met" if judged else "no bars judged"
    console.print(f"\n{total}")
    for row, verdict in verdicts:
        if not verdict.ok:
            why = f": {verdict.why}" if verdict.why else ""
            console.print(f"  {title(row)}: {verdict}{why}", soft_wrap=True)


def print_comparison(comparison: Comparison, file: str) -> None:
    """Print every figure of two runs, and mark those that have changed beyond noise."""
    console = plain_console()
    for warning in comparison.warnings:
        console.print(f"warning: {warning}")
    table = Table("figure", "metric", "old", "new", "new / old", "", title=f"since {file}")
    for change in comparison.changes:
        values = text(change.old), text(change.new), f"{change.ratio:.3g}", change.mark
        table.add_row(title(change.row), change.metric, *values)
    console.print(table)
    for name, titles in (("only then", comparison.gone), ("only now", comparison.added)):
        if titles:
            console.print(f"{name}: {'; '.join(titles)}")
    marked = [change for change in comparison.changes if change.mark]
    console.print(
        f"{len(marked)} of {len(comparison.changes)} figures changed beyond noise: by 5 %, quartiles apart"
    )


def line(row: Row) -> str:
    """Return a row in one line, for those who wait."""
    result = ", ".join(f"{metric} {text(value)}" for metric, value in row.metrics.items())
    return f"{title(row)}: {result}"


def text(result: Measured) -> str:
    """Return a value and half the distance of its quartiles, in percent of it."""
    digits = f"{result.value:,.0f}" if abs(result.value) >= 1000 else f"{result.value:.3g}"
    if result.n == 1 or not result.value:
        return digits
    return f"{digits} ±{50 * (result.high - result.low) / abs(result.value):.0f}%"


def _print_section(console: Console, section: str, rows: Sequence[Row]) -> None:
    cases, metrics = _union(row.case for row in rows), _union(row.metrics for row in rows)
    table = Table(title=f"{section}: medians ± half the distance of the quartiles", title_justify="left")
    table.add_column("name", overflow="fold")
    for name in (*cases, *(_broken(metric) for metric in metrics), *(["bars"] if _barred(rows) else [])):
        table.add_column(name, justify="left" if name in (*cases, "bars") else "right")
    for _, block in groupby(rows, lambda row: str(row.case)):
        for row in block:
            values = [text(row.metrics[metric]) if metric in row.metrics else "" for metric in metrics]
            bars = ["\n".join(map(str, row.bars))] if _barred(rows) else []
            table.add_row(row.name, *(str(row.case.get(key, "")) for key in cases), *values, *bars)
        table.add_section()
    console.print(table)
    notes = {
        note: [row.name for row in rows if row.note == note] for note in (row.note for row in rows) if note
    }
    for note, names in notes.items():
        console.print(f"  {', '.join(dict.fromkeys(names))}: {note}")
    console.print()


def _barred(rows: Sequence[Row]) -> bool:
    return any(row.bars for row in rows)


def _union(groups: Iterable[Iterable[str]]) -> list[str]:
    return list(dict.fromkeys(name for group in groups for name in group))


def _broken(metric: str) -> str:
    """Break a metric's name at underscores into lines of about twelve letters."""
    lines = [""]
    for part in metric.split("_"):
        if lines[-1] and len(lines[-1]) + len(part) > 12:
            lines.append("")
        lines[-1] += f"{part}_"
    return "\n".join(lines)[:-1]
