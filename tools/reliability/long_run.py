"""Long runs: memory stays flat, and the answers at the end are those of the start.

What grew is counted in each process from the time at which it is warm.
"""

from __future__ import annotations

import ctypes
import gc
import hashlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

# oneDNN, read when torch is imported: it keeps 1,024 programs by shape, and numbers of people never end
os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "16")

import numpy as np
import torch

import pedzoo
from pedzoo.core.batch import agents_of

SCENES = {"bullet": 16}
"""Scenes at once, `_MANY` where nothing else is said: a step of few costs about as much as one of many."""

_MANY = 2048

WARM, GROWTH = 0.3, 0.01
"""Share of what is wanted after which a process may not grow any more, and by how much it may."""

Row = dict[str, Any]


def resident() -> int:
    """Return the bytes of memory that this process has, without what is free and only kept for later."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def handles() -> int:
    """Return the number of open files of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def steps(physics: str, begun: int, scenes: int, batches: int = 20) -> Iterator[Row]:
    """Let people walk through doors, and yield a row every so many batches, without end.

    Args:
        physics: What moves them.
        begun: How many agent-steps were done before: it is where the numbers of episodes go on.
        scenes: Scenes at once.
        batches: Decisions of all of them between two rows.
    """
    policy = pedzoo.load("sgan_goal.zara1").policy()

    def answer() -> str:
        start = pedzoo.make_env("door", num_envs=16, physics=physics, seed=0)
        action = cast("torch.Tensor", agents_of(policy(start.reset()))["action"])
        return hashlib.sha256(action.numpy().tobytes()).hexdigest()[:16]

    env = pedzoo.make_env("door", num_envs=scenes, physics=physics, seed=1, first_episode=begun)
    batch, done = env.reset(), begun
    while True:
        for _ in range(batches):
            done += int(agents_of(batch)["mask"].sum())
            _, batch = env.step_and_maybe_reset(policy(batch))
        yield {"done": done, "answer": answer(), "memory": resident(), "handles": handles()}


def comings(begun: int, every: int = 50) -> Iterator[Row]:
    """Let people come to a controller, and go, and yield a row for every 50, without end."""
    controller = pedzoo.load("sgan_goal.zara1").controller(seed=begun)
    draw, number = np.random.default_rng(begun), begun
    place: dict[int, np.ndarray] = {}
    while True:
        for _ in range(every):
            place[number] = draw.uniform(-5, 5, 2)
            if len(place) > 5:
                del place[min(place)]
            velocity = controller.step(place, {number: tuple(draw.uniform(-5, 5, 2))})
            place = {one: at + 0.4 * velocity[one] for one, at in place.items()}
            number += 1
        yield {"done": number, "memory": resident(), "handles": handles()}


def grown(processes: list[Row]) -> Row:
    """Return how far a run came, and what grew in the worst of its processes.

    Memory and handles of a process are those of its last row against the row at which it was warm. Shorter
    ones are not judged; ``judged`` is how much was done in warm ones. Answers, where a run has some, are all
    the same or they are not.
    """
    warm = [(one["warm"], one["last"]) for one in processes if one["warm"]]
    return {
        "done": processes[-1]["last"]["done"] if processes else 0,
        "processes": len(processes),
        "judged": sum(last["done"] - first["done"] for first, last in warm),
        "memory": max((last["memory"] / first["memory"] - 1 for first, last in warm), default=0.0),
        "handles": max((last["handles"] - first["handles"] for first, last in warm), default=0),
        "same": len({answer for one in processes for answer in one["answers"]}) <= 1,
    }


@torch.no_grad()
def go_on(name: str, wanted: int, processes: list[Row], save: Callable[[], None]) -> None:
    """Go on with a run until so much is done.

    Args:
        name: ``comings``, or what moves people.
        wanted: People who come, or agent-steps.
        processes: What was done before, process by process; it grows. A process is warm after `WARM` of what
            is wanted.
        save: Called after every row.
    """
    begun = processes[-1]["last"]["done"] if processes else 0
    if begun >= wanted:
        return
    mine: Row = {"warm": None, "last": None, "answers": []}
    processes.append(mine)
    for row in comings(begun) if name == "comings" else steps(name, begun, SCENES.get(name, _MANY)):
        mine["answers"] = sorted({*mine["answers"], *(row[key] for key in ("answer",) if key in row)})
        mine["last"] = row
        if row["done"] - begun >= WARM * wanted:
            mine["warm"] = mine["warm"] or row
        save()
        if row["done"] >= wanted:
            break
