"""RVO2 through pyrvo as a peer of `pedzoo bench`: one step of ORCA without walls, beside a whole environment.

    pip install pyrvo
    pedzoo bench policies --peer tools/bench/peers/pyrvo_orca.py

One simulator per scene. ``from Python`` gives all preferred velocities, steps, and reads all velocities, as a
program that moves people has to; ``bare`` is RVO2's step alone. People start at random in 7 m2 each and
want to go anywhere; they are put back every 10 steps, which is not counted.
"""

from __future__ import annotations

import math
import random
from importlib.metadata import version

from answering import Sizes, Step, TimedCase, serve
from pyrvo.pyrvo import RVOSimulator

EVERY = 10
DT, DISTANCE, NEIGHBORS, HORIZON, RADIUS, SPEED = 0.4, 10.0, 10, 2.0, 0.3, 1.3


def cases(asked: Sizes) -> list[TimedCase]:
    """Return both kinds of steps for all sizes; RVO2 in pyrvo has one thread."""
    result = []
    for scenes, people in asked.get("policies", []):
        for name, bare in (("from Python", False), ("bare", True)):
            again: list[Step] = []

            def build(
                scenes: int = scenes, people: int = people, bare: bool = bare, again: list[Step] = again
            ) -> Step:
                step, put_back = built(scenes, people, bare)
                again[:] = [put_back]
                return step

            note = "ORCA only, no walls, 0.4 s"
            case = TimedCase("policies", f"RVO2 {name}", build, scenes, people, note, EVERY, again)
            result.append(case)
    return result


def built(scenes: int, people: int, bare: bool) -> tuple[Step, Step]:
    """Return what makes a step of all scenes, and what puts every person back."""
    draws, half = random.Random(0), math.sqrt(7 * people) / 2
    everyone = [range(people)] * scenes
    place = [[(draws.uniform(-half, half), draws.uniform(-half, half)) for _ in one] for one in everyone]
    turn = [[draws.uniform(0, 2 * math.pi) for _ in one] for one in everyone]
    wish = [[(SPEED * math.cos(angle), SPEED * math.sin(angle)) for angle in scene] for scene in turn]
    simulators = []
    for scene in place:
        one = RVOSimulator(DT, DISTANCE, NEIGHBORS, HORIZON, HORIZON, RADIUS, SPEED)
        for point in scene:
            one.add_agent(point)
        simulators.append(one)

    def want() -> None:
        for one, wishes in zip(simulators, wish, strict=True):
            for agent, wanted in enumerate(wishes):
                one.set_agent_pref_velocity(agent, wanted)

    def put_back() -> None:
        for one, places, wishes in zip(simulators, place, wish, strict=True):
            for agent, (point, velocity) in enumerate(zip(places, wishes, strict=True)):
                one.set_agent_position(agent, point)
                one.set_agent_velocity(agent, velocity)
        want()

    def alone() -> None:
        for one in simulators:
            one.do_step()

    def from_python() -> None:
        want()
        alone()
        for one in simulators:
            for agent in range(people):
                velocity = one.get_agent_velocity(agent)
                _ = velocity.x, velocity.y

    return (alone if bare else from_python), put_back


if __name__ == "__main__":
    serve("pyrvo", {"pyrvo": version("pyrvo")}, cases)
