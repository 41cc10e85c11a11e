"""RELIABILITY.md: what was tried, how often, and what was lost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tools.reliability.kills import summed
from tools.reliability.long_run import grown

State = dict[str, dict[str, Any]]
"""What was done: by part, and in it by reader, kind of training or run."""


class Goals(NamedTuple):
    """What is wanted.

    Attributes:
        fuzz: Inputs of each reader.
        kills: Trainings of each kind.
        long: Agent-steps of each run, or people who come to a controller.
    """

    fuzz: int = 100_000
    kills: int = 10
    long: Mapping[str, int] = {"comings": 2000, "torch": 10_000_000, "bullet": 100_000}


def page(state: State, goals: Goals) -> str:
    """Return the page."""
    suite = [
        f"| {kind} | {one['tests']} | {', '.join(one['failed']) or 'none'} |"
        for kind, one in state["suite"].items()
    ]
    fuzz = [
        f"| {name} | {one['inputs']:,} | {one['read'] / max(one['inputs'], 1):.0%} "
        f"| {'; '.join(sorted({text.partition(':')[0] for text in one['complaints'].values()})) or 'none'} |"
        for name, one in state["fuzz"].items()
    ]
    missing = [name for name, one in state["fuzz"].items() if one["inputs"] < goals.fuzz]
    goal = f"{goals.fuzz:,} for each reader are wanted"
    goal += f", and still missing of {', '.join(missing)}." if missing else ", and done."
    kills = [
        f"| {kind} | {one['trainings']} of {goals.kills} | {one['kills']} | {one['not ended by itself']} "
        f"| {len(one['wrong'])} |"
        for kind, one in ((kind, summed(done)) for kind, done in state["kills"].items())
    ]
    long = [
        f"| {name} | {one['done']:,} of {goals.long[name]:,} | {one['processes']} "
        f"| {one['memory']:.2%} over {one['judged']:,} | {one['handles']} "
        f"| {'the same' if one['same'] else 'others'} |"
        for name, one in ((name, grown(runs)) for name, runs in state["long"].items())
    ]
    parts = {"suite": suite, "fuzz": fuzz, "kills": kills, "long": long}
    return TEXT.format(
        goal=goal, **{name: "\n".join(lines or ["| not yet |"]) for name, lines in parts.items()}
    )


def wrong(state: State) -> list[str]:
    """Return what was lost, did harm or grew, in words."""
    result = [f"{kind}: {name}" for kind, one in state["suite"].items() for name in one["failed"]]
    for one in state["fuzz"].values():
        result += [f"{file}: {text}" for file, text in one["complaints"].items()]
    for kind, done in state["kills"].items():
        result += [f"{kind}: {one['wrong']}" for one in done if one["wrong"]]
        result += [f"{kind}: a process was left over" for one in done if one["not ended by itself"]]
    for name, runs in state["long"].items():
        one = grown(runs)
        if one["memory"] > GROWTH or one["handles"] > 0 or not one["same"]:
            result.append(f"{name}: something grew, or the answers are others: {one}")
    return result


GROWTH = 0.01
"""By how much memory may grow."""

TEXT = """# Reliability: what was tried, how often, and what was lost

`python -m tools.reliability` does all of this, and goes on where it was when it is called again.
With `--quick` it does little of each. Its figures are in `RELIABILITY.json`.

## Tests that are attacks

`python -m tools.reliability suite`: tests of the suite, by what goes wrong in them. A full disk is an error
of the system there. Once a disk of 1.1 MB was full in the second epoch of sgan. On a larger one the run went
on, and ended with the same weights and rows.

| what goes wrong | tests | failed |
|---|---|---|
{suite}

## Hostile contents

`python -m tools.reliability fuzz`: sound contents with one to four mistakes. A reader reads them or refuses
them in words of at most 5,000 signs. It takes at most 1 s of a processor and 1 GB of memory. It writes no
other file, starts no program and asks no server. Half of the mistakes in pictures, weights and checkpoints
are inside, below sums and lengths that are right. {goal}

| reader | inputs | read | complaints |
|---|---|---|---|
{fuzz}

What runs found is mended, and in `tests/corpus`: `tests/reliability/test_fuzz.py` reads it again.

## Kills

`python -m tools.reliability kills`: trainings of 8 epochs (of 3 for `closed_loop/social_walker`), each killed
up to twice at random moments, as a whole or one process of two. They are resumed, and compared with one that
was not killed. Lost means: other weights, or another `metrics.csv`, speeds apart. Each class of trainer that
a config names is here.

| training | trainings | kills | processes left over | lost |
|---|---|---|---|---|
{kills}

## Long runs

`python -m tools.reliability long`: people walk through doors by `sgan_goal.zara1`, and `comings` are people
who come to one controller and go. Growth is that of a process from 30 % of the run on.

| run | done | processes | growth of memory | more open files | answers at the end |
|---|---|---|---|---|---|
{long}

oneDNN keeps 1,024 compiled programs by shape, and the number of people in a batch never stops changing.
Memory grew by 0.96 % in 5.7 million agent-steps because of that. The tool limits that cache to 16
(`ONEDNN_PRIMITIVE_CACHE_CAPACITY`). The run with bullet grew by 12 MiB in one moment, and by 0.1 MB in all
the rest. Probably that is a block which was free, and kept by the allocator. The tool gives such blocks back
before it measures since then.
"""
