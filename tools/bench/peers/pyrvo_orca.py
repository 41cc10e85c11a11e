"""RVO2 through pyrvo as a peer of `pedzoo bench`: one step of ORCA from the same states among the same walls.

    pip install pyrvo
    pedzoo bench loop orca --peer tools/bench/peers/pyrvo_orca.py

One simulator per scene. ``from python`` gives all preferred velocities, steps, and reads all
velocities, as a program that moves people has to; ``bare`` is RVO2's step alone. People are put back to where
they were given every 10 steps, which is not counted.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from answering import Step, TimedCase, serve
from pyrvo.pyrvo import RVOSimulator

EVERY = 10
UNLIMITED = 10_000


def cases(asked: list[dict[str, Any]], threads: int) -> list[TimedCase]:
    """Return both kinds of steps for all scenes that are given; RVO2 in pyrvo has one thread."""
    return [
        TimedCase(
            name,
            scenes["scenes"],
            scenes["people"],
            scenes["orca"]["dt"],
            f"ORCA only, {walls(scenes)}, {about}",
            lambda scenes=scenes, bare=bare: built(scenes, bare),
            EVERY,
        )
        for scenes in asked
        if scenes["orca"]
        for name, bare, about in (
            ("from python", False, "preferred velocities set and velocities read one by one"),
            ("bare", True, "nothing set and nothing read"),
        )
    ]


def walls(scenes: dict[str, Any]) -> str:
    """Return how many walls there are."""
    edges = sum(map(len, scenes["walls"]))
    return f"the same {edges} edges of walls" if edges else "no walls"


def built(scenes: dict[str, Any], bare: bool) -> tuple[Step, Step]:
    """Return what makes a step of all scenes, and what puts every person back."""
    orca = scenes["orca"]
    most = UNLIMITED if orca["max_neighbors"] is None else orca["max_neighbors"]
    common = orca["dt"], orca["neighbor_dist"], most, orca["time_horizon"], orca["time_horizon_obst"]
    simulators = []
    for speeds in scenes["top_speed"]:
        one = RVOSimulator(*common, orca["radius"], max(speeds))
        for agent, speed in enumerate(speeds):
            one.add_agent((0.0, 0.0))
            one.set_agent_max_speed(agent, speed)
        for polygon in scenes["walls"]:
            one.add_obstacle([tuple(point) for point in polygon])
        one.process_obstacles()
        simulators.append(one)
    people = range(scenes["people"])

    def wish() -> None:
        for one, wishes in zip(simulators, scenes["preferred"], strict=True):
            for agent, wanted in enumerate(wishes):
                one.set_agent_pref_velocity(agent, wanted)

    def again() -> None:
        states = zip(simulators, scenes["position"], scenes["velocity"], strict=True)
        for one, places, velocities in states:
            for agent, (place, velocity) in enumerate(zip(places, velocities, strict=True)):
                one.set_agent_position(agent, place)
                one.set_agent_velocity(agent, velocity)
        wish()

    def alone() -> None:
        for one in simulators:
            one.do_step()

    def from_python() -> None:
        wish()
        alone()
        for one in simulators:
            for agent in people:
                velocity = one.get_agent_velocity(agent)
                _ = velocity.x, velocity.y

    return (alone if bare else from_python), again


if __name__ == "__main__":
    serve("pyrvo", {"pyrvo": version("pyrvo")}, cases)
