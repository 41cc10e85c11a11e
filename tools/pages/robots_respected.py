"""Do people keep clear of a robot that does not react? Steps controllers beside a disc of 0.5 m.

    python tools/pages/robots_respected.py
    python tools/pages/robots_respected.py orca go_to_goal:safety=true --json FILE

One person and one robot, 9 lateral offsets for every encounter, in the open (-1 to 1 m) and in a corridor of
2.4 m (as far as the robot fits). The robot is parked, or drives straight at 1 m/s. A run touches if the
centres come closer than 0.65 m; a person arrives who comes within 0.3 m of the goal.
"""

import argparse
import json
import shlex
import sys
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.machine import versions
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS, TRACE_SECONDS
from pedzoo.eval.results import markdown_table
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plans import rectangles, room
from pedzoo.policies.controller.controller import Controller
from pedzoo.policies.load import load_policy

POLICIES = (
    "approach_net_goal_map.indoor",
    "approach_net_goal.indoor",
    "social_walker.indoor",
    "social_walker.styled",
    "orca",
    "social_force:preset=indoor",
)
ROBOT_RADIUS = 0.5
CONTACT = ROBOT_RADIUS + BODY_RADIUS
WIDTH = 2.4
LENGTH = 34.0
OFFSETS = 9
WIDEST = {"open": 1.0, "corridor": WIDTH / 2 - ROBOT_RADIUS - 0.05}
"""Largest lateral offset of the robot, metres."""


class Encounter(NamedTuple):
    """A person who walks along the x axis from -5 m, and a robot that passes the origin's surroundings."""

    start: tuple[float, float]  # where the robot begins (x, y), metres, before the offset
    velocity: tuple[float, float]  # of the robot, m/s
    aside: tuple[float, float] = (0.0, 1.0)  # direction of the offset
    pref_speed: float = 1.3  # of the person, m/s
    goal: float = 5.0  # x of the person's goal, metres


ENCOUNTERS = {
    "parked": Encounter((0.0, 0.0), (0.0, 0.0)),
    "head-on": Encounter((5.0, 0.0), (-1.0, 0.0)),
    "overtaken": Encounter((-7.5, 0.0), (1.0, 0.0), pref_speed=0.8, goal=14.0),
    "overtakes": Encounter((-3.0, 0.0), (1.0, 0.0), goal=14.0),
    "crossing": Encounter((0.0, -5 / 1.3), (0.0, 1.0), aside=(1.0, 0.0)),
}


class Run(NamedTuple):
    """What came of one encounter: the least distance of the centres, metres, and how long it took."""

    nearest: float
    arrived: bool
    seconds: float


Block = tuple[float, float, float, float]
"""A wall as a rectangle (x0, y0, x1, y1), metres."""


def walls(place: str, encounter: str) -> list[Block]:
    """Return the walls of a place; a robot that crosses the corridor comes through another one, as wide."""
    half, end, deep = WIDTH / 2, LENGTH / 2, 8.0
    if place == "open" or encounter != "crossing":
        return [] if place == "open" else room((-end, -half), (end, half), 0.2)
    sides = (((-end, -half), (half, end)), ((-deep, -half), (half, deep)))
    corners = [(x0, y0, x1, y1) for (x0, x1), (y0, y1) in product(*sides)]
    return [*room((-end, -deep), (end, deep), 0.2), *corners]


def walked(policy: str, place: str, encounter: str, aside: float, seed: int = 0) -> Run:
    """Return one run; ``aside`` is the robot's offset, metres."""
    case, dt = ENCOUNTERS[encounter], TRACE_SECONDS
    blocks = walls(place, encounter)
    plan: OccupancyGrid | None = rectangles(blocks, resolution=0.1) if blocks else None
    steering = Controller(load_policy(policy), plan, case.pref_speed, dt, seed)
    person, velocity = np.array([-5.0, 0.0]), np.array(case.velocity)
    robot = np.array(case.start) + aside * np.array(case.aside)
    goal = np.array([case.goal, 0.0])
    nearest, limit = np.inf, 2 * (case.goal + 5) / case.pref_speed + 5
    for tick in range(round(limit / dt)):
        about = {"velocities": {"robot": velocity}, "radius": {"robot": ROBOT_RADIUS}}
        command = steering.step({"person": person}, {"person": goal}, others={"robot": robot}, **about)
        moved = slid(person, command["person"] * dt, blocks)
        nearest = min(nearest, closest(person - robot, moved - person - velocity * dt))
        person, robot = moved, robot + velocity * dt
        if np.linalg.norm(person - goal) < GOAL_RADIUS:
            return Run(nearest, True, (tick + 1) * dt)
    return Run(nearest, False, limit)


def closest(away: NDArray[np.float64], move: NDArray[np.float64]) -> float:
    """Return the least distance of two agents that move straight, metres."""
    part = np.clip(-(away @ move) / max(float(move @ move), 1e-12), 0, 1)
    return float(np.linalg.norm(away + part * move))


def slid(place: NDArray[np.float64], move: NDArray[np.float64], blocks: list[Block]) -> NDArray[np.float64]:
    """Return where a person comes who slides along walls."""
    for part in (move, move * (1, 0), move * (0, 1)):
        end = place + part
        gaps = [np.linalg.norm(end - np.clip(end, block[:2], block[2:])) for block in blocks]
        if min(gaps, default=np.inf) >= BODY_RADIUS - 1e-6:
            return end
    return place


def row(policy: str, place: str, encounter: str, seeds: int) -> dict[str, Any]:
    """Return the row of a policy in one place and encounter; names of metrics have the unit last."""
    offsets = np.linspace(-WIDEST[place], WIDEST[place], OFFSETS)
    cases = product(offsets.tolist(), range(seeds))
    runs = [walked(policy, place, encounter, aside, seed) for aside, seed in cases]
    metrics = {
        "touches": sum(run.nearest < CONTACT - 1e-3 for run in runs),
        "arrived": sum(run.arrived for run in runs),
        "nearest_m": round(min(run.nearest for run in runs), 3),
        "median_time_s": round(median(run.seconds for run in runs), 1),
    }
    return {"name": policy, "case": f"{place}, {encounter}", "n": len(runs), "metrics": metrics}


def main() -> None:
    """Walk, print the table, and write it to a file if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("policies", nargs="*", default=list(POLICIES))
    parser.add_argument("--places", nargs="+", default=list(WIDEST), choices=list(WIDEST))
    parser.add_argument("--encounters", nargs="+", default=list(ENCOUNTERS), choices=list(ENCOUNTERS))
    parser.add_argument("--seeds", type=int, default=1, help="noise of so many seeds for every offset")
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    rows = [row(*one, given.seeds) for one in product(given.policies, given.places, given.encounters)]
    if given.json:
        report = {
            "command": shlex.join(["tools/pages/robots_respected.py", *sys.argv[1:]]),
            "protocol": f"a person and a robot of {ROBOT_RADIUS} m that does not react, {OFFSETS} offsets",
            "seeds": list(range(given.seeds)),
            "versions": versions(),
            "rows": rows,
        }
        given.json.write_text(json.dumps(report, indent=1) + "\n")
    head = ["policy", "case", "runs", "touches", "arrived", "nearest, m", "median time, s"]
    cells = [[one["name"], one["case"], one["n"], *one["metrics"].values()] for one in rows]
    print(markdown_table(head, cells), end="")


if __name__ == "__main__":
    main()
