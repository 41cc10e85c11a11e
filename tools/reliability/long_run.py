"""Long runs: memory stays flat, and the answers at the end are those of the start.

    python -m tools.reliability.long_run --agent-steps 10000000 --comings 2000

Both parts write down where they are, and go on from there in a new process after they were killed. What grew
is counted in each process from the time at which it is warm.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import os
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, cast

# oneDNN, read when torch is imported: it keeps 1,024 programs by shape, and numbers of people never end
os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "16")

import numpy as np
import torch

import pedzoo
from pedzoo.core.batch import agents_of
from pedzoo.core.paths import write_whole

STATE = Path("long_run.json")

SCENES = {"bullet": 16}
"""Scenes at once, `_MANY` where nothing else is said: a step of few costs about as much as one of many."""

_MANY = 2048

WARM, GROWTH = 0.3, 0.01
"""Share of what is wanted after which a process may not grow any more, and by how much it may."""

Row = dict[str, Any]


def resident() -> int:
    """Return the bytes of memory that this process has."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def handles() -> int:
    """Return the number of open files of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def steps(physics: str, begun: int, scenes: int, batches: int) -> Iterator[Row]:
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


def grown(rows: list[Row], wanted: int) -> Row:
    """Return how far a run came, in how many processes, and what grew in the worst of them.

    A process is warm after `WARM` of what is wanted. Its memory and handles are those of its last row against
    the row at which it was warm. Shorter ones are not judged; ``judged`` is how much was done in warm ones.
    Answers, where a run has some, are all the same or they are not.
    """
    memory, opened, judged, processes, begun = 0.0, 0, 0, 0, 0
    for _, group in groupby(rows, key=lambda row: row["process"]):
        mine, processes = list(group), processes + 1
        warm, last = [row for row in mine if row["done"] - begun >= WARM * wanted][:1], mine[-1]
        begun = last["done"]
        for row in warm:
            judged += last["done"] - row["done"]
            memory = max(memory, last["memory"] / row["memory"] - 1)
            opened = max(opened, last["handles"] - row["handles"])
    same = len({row.get("answer") for row in rows}) <= 1
    result = {"done": begun, "processes": processes, "judged": judged}
    return result | {"memory": memory, "handles": opened, "same": same}


def go_on(name: str, wanted: int, state: Path, physics: str = "torch", batches: int = 20) -> Row:
    """Go on with a run until so much is done, and return what grew; ``state`` says how far it is."""
    runs: dict[str, list[Row]] = json.loads(state.read_text()) if state.is_file() else {}
    rows = runs.setdefault(name, [])
    done, process = (rows[-1]["done"], rows[-1]["process"] + 1) if rows else (0, 0)
    if done < wanted:
        scenes = SCENES.get(physics, _MANY)
        for row in comings(done) if name == "comings" else steps(physics, done, scenes, batches):
            rows.append(row | {"process": process})
            write_whole(state, f"{json.dumps(runs)}\n".encode())
            if row["done"] >= wanted:
                break
    return grown(rows, wanted)


@torch.no_grad()
def main() -> None:
    """Go on with both, and fail where something grew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agent-steps", type=int, default=10_000_000)
    parser.add_argument("--comings", type=int, default=2000)
    parser.add_argument("--physics", default="torch")
    options = parser.parse_args()
    results = []
    for name, wanted in (("comings", options.comings), (options.physics, options.agent_steps)):
        results.append(go_on(name, wanted, STATE, options.physics))
        print(name, results[-1], flush=True)
    if any(one["memory"] > GROWTH or one["handles"] > 0 or not one["same"] for one in results):
        raise SystemExit("something grew, or the answers are others")


if __name__ == "__main__":
    main()
