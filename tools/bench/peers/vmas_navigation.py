"""VMAS' scenario ``navigation`` as a peer of `pedzoo bench`: with lidar and collisions, and without both.

    python -m venv ../venv_peers && ../venv_peers/bin/pip install torch vmas pyrvo
    pedzoo bench loop --peer tools/bench/peers/vmas_navigation.py --peer_python ../venv_peers/bin/python

Every person gets random forces, drawn beforehand; observations and rewards are computed in each step of 0.1 s
(two sub-steps). After 100 steps all scenes are reset at once, which is counted and the cheapest way to do it.
The area in which people start grows with their number; VMAS' own is 2 x 2 m for four.

VMAS is licensed under the GPL: it is run here, in a process of its own, and imported by nothing of pedzoo.
"""

from __future__ import annotations

import math
from importlib.metadata import version
from typing import Any

import torch
from answering import Case, Step, loop_cases, serve
from vmas import make_env  # pyright: ignore[reportMissingImports]

STEPS, DRAWS = 100, 16
MOST = 100
"""More people than this take VMAS minutes per step."""

KINDS = {"lidar": (True, "12 rays each and collisions"), "no lidar": (False, "neither rays nor collisions")}


def cases(asked: list[dict[str, Any]], threads: int) -> list[Case]:
    """Return the scenario with and without lidar for every size that is asked about."""
    torch.set_num_threads(threads)
    note = f"navigation, {{about}}, random actions, all scenes reset at once after {STEPS} steps"
    return loop_cases(asked, MOST, KINDS, note, built)


def built(scenes: int, people: int, collisions: bool) -> tuple[Step, None]:
    """Return what makes one step of all scenes, and resets them when their time is over."""
    half = math.sqrt(max(people, 4) / 4)
    env = make_env(
        "navigation",
        num_envs=scenes,
        device="cpu",
        seed=0,
        n_agents=people,
        collisions=collisions,
        world_spawning_x=half,
        world_spawning_y=half,
    )
    actions = [env.get_random_actions() for _ in range(DRAWS)]
    done = 0

    def step() -> None:
        nonlocal done
        if done and done % STEPS == 0:
            env.reset()
        env.step(actions[done % DRAWS])
        done += 1

    return step, None


if __name__ == "__main__":
    serve("VMAS", {"vmas": version("vmas"), "vmas' torch": version("torch")}, cases)
