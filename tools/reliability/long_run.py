"""Long runs: memory stays flat, and the answers at the end are those of the start.

python -m tools.reliability.long_run --agent-steps 10000000 --comings 2000
"""

from __future__ import annotations

import argparse
import gc
from pathlib import Path

import numpy as np
import torch

import pedzoo
from pedzoo.core.batch import agents_of

WARM, GROWTH = 0.3, 0.01
"""Share of a run after which memory may not grow any more, and by how much it may."""


def resident() -> int:
    """Return the bytes of memory that this process has."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def handles() -> int:
    """Return the number of open files of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def steps(agent_steps: int, physics: str = "torch", scenes: int = 64) -> dict[str, float]:
    """Let people walk through doors for so many steps of agents, and return what grew."""
    env = pedzoo.make_env("door", num_envs=scenes, physics=physics, seed=0)
    policy = pedzoo.load("sgan_goal.zara1").policy()

    def beginning() -> torch.Tensor:
        start = pedzoo.make_env("door", num_envs=scenes, physics=physics, seed=0)
        return agents_of(policy(start.reset()))["action"].clone()

    first, done, warm, batch = beginning(), 0, (0, 0), env.reset()
    while done < agent_steps:
        done += int(agents_of(batch)["mask"].sum())
        _, batch = env.step_and_maybe_reset(policy(batch))
        if not warm[0] and done > WARM * agent_steps:
            warm = resident(), handles()
    grown = resident() / warm[0] - 1
    same = torch.equal(first, beginning())
    return {"agent_steps": done, "memory": grown, "handles": handles() - warm[1], "same": float(same)}


def comings(count: int) -> dict[str, float]:
    """Let people come to a controller, and go, so many times, and return what grew."""
    controller = pedzoo.load("sgan_goal.zara1").controller()
    draw, warm = np.random.default_rng(0), (0, 0)
    place: dict[int, np.ndarray] = {}
    for number in range(count):
        place[number] = draw.uniform(-5, 5, 2)
        if len(place) > 5:
            del place[min(place)]
        velocity = controller.step(place, {number: tuple(draw.uniform(-5, 5, 2))})
        place = {one: at + 0.4 * velocity[one] for one, at in place.items()}
        if number == int(WARM * count):
            warm = resident(), handles()
    return {"comings": count, "memory": resident() / warm[0] - 1, "handles": handles() - warm[1]}


def main() -> None:
    """Run both, and fail where something grew."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agent-steps", type=int, default=10_000_000)
    parser.add_argument("--comings", type=int, default=2000)
    parser.add_argument("--physics", default="torch")
    options = parser.parse_args()
    with torch.no_grad():
        results = [steps(options.agent_steps, options.physics), comings(options.comings)]
    for result in results:
        print(result, flush=True)
    if any(one["memory"] > GROWTH or one["handles"] or not one.get("same", 1) for one in results):
        raise SystemExit("something grew, or the answers are others")


if __name__ == "__main__":
    main()
