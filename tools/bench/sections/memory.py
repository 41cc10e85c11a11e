"""Memory: the peak of a fresh process in which SGAN+goal+map walks on the largest floor plan."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from pedzoo.core.errors import UserError
from pedzoo.maps.plans import load_plan
from tools.bench.figures import Measured, Row, Verdict
from tools.bench.section import NotGivenError, Section

SCENES, STEPS, GOALS = 64, 20, 64
QUICK = 4, 2, 8
BAR_MB = 2000.0
PEAK = Path(__file__).parents[1] / "peak.py"


class Memory(Section):
    """64 scenes of 5 people, 64 goals, 20 steps, on the floor plan with the most cells.

    The bar is about the largest floor plan that is given. Without any, ``flat`` is measured without a bar.
    """

    takes = 14, 16

    def rows(self) -> Iterator[Row]:
        """Measure once; memory hardly differs from run to run."""
        if not find_spec("resource"):
            raise NotGivenError("memory is measured with the module resource, which Python lacks here")
        file = max(self.settings.maps, key=cells) if self.settings.maps else "flat"
        scenes, steps, goals = QUICK if self.settings.quick else (SCENES, STEPS, GOALS)
        command = [sys.executable, str(PEAK), file, str(scenes), str(steps), str(goals)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise UserError(f"memory: the process that walks on {file} ended: {done.stderr.strip()[-300:]}")
        result: dict[str, float] = json.loads(done.stdout)
        name = file.rpartition("/")[2].removesuffix(".yaml")
        where = {"size": f"{scenes} x 5", "map": f"{name}, {result.pop('cells'):,.0f} cells"}
        for what, megabytes in result.items():
            row = Row("memory", what, where, {"peak_mb": Measured.of([megabytes])})
            bars = [self._bar(row)] if what == list(result)[-1] else []
            yield replace(row, bars=bars)

    def _bar(self, row: Row) -> Verdict:
        """Return the verdict on the whole peak, where it is one on the whole task."""
        verdict = row.below("peak_mb", BAR_MB)
        if not self.settings.maps:
            return Verdict(verdict.bar, None, "no floor plans given (--map FILE...)")
        if self.settings.quick:
            return Verdict(verdict.bar, None, f"{QUICK[0]} scenes in place of {SCENES} (--quick)")
        return verdict


def cells(file: str) -> int:
    """Return how many cells a floor plan has."""
    return load_plan(file).cells.size
