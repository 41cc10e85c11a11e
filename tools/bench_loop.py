"""Speed of the loop: agent-steps per second of the environment in GridWorld, resets and new goals included.

    python tools/bench_loop.py --map ../shared/maps/igibson_rs.yaml

One run, one thread. An agent-step is one decision of 0.4 s of one person: 4 trace points, their sub-steps,
walls, contacts, goals, the planner's guidance and the observation. BulletWorld: tools/bench_worlds.py.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import torch
from page import table
from tensordict import TensorDictBase

from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.policy import load_policy
from pedzoo.types import STEP_SECONDS
from pedzoo.versions import versions

ORCA = f"orca:dt={STEP_SECONDS}"
POLICIES = ("go_to_goal", f"{ORCA},walls=false", ORCA, "sgan_goal_map.zara1")


def main() -> None:
    """Print the table."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--map", default="flat", help="floor plan file, or flat")
    parser.add_argument("--people", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0, help="measured time per cell")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"torch {versions()['torch']}, 1 thread, map {options.map}, {options.people} people per scene\n")
    rows = []
    for scenes in (1, 64, 1024):
        begun = time.perf_counter()
        env = make_env(f"goals:map={options.map},people={options.people},goals=3", scenes)
        made = time.perf_counter() - begun
        begun = time.perf_counter()
        env.reset()
        reset = time.perf_counter() - begun
        speeds = [speed(env, name, options.seconds) for name in POLICIES]
        network = alone(env, POLICIES[-1], options.seconds)
        rows.append([scenes, f"{made:.2f}", f"{1000 * reset:.0f}", *(f"{value:,.0f}" for value in speeds)])
        rows[-1].append(f"{network:,.0f}")
    names = ["scenes", "planner, s", "reset, ms", "bare env (go_to_goal)", "env + ORCA, walls unseen"]
    print(table([*names, "env + ORCA", "env + SGAN+goal+map", "SGAN+goal+map alone"], rows))


@torch.no_grad()
def speed(env: PedestrianEnv, name: str, seconds: float) -> float:
    """Return agent-steps per second of a policy in an environment that resets itself."""
    policy = load_policy(name)
    policy.bind(env.bank)
    now: TensorDictBase = env.reset()

    def steps(count: int) -> float:
        nonlocal now
        begun = time.perf_counter()
        for _ in range(count):
            _, now = env.step_and_maybe_reset(policy(now))
        return time.perf_counter() - begun

    once = steps(5) / 5  # the first steps warm up caches
    count = max(5, round(seconds / once))
    return count * agents(env) / steps(count)


@torch.no_grad()
def alone(env: PedestrianEnv, name: str, seconds: float) -> float:
    """Return agent-steps per second of the policy itself, asked about the same scenes again and again."""
    policy: Any = load_policy(name)
    policy.bind(env.bank)
    now = env.reset()
    begun = time.perf_counter()
    for _ in range(3):
        policy(now)
    count = max(5, round(3 * seconds / (time.perf_counter() - begun)))
    begun = time.perf_counter()
    for _ in range(count):
        policy(now)
    return count * agents(env) / (time.perf_counter() - begun)


def agents(env: PedestrianEnv) -> int:
    """Return how many people one step moves."""
    return env.batch_size[0] * env.scenario.people


if __name__ == "__main__":
    main()
