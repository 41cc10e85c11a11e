"""Times `Controller.step` with 2, 20 and 200 people, beside the network alone.

    python tools/bench_controller.py [--model sgan_goal.zara1] [--map MAP.yaml]

Everybody walks where the controller says, to goals of their own; every call decides (dt 0.4 s). One thread;
numbers are medians.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

import pedzoo
from pedzoo.maps.free_space import free_points
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.models.base import Forecaster
from pedzoo.models.controller import Controller
from pedzoo.models.walker import Walker
from pedzoo.types import OBS_LEN, PRED_LEN, STEP_SECONDS


class Noted(Walker):
    """Keeps the scene batch that it was asked about."""

    seen: TensorDictBase

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Decide as ever."""
        self.seen = tensordict
        return super().forward(tensordict)


def main() -> None:
    """Measure and print one line for each number of people."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default="sgan_goal.zara1")
    parser.add_argument("--map", help="floor plan; open space without one")
    parser.add_argument("--calls", type=int, default=100)
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = pedzoo.load(options.model)
    plan = OccupancyGrid.load(options.map) if options.map else None
    print(f"{options.model}, {options.map or 'open space'}: milliseconds per call")
    print("people   step  network  held (dt 0.1)  first, with its ways")
    for people in (2, 20, 200):
        step, network, first = timed(model, plan, people, options.calls)
        held = timed_held(model, plan, people, options.calls)
        print(f"{people:6d} {step:6.2f} {network:8.2f} {held:14.2f} {first:21.0f}")


def timed(
    model: Forecaster, plan: OccupancyGrid | None, people: int, calls: int
) -> tuple[float, float, float]:
    """Return milliseconds of a call that decides, of the network in it, and of the first call."""
    policy = Noted(model)
    controller = Controller(policy, plan)
    position, goals = scene(plan, people)
    steps, networks = [], []
    noise = torch.zeros(1, people, model.noise_dim)
    for _ in range(calls):
        now = dict(enumerate(position))
        seconds, velocity = clocked(lambda now=now: controller.step(now, goals))
        position = position + STEP_SECONDS * np.stack(list(velocity.values()))
        with torch.no_grad():
            alone, _ = clocked(lambda: model.next_steps(policy.seen, noise, 1, PRED_LEN))
        steps.append(seconds)
        networks.append(alone)
    return 1000 * median(steps[OBS_LEN:]), 1000 * median(networks[OBS_LEN:]), 1000 * steps[0]


def timed_held(model: Forecaster, plan: OccupancyGrid | None, people: int, calls: int) -> float:
    """Return milliseconds of a call in which everybody's velocity is held."""
    controller = model.controller(plan, dt=STEP_SECONDS / 4)
    position, goals = scene(plan, people)
    now = dict(enumerate(position))
    seconds = [clocked(lambda: controller.step(now, goals))[0] for _ in range(calls)]
    return 1000 * median(seconds[i] for i in range(OBS_LEN, calls) if i % 4)


def scene(plan: OccupancyGrid | None, people: int) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Return positions (N, 2) and goals, spread over the floor plan or 30 x 30 metres."""
    draw = np.random.default_rng(0)
    if plan is None:
        points = draw.uniform(0, 30, (2 * people, 2))
    else:
        points = draw.choice(free_points(plan, "wall", 0.3), 2 * people)
    return points[:people], dict(enumerate(points[people:]))


def clocked(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds that a call takes, and its answer."""
    start = time.perf_counter()
    answer = call()
    return time.perf_counter() - start, answer


if __name__ == "__main__":
    main()
