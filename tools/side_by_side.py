"""Times two programs in turns and prints them side by side."""

from __future__ import annotations

import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import lightning as L
from rich.console import Console
from rich.table import Table

from pedzoo.cli.output import write_json
from pedzoo.versions import versions


@dataclass(frozen=True)
class Row:
    """One comparison.

    Attributes:
        what: What was timed.
        peer_ms: Median of the other program.
        pedzoo_ms: Median of ours.
        bar: How many times faster ours has to be; None where nothing was promised.
        n: How often each was timed.
    """

    what: str
    peer_ms: float
    pedzoo_ms: float
    bar: float | None
    n: int

    @property
    def ratio(self) -> float:
        """How many times faster ours is."""
        return self.peer_ms / self.pedzoo_ms


def row(what: str, bar: float | None, theirs: list[float], ours: list[float]) -> Row:
    """Return the row of the seconds that both took, and tell that it is there."""
    found = Row(what, 1e3 * statistics.median(theirs), 1e3 * statistics.median(ours), bar, len(ours))
    print(f"{what}: {found.peer_ms:.3g} ms, {found.pedzoo_ms:.3g} ms", file=sys.stderr)
    return found


def race(
    what: str, bar: float | None, theirs: Callable[[], Any], ours: Callable[[], Any], times: int
) -> tuple[Row, tuple[Any, Any]]:
    """Time two functions in turns, after one run of each that is not counted; returns also its results."""
    results = theirs(), ours()
    taken = [(seconds(theirs), seconds(ours)) for _ in range(times)]
    return row(what, bar, [a for a, _ in taken], [b for _, b in taken]), results


def seconds(function: Callable[[], Any]) -> float:
    """Return how long a call takes."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


class Turns(L.Callback):
    """Runs an iteration of the other program before each of our training loop, and times both."""

    def __init__(self, other: Callable[[int], None]) -> None:
        """Take what runs the other program's iteration of a given number."""
        self.other = other
        self.theirs: list[float] = []
        self.ours: list[float] = []
        self.start = 0.0

    def on_train_batch_start(
        self, trainer: L.Trainer, pl_module: L.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        """Let the other program go first."""
        self.theirs.append(seconds(lambda: self.other(batch_idx)))
        self.start = time.perf_counter()

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop our clock."""
        self.ours.append(time.perf_counter() - self.start)


def report(title: str, rows: list[Row], agreement: dict[str, dict[str, float]], file: str | None) -> None:
    """Print the table and how far the answers were apart, and write both to a JSON ``file``."""
    table = Table("what", "peer, ms", "pedzoo, ms", "times", "bar", title=title)
    for r in rows:
        bar = "" if r.bar is None else f"{r.bar:g} {'ok' if r.ratio >= r.bar else 'MISSED'}"
        table.add_row(r.what, f"{r.peer_ms:.4g}", f"{r.pedzoo_ms:.4g}", f"{r.ratio:.1f}", bar)
    console = Console(width=110)
    console.print(table)
    for name, found in agreement.items():
        apart = ", ".join(f"{key} {value:.1e}" for key, value in found.items())
        console.print(f"{name}, same weights and noise, largest difference: {apart}")
    machine = {"cpu": _cpu(), "system": platform.platform(), "load": f"{os.getloadavg()[0]:.1f}"}
    console.print(", ".join(f"{key} {value}" for key, value in (versions() | machine).items()))
    if file:
        content = {"title": title, "versions": versions(), "machine": machine, "agreement": agreement}
        write_json(file, content | {"rows": [asdict(r) | {"ratio": r.ratio} for r in rows]})


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine()
    )
