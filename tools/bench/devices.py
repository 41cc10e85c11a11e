"""How fast the loop is on each device, and whether all of them show the same people: one table.

    python tools/bench/devices.py --devices cpu cuda --json devices.json

Agent-steps per second of environments with walls, contacts, carrots and resets. On the CPU compiled loops
run, on other devices torch. `agree` is how far apart people are after 20 decisions on that device and on the
first one (m), the 99 % quantile: a rounding that decides at a wall may send an agent elsewhere.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from pedzoo.policies.load import load_policy
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from tools.bench.turns import load, machine, repeated

SCENES, PEOPLE = (1, 64, 1024, 8192), 5
POLICIES = ("go_to_goal", "sgan_goal_map.indoor:safety=false", "sgan_goal_map.indoor", "social_walker.styled")


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", nargs="+", default=["cpu"])
    parser.add_argument("--policies", nargs="+", default=list(POLICIES))
    parser.add_argument("--scenario", default="goals:map=apartment.7,people={people}")
    parser.add_argument("--scenes", nargs="+", type=int, default=list(SCENES), help="At a time.")
    parser.add_argument("--seconds", type=float, default=3.0, help="Of each measurement.")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    print(f"{'policy':34} {'size':>8} {'device':>6} {'agent-steps/s':>14} {'agree, m':>9}", flush=True)
    for policy in given.policies:
        for scenes in given.scenes:
            places: dict[str, torch.Tensor] = {}
            for device in given.devices:
                scenario = given.scenario.format(people=PEOPLE)
                rate, places[device] = measured(policy, scenario, scenes, device, given.seconds)
                apart = (places[device] - places[given.devices[0]]).norm(dim=-1).flatten()
                agree = float(apart.quantile(0.99)) if len(apart) < 1 << 22 else float("nan")
                row = {"policy": policy, "size": f"{scenes}x{PEOPLE}", "device": device}
                rows.append(row | {"agent_steps_per_s": rate, "agree_m": agree})
                print(f"{policy:34} {row['size']:>8} {device:>6} {rate:14,.0f} {agree:9.1e}", flush=True)
    if given.json:
        report: dict[str, Any] = {
            "command": "tools/bench/devices.py",
            "torch": torch.__version__,
            "machine": {"devices": [named(device) for device in given.devices], "load": load()},
            "rows": rows,
        }
        given.json.write_text(json.dumps(report, indent=1) + "\n")


@torch.no_grad()
def measured(
    name: str, scenario: str, scenes: int, device: str, seconds: float
) -> tuple[float, torch.Tensor]:
    """Return agent-steps per second, and where every person is after 20 decisions (B, A, 2)."""
    policy = load_policy(name).to(device)
    env = make_env(scenario, scenes, decision_dt=0.4, device=device)
    decide: Callable[[Any], Any] = policy
    now = env.reset()
    places = walked(env, decide, now)
    env.set_seed(0)
    now = env.reset()
    for _ in range(10):
        _, now = env.step_and_maybe_reset(decide(now))

    def clock() -> float:
        finish(device)
        return time.perf_counter()

    def walk() -> None:
        nonlocal now
        for _ in range(5):
            _, now = env.step_and_maybe_reset(decide(now))

    return repeated(walk, 5 * scenes * env.scenario.people, clock)(seconds), places


def walked(env: PedestrianEnv, policy: TensorDictModuleBase | Callable[[Any], Any], now: Any) -> torch.Tensor:
    """Return where every person is after 20 decisions without resets."""
    for _ in range(20):
        now = env.step(policy(now))["next"]
    return env.state.position.cpu()


def named(device: str) -> str:
    """Return what a device is called."""
    return torch.cuda.get_device_name(device) if device.startswith("cuda") else machine()["cpu"]


def finish(device: str) -> None:
    """Wait until the device has done what it was asked for."""
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)


if __name__ == "__main__":
    main()
