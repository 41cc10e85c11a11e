"""Runs benchmarks one after the other and keeps what they find."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import torch

from pedzoo.cli.progress import duration
from pedzoo.core.errors import UserError
from pedzoo.core.machine import versions
from pedzoo.maps.plans import load_plan
from tools.bench import BENCHMARKS, original_sgan, peer
from tools.bench.figures import Row
from tools.bench.section import NotGivenError, Section, Settings
from tools.bench.turns import load, machine, yardstick


def progress(name: str, done: int, left: Sequence[float], seconds: float, spent: float) -> str:
    """Return which section begins, and how long all that are left take.

    Args:
        name: Of the section.
        done: Sections before it.
        left: Seconds that it and those after it are expected to take.
        seconds: What those before it took.
        spent: What they were expected to take.
    """
    pace = seconds / spent if spent else 1.0
    return f"{name}: section {done + 1} of {done + len(left)}, about {duration(pace * sum(left))} to go"


class Run:
    """Some benchmarks under the same settings.

    Attributes:
        rows: What was measured until now.
        skipped: Why benchmarks that were not asked for by name were left out.
    """

    def __init__(self, names: Sequence[str], settings: Settings) -> None:
        """Take the names; none for all there are.

        Raises:
            UserError: There is no benchmark of a name, or something that was given is not there.
        """
        for script in settings.peers:
            peer.check(script, settings.peer_python)
        if settings.sgan is not None:
            original_sgan.check(settings.sgan)
        for plan in settings.maps:
            load_plan(plan)
        self.settings, self._asked = settings, bool(names)
        self._sections: dict[str, Section] = {}
        for name in names or BENCHMARKS.names():
            cls = BENCHMARKS.get(name)
            if not issubclass(cls, Section):
                raise UserError(
                    f"{name!r} is no benchmark: expected a subclass of tools.bench.section.Section"
                )
            self._sections[name] = cls(settings)
        self.rows: list[Row] = []
        self.skipped: dict[str, str] = {}
        self._load = [load()]
        self._yardstick: dict[str, float] = {}

    def go(self, tell: Callable[[Row], None], ahead: Callable[[str], None] = lambda _: None) -> None:
        """Measure everything; ``tell`` gets every row when it is known, ``ahead`` how long the rest takes.

        Raises:
            UserError: A benchmark that was asked for by name cannot be run, or a peer failed; `rows` has
                what was measured until then.
        """
        before = torch.get_num_threads()
        torch.set_num_threads(self.settings.threads)
        begin, expected = time.monotonic(), [one.expected for one in self._sections.values()]
        try:
            for number, (name, section) in enumerate(self._sections.items()):
                spent, left = sum(expected[:number]), expected[number:]
                ahead(progress(name, number, left, time.monotonic() - begin, spent))
                before_it = yardstick(self.settings.clock)
                try:
                    for row in section.rows():
                        self.rows.append(row)
                        tell(row)
                    self._yardstick[name] = (before_it + yardstick(self.settings.clock)) / 2
                except NotGivenError as error:
                    if self._asked:
                        raise
                    self.skipped[name] = str(error)
        finally:
            torch.set_num_threads(before)
            self._load.append(load())

    def report(self) -> dict[str, Any]:
        """Return everything in the form of ``--json``."""
        settings = self.settings
        peers: dict[str, str] = {}
        for section in self._sections.values():
            peers |= section.versions
        protocol = {
            "sections": list(self._sections),
            "seconds_per_turn": settings.seconds,
            "turns": settings.turns,
            "quick": settings.quick,
            "threads": settings.threads,
            "sizes": [f"{scenes} x {people}" for scenes, people in settings.sizes],
            "device": "cpu",
            "clock": "processor time" if settings.threads == 1 else "wall time",
            "maps": list(settings.maps),
        }
        return {
            "command": "bench",
            "protocol": protocol,
            "machine": machine() | {"load_before": self._load[0], "load_after": self._load[-1]},
            "versions": versions() | peers,
            "yardstick_ms": self._yardstick,
            "skipped": self.skipped,
            "rows": [row.as_json() for row in self.rows],
        }
