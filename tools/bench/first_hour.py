"""Times what a newcomer waits for, at a commit and in the working tree in turns, and writes a table.

    python -m tools.bench.first_hour [--before COMMIT] [--turns N] [--demo]

Every case is a process of its own, by its processor time: other programs do not count. The numbers go to
checkpoints/results/FIRST_HOUR.json; ``python -m tools.pages.tables`` writes them into docs/speed.md.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path
from statistics import median
from typing import Any

from pedzoo.maps.grid import spread_points
from pedzoo.maps.plans import load_plan
from tools.bench.before_after import BEFORE, ROOT, checkout, commit, of
from tools.bench.turns import load, machine

RESULT = ROOT / "checkpoints" / "results" / "FIRST_HOUR.json"

PLAN, MODEL, GOALS = "office.0", "sgan_goal_map.indoor", 12
"""A plan of 28 x 12 m that comes with pedzoo, who walks there, and new goals in one process."""

COMMAND = "import sys; from pedzoo.cli.main import main; sys.exit(main(sys.argv[1:]))"

STEP = f"""
import time, pedzoo
places = PLACES
controller = pedzoo.load("{MODEL}").controller("{PLAN}", dt=0.1)
controller.step({{"ann": places[0]}}, {{"ann": places[1]}})
"""

NEW_GOAL = """
took = []
for goal in places[2:]:
    begin = time.process_time()
    controller.step({"ann": places[0]}, {"ann": goal})
    took.append(time.process_time() - begin)
print(sorted(took)[len(took) // 2])
"""

CASES: dict[str, tuple[str, ...]] = {
    "a misspelt policy: `pedzoo rollout ocra`": (COMMAND, "rollout", "ocra", "--scenario", "door"),
    "a misspelt scenario: `pedzoo rollout orca --scenario dor`": (
        COMMAND,
        "rollout",
        "orca",
        "--scenario",
        "dor",
    ),
    "a misspelt option: `pedzoo fit --config sgan_goal --model.lrr 1`": (
        *(COMMAND, "fit", "--config", "sgan_goal", "--data.fold", "embedded", "--model.lrr", "1"),
    ),
    "`pedzoo --help`": (COMMAND, "--help"),
    "`pedzoo fit --help`": (COMMAND, "fit", "--help"),
    "`import pedzoo`": ("import pedzoo",),
    "`load`, and a controller's first step, all imports": (STEP,),
    "a step of 0.1 s with a new goal": (STEP + NEW_GOAL,),
}
"""Code and arguments behind it; code that prints a number has measured itself, seconds."""

DEMO = "`pedzoo demo`"


def main(words: list[str]) -> int:
    """Measure, write and print; returns the exit code."""
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--before", default=BEFORE, help=f"a commit (default: {BEFORE})")
    parser.add_argument(
        "--turns", type=int, default=5, help="of each side; the table has medians (default: 5)"
    )
    parser.add_argument("--demo", action="store_true", help="the demo, too: minutes")
    options = parser.parse_args(words)
    places = spread_points(load_plan(PLAN), "wall", 0.5, 1.0, seed=0)[: GOALS + 2]
    points = repr([tuple(place) for place in places.tolist()])
    rows = json.loads(RESULT.read_text())["rows"] if RESULT.is_file() else {}
    cases = {name: (code.replace("PLACES", points), *rest) for name, (code, *rest) in CASES.items()}
    busy = load()
    with checkout(options.before) as tree, tempfile.TemporaryDirectory() as folder:
        sides = {"before": tree, "after": ROOT}
        took: dict[str, dict[str, list[float | None]]] = {
            name: {side: [] for side in sides} for name in cases
        }
        for turn in range(options.turns):
            for name, call in cases.items():
                for side in list(sides)[:: -1 if turn % 2 else 1]:
                    took[name][side].append(seconds(call, sides[side], Path(folder) / side))
        if options.demo:
            out = {side: (COMMAND, "demo", "--out", f"{folder}/{side}/demo") for side in sides}
            took[DEMO] = {side: [seconds(out[side], sides[side], Path(folder) / side)] for side in sides}
    rows |= {name: {side: middle(values) for side, values in both.items()} for name, both in took.items()}
    report = {
        **{
            "before": commit(options.before),
            "after": commit("HEAD"),
            "turns": options.turns,
            "clock": "processor time",
        },
        **{"machine": machine() | {"load_before": busy, "load_after": load()}, "rows": rows},
    }
    RESULT.write_text(json.dumps(report, indent=1) + "\n")
    print(page())
    return 0


def seconds(words: tuple[str, ...], tree: Path, home: Path) -> float | None:
    """Return how long a process takes, seconds, or what it measured; None where it knows no such call."""
    home.mkdir(exist_ok=True)
    variables = os.environ | of(tree) | {"XDG_CACHE_HOME": str(home)}
    call, begin = [sys.executable, "-c", *words], spent()
    done = subprocess.run(call, cwd=home, env=variables, capture_output=True, text=True, check=False)
    whole = spent() - begin
    if "Traceback" in done.stderr:
        print(f"{tree.name}: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return None
    last = (done.stdout.split() or [""])[-1]
    return float(last) if words[0].startswith(STEP[:20]) and last else whole


def spent() -> float:
    """Return the processor time of all processes that have ended so far, seconds."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def middle(values: list[float | None]) -> float | None:
    """Return the median of those that are known."""
    known = [value for value in values if value is not None]
    return round(median(known), 4) if known else None


def page() -> str:
    """Return the table, as Markdown."""
    report: dict[str, Any] = json.loads(RESULT.read_text())
    lines = [f"| {report['clock']}, s | {report['before']} | now | times as fast |", "|---|---|---|---|"]
    for name, row in report["rows"].items():
        before, after = row["before"], row["after"]
        ratio = "-" if before is None or after is None else f"{before / after:.1f}"
        lines.append(f"| {name} | {said(before)} | {said(after)} | {ratio} |")
    return "\n".join([*lines, "", f"Medians of {report['turns']} turns; the demo ran once.", ""])


def said(value: float | None) -> str:
    """Return seconds with two digits that count, or -."""
    return "-" if value is None else f"{value:.0f}" if value >= 10 else f"{value:.2g}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
