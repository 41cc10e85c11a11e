"""The controller for other simulators: milliseconds of one `step`, beside the network alone."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from pedzoo.core.types import OBS_LEN, PRED_LEN, STEP_SECONDS
from pedzoo.maps.grid import OccupancyGrid, free_points
from pedzoo.maps.plans import load_plan
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import load
from pedzoo.policies.controller import controller
from pedzoo.policies.learned.walker import Walker
from tools.bench.figures import Measured, Row
from tools.bench.section import Section
from tools.bench.turns import Clock, ratio, seconds_of

MODEL = "sgan_goal.zara1"
CROWDS = (2, 20, 200)
CALLS = 20
"""Calls of one turn that are timed, after those that fill the histories."""

NOTE = (
    "held: calls every 0.1 s between two decisions; first: the first call, which plans the ways; "
    "new_goal: calls every 0.1 s in which one person gets a goal that was never asked for"
)


class Controller(Section):
    """Every person walks where the controller says, to goals of their own."""

    takes = 4, 9

    def rows(self) -> Iterator[Row]:
        """Measure in open space and on the first floor plan, with few people and with many."""
        model, now = load(MODEL), self.settings.clock
        for plan in (None, *map(load_plan, self.settings.maps[:1])):
            for people in CROWDS[:2] if self.settings.quick else CROWDS:
                turns = []
                for _ in range(self.settings.turns):
                    calls = holding, redirected
                    others = (seconds(model, plan, people, now) for seconds in calls)
                    turns.append((*deciding(model, plan, people, now), *others))
                first, step, network, held, goal = (list(values) for values in zip(*turns, strict=True))
                metrics = {
                    f"{name}_ms": Measured.of([1e3 * second for second in seconds])
                    for name, seconds in (
                        ("step", step),
                        ("network", network),
                        ("held", held),
                        ("first", first),
                        ("new_goal", goal),
                    )
                }
                metrics["times_network"] = ratio(network, step)
                where = {"people": people, "map": plan.name if plan else "open space"}
                yield Row("controller", MODEL, where, metrics, note=NOTE)


class Noted(Walker):
    """Keeps the scene batch that it was asked about."""

    seen: TensorDictBase

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Decide as ever."""
        self.seen = tensordict
        return super().forward(tensordict)


def deciding(
    model: Forecaster, plan: OccupancyGrid | None, people: int, now: Clock
) -> tuple[float, float, float]:
    """Return seconds of the first call, of one that decides, and of the network in it (medians)."""
    steering = controller.Controller(Noted(model), plan)
    position, goals = scene(plan, people)
    noise = torch.zeros(1, people, model.noise_dim)
    steps, networks = [], []

    def step() -> None:
        nonlocal position
        velocity = steering.step(dict(enumerate(position)), goals)
        position = position + STEP_SECONDS * np.stack(list(velocity.values()))

    @torch.no_grad()
    def alone() -> None:
        model.next_steps(cast("Noted", steering.policy).seen, noise, 1, PRED_LEN)

    for _ in range(OBS_LEN + CALLS):
        steps.append(seconds_of(step, now))
        networks.append(seconds_of(alone, now))
    return steps[0], median(steps[OBS_LEN:]), median(networks[OBS_LEN:])


def holding(model: Forecaster, plan: OccupancyGrid | None, people: int, now: Clock) -> float:
    """Return the median seconds of calls in which every person's velocity is held."""
    steering = model.controller(plan, dt=STEP_SECONDS / 4)
    position, goals = scene(plan, people)
    places = dict(enumerate(position))
    taken = [seconds_of(lambda: steering.step(places, goals), now) for _ in range(OBS_LEN + CALLS)]
    return median(taken[i] for i in range(OBS_LEN, OBS_LEN + CALLS) if i % 4)


def redirected(model: Forecaster, plan: OccupancyGrid | None, people: int, now: Clock) -> float:
    """Return the median seconds of calls 0.1 s apart in which one person has a goal never asked for."""
    steering = model.controller(plan, dt=STEP_SECONDS / 4)
    position, goals = scene(plan, people + OBS_LEN + CALLS)
    places, new = dict(enumerate(position[:people])), list(goals.values())[people:]
    taken = []
    for goal in new[: OBS_LEN + CALLS]:
        wanted = {person: goals[person] for person in places} | {0: goal}
        taken.append(seconds_of(lambda wanted=wanted: steering.step(places, wanted), now))
    return median(taken[OBS_LEN:])


def scene(
    plan: OccupancyGrid | None, people: int
) -> tuple[NDArray[np.float64], dict[int, NDArray[np.float64]]]:
    """Return positions (N, 2) and goals, spread over the floor plan or 30 x 30 metres."""
    draw = np.random.default_rng(0)
    if plan is None:
        points = draw.uniform(0, 30, (2 * people, 2))
    else:
        points = draw.choice(free_points(plan, "wall", 0.3), 2 * people)
    return points[:people], dict(enumerate(points[people:]))
