"""Which machine a result was measured on."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from statistics import median
from typing import Any

import torch

from pedzoo.bench.turns import Clock, seconds_of


def machine() -> dict[str, Any]:
    """Return the processor, the system and how many processors there are."""
    return {"cpu": _cpu(), "cores": os.cpu_count() or 1, "system": platform.platform()}


def load() -> float | None:
    """Return how many programs wanted to run in the last minute; None where the system does not tell."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def yardstick(now: Clock, times: int = 20) -> float:
    """Return the milliseconds (median) of a fixed job like those that steps are made of.

    Between two runs on one machine it tells how much faster the machine was, whatever the code does: other
    programs take away its caches and its clock rate, which processor time does not show.
    """
    values = torch.linspace(0.0, 1.0, 20_000).view(-1, 2)

    def job() -> None:
        found = values
        for _ in range(50):
            found = (found * 1.01).clamp_max(1.0) + found.norm(dim=-1, keepdim=True).sqrt()

    job()
    return 1e3 * median(seconds_of(job, now) for _ in range(times))


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
