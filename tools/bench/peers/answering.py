"""How a program of `pedzoo bench` answers: lines of JSON on its standard streams.

It is asked twice. ``{"sections": {"loop": [[64, 5]]}}`` gives sizes (scenes, people) by section; it answers
``{"name", "versions", "cases": [{"section", "name", "scenes", "people", "note"}, ...]}`` with what it can do.
``{"run": i, "seconds": s}`` lets it repeat its case i for about s seconds of processor time; it answers
``{"seconds": x}``, the time of one step, or ``{"error": "..."}``.

A peer imports nothing of pedzoo: it may live in an environment of its own, with packages whose licences are
not ours.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

Step = Callable[[], None]
Sizes = dict[str, list[tuple[int, int]]]


@dataclass
class TimedCase:
    """Something that can be timed; the same work has the same name in every program."""

    section: str
    name: str
    build: Callable[[], Step]  # makes the scenes and returns what makes one step of all of them
    scenes: int = 0  # 0 where the work has no size
    people: int = 0
    note: str = ""  # what is included, for the reader of the table
    steps: int = 1  # between two looks at the clock
    again: list[Step] = field(default_factory=list)  # puts scenes back after so many; not counted


def processor_time() -> float:
    """Return the seconds that this process and its finished children have computed."""
    return time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def serve(name: str, versions: dict[str, str], cases: Callable[[Sizes], Sequence[TimedCase]]) -> None:
    """Answer until no question comes any more; ``cases`` returns what it can do of sizes by section."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # nothing else may come between the answers, whatever a library prints to
    known: Sequence[TimedCase] = []
    built: dict[int, Step] = {}
    for line in sys.stdin:
        question = json.loads(line)
        try:
            if "sections" in question:
                known, built = cases(question["sections"]), {}
                kept = ("section", "name", "scenes", "people", "note")
                about = [{key: getattr(case, key) for key in kept} for case in known]
                answer = {"name": name, "versions": versions, "cases": about}
            else:
                number = question["run"]
                if number not in built:
                    built[number] = known[number].build()
                    timed(known[number], built[number], 0.0)  # what is compiled or found once is not counted
                answer = {"seconds": timed(known[number], built[number], question["seconds"])}
        except Exception as error:  # the other cases may still work
            traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


def timed(case: TimedCase, step: Step, seconds: float) -> float:
    """Return the seconds of one step, from about so many seconds of steps."""
    taken, steps = 0.0, 0
    while taken <= seconds:
        for again in case.again:
            again()
        begun = processor_time()
        for _ in range(case.steps):
            step()
        taken += processor_time() - begun
        steps += case.steps
    return taken / steps
