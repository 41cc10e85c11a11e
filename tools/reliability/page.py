"""RELIABILITY.md of what the tools beside this one wrote down.

    python -m tools.reliability.page fuzz.json kills.json long_run.json

Figures of a reader or a run take the place of earlier ones; all others stay, in RELIABILITY.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from pedzoo.core.paths import write_whole
from tools.reliability.kills import TRAININGS
from tools.reliability.long_run import grown
from tools.reliability.readers import READERS

RESULTS = Path(__file__).parents[2] / "checkpoints" / "results"

LONG = {"comings": 2000, "torch": 10_000_000, "bullet": 100_000}
"""What is wanted of long runs: comings and goings, and agent-steps."""

INPUTS = 100_000
"""What is wanted of each reader."""

Figures = dict[str, dict[str, Any]]


def read(file: Path) -> Figures:
    """Return the figures in a file that is called as the tool wrote it.

    Raises:
        SystemExit: It is of no tool here.
    """
    state = json.loads(file.read_text())
    if file.stem.startswith("fuzz"):
        return {"fuzz": state}
    if file.stem.startswith("kills"):
        return {"kills": {kind: summed(done) for kind, done in state.items()}}
    if file.stem.startswith("long_run"):
        return {"long": {name: grown(rows, LONG[name]) for name, rows in state.items() if rows}}
    raise SystemExit(f"{file}: expected fuzz, kills or long_run .json")


def summed(done: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many trainings and kills there were, and what became of them."""
    sums = {name: sum(one[name] for one in done) for name in ("kills", "not ended by itself")}
    return {"trainings": len(done), **sums, "wrong": [one["wrong"] for one in done if one["wrong"]]}


def page(figures: Figures) -> str:
    """Return the page."""
    fuzz, kills, runs = (figures.get(name, {}) for name in ("fuzz", "kills", "long"))
    lines = [
        f"| {name} | {fuzz[name]['inputs']:,} | {'; '.join(sorted(fuzz[name]['complaints'])) or 'none'} |"
        for name in READERS
        if name in fuzz
    ]
    missing = [name for name in READERS if fuzz.get(name, {"inputs": 0})["inputs"] < INPUTS]
    goal = f"{INPUTS:,} for each reader are wanted"
    goal += f", and still missing of {', '.join(missing)}." if missing else ", and done."
    killed = [
        f"| {kind} | {one['trainings']} | {one['kills']} | {one['not ended by itself']} "
        f"| {len(one['wrong'])} |"
        for kind in TRAININGS
        if (one := kills.get(kind))
    ]
    long = [
        f"| {name} | {one['done']:,} of {LONG.get(name.partition(',')[0], 0):,} | {one['processes']} "
        f"| {one['memory']:.2%} over {one['judged']:,} | {one['handles']} "
        f"| {'the same' if one['same'] else 'others'} |"
        for name, one in sorted(runs.items())
    ]
    return TEXT.format(goal=goal, fuzz="\n".join(lines), kills="\n".join(killed), long="\n".join(long))


TEXT = """# Reliability: what was tried, how often, and what was lost

All tools go on where they were when they are called again, and `python -m tools.reliability.page FILES`
makes this page.

## Hostile contents

`python -m tools.reliability.fuzz`: sound contents with one to four mistakes. A reader reads them or refuses
them in words of at most 5,000 signs, within 2 s of a processor, and writes nothing else. {goal}

| reader | inputs | complaints |
|---|---|---|
{fuzz}

What runs found is mended, and in `tests/corpus`: long messages, names that no file system takes, numbers of
people of 40 and of 1,900 digits, and recordings of one column below an empty line.

## Kills

`python -m tools.reliability.kills`: trainings of 8 epochs, each killed up to twice at random moments, as a
whole or one process of two. They are resumed, and compared with one that nobody killed. Lost means: other
weights, or another `metrics.csv`.

| training | trainings | kills | processes left over | lost |
|---|---|---|---|---|
{kills}

Kills in writes, torn journals, two resumes at once, full disks (an error of the system in the place of a
disk), signals, cut downloads, dead workers and a dead client of pybullet are tests of the suite
(`tests/train/test_run_folder.py`, `tests/train/test_signals.py`, `tests/eval`, `tests/core`, `tests/sim`).
Nothing was lost in them. Once by hand: a disk of 1.1 MB in memory was full in the second epoch of sgan; on a
larger one the run went on, and ended with the same weights and rows.

## Long runs

`python -m tools.reliability.long_run` (bullet with `--physics bullet --agent-steps 100000`): people walk
through doors by `sgan_goal.zara1`; `comings` are people who come to one controller and go. Growth is that
of a process from 30 % of the run on.

| run | done | processes | growth of memory | more open files | answers at the end |
|---|---|---|---|---|---|
{long}

oneDNN keeps 1,024 compiled programs by shape, and the number of people in a batch never stops changing:
that is what grew without a limit. The tool limits that cache to 16 (`ONEDNN_PRIMITIVE_CACHE_CAPACITY`).
"""


def main() -> None:
    """Take new figures in, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    options = parser.parse_args()
    kept = RESULTS / "RELIABILITY.json"
    figures: Figures = json.loads(kept.read_text()) if kept.is_file() else {}
    for file in options.files:
        for part, values in read(file).items():
            figures.setdefault(part, {}).update(values)
    write_whole(kept, f"{json.dumps(figures, indent=1)}\n".encode())
    write_whole(kept.with_suffix(".md"), page(figures).encode())


if __name__ == "__main__":
    main()
