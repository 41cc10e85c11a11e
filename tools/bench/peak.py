"""What `tools.bench.sections.memory` runs in a process of its own: it walks, and prints its peaks of memory.

    python tools/bench/peak.py MAP SCENES STEPS GOALS

The output is one JSON object: megabytes at most until then, after each stage, and the floor plan's cells.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

MODEL = "sgan_goal_map.zara1"
PEOPLE = 5


def main(file: str, scenes: int, steps: int, goals: int) -> None:
    """Walk and print."""
    result = {"python alone": peak()}
    import torch

    from pedzoo.policies.load import load_policy
    from pedzoo.sim.make import make_env

    torch.set_num_threads(1)
    result["pedzoo and torch imported"] = peak()
    env = make_env(f"goals:map={file},people={PEOPLE},pool={goals}", scenes)
    result["planner ready"] = peak()
    policy = load_policy(MODEL)
    with torch.no_grad():
        now = env.reset()
        for _ in range(steps):
            _, now = env.step_and_maybe_reset(policy(now))
    result["walked"] = peak()
    print(json.dumps({"cells": env.bank.grids[0].cells.size, **result}))


def peak() -> float:
    """Return the largest resident memory until now in megabytes."""
    status = Path("/proc/self/status")
    if status.is_file():  # Linux' getrusage also counts what the parent had when it started this process
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / 1e6
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
