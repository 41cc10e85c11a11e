"""How a peer of `pedzoo bench` answers: lines of JSON, see ``tools/bench/peer.py``.

A peer imports nothing of pedzoo: it may live in an environment of its own, with packages whose licences are
not ours.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Step = Callable[[], None]


@dataclass
class TimedCase:
    """Something that can be timed.

    Attributes:
        name: What it does.
        scenes: How many scenes.
        people: In each.
        step_seconds: Simulated seconds of one agent-step.
        note: What is included, for the reader of the table.
        build: Makes the scenes and returns what makes one step of all of them; called before the first turn.
        every: After so many steps ``again`` is called, which is not counted.
        again: Puts the scenes back; None where they go on for ever.
    """

    name: str
    scenes: int
    people: int
    step_seconds: float
    note: str
    build: Callable[[], tuple[Step, Step | None]]
    every: int = 1


def loop_cases(
    asked: list[dict[str, Any]],
    most: int,
    kinds: dict[str, tuple[Any, str]],
    note: str,
    build: Callable[[dict[str, Any], Any], tuple[Step, Step | None]],
    section: str = "loop",
) -> list[TimedCase]:
    """Return the cases of a simulator with steps of 0.1 s, each kind at every size of a section.

    Args:
        asked: The sizes that are asked about.
        most: More people than this are left out.
        kinds: By name, what ``build`` takes and its description for the reader.
        note: What is included; ``{about}`` stands for what is said of the kind.
        build: Takes what is asked about, and the kind's value.
        section: Other questions are left out.
    """
    return [
        TimedCase(
            kind,
            size["scenes"],
            size["people"],
            0.1,
            note.format(about=about),
            lambda size=size, value=value: build(size, value),
        )
        for size in asked
        if size["section"] == section and size["people"] <= most
        for kind, (value, about) in kinds.items()
    ]


def serve(
    name: str, versions: dict[str, str], cases: Callable[[list[dict[str, Any]], int], list[TimedCase]]
) -> None:
    """Answer until no question comes any more.

    Args:
        name: Of the program.
        versions: Of it and of what it depends on.
        cases: Says what can be done of given scenes with so many threads.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # nothing else may come between the answers, whatever a library prints to
    known: list[TimedCase] = []
    built: dict[int, tuple[Step, Step | None]] = {}
    now = time.perf_counter
    for line in sys.stdin:
        question = json.loads(line)
        if "cases" in question:
            now = time.process_time if question["threads"] == 1 else time.perf_counter
            known, built = cases(question["cases"], question["threads"]), {}
            about = [
                {key: value for key, value in vars(case).items() if key not in ("build", "every")}
                for case in known
            ]
            answer: dict[str, Any] = {"name": name, "versions": versions, "cases": about}
        else:
            case = known[question["run"]]
            try:
                if question["run"] not in built:
                    built[question["run"]] = case.build()
                    timed(case, built[question["run"]], 0.0, now)
                speed = timed(case, built[question["run"]], question["seconds"], now)
                answer = {"agent_steps_per_s": speed}
            except Exception as error:  # the other cases may still work
                traceback.print_exc()
                answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


def timed(
    case: TimedCase, scenes: tuple[Step, Step | None], seconds: float, now: Callable[[], float]
) -> float:
    """Return agent-steps per second of about so many seconds; what puts scenes back is not counted."""
    step, again = scenes
    taken, steps = 0.0, 0
    while taken <= seconds:
        if again is not None:
            again()
        begun = now()
        for _ in range(case.every):
            step()
        taken += now() - begun
        steps += case.every
    return steps * case.scenes * case.people / taken
