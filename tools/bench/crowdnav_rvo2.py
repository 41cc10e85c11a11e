"""CrowdNav's and CrowdNav++'s rules once more: one case, one person at a time, moved by RVO2 (pyrvo).

Plain numpy and loops, nothing of pedzoo: the oracle for `pedzoo.sim.crowdnav`. It also repeats what the
batched simulation leaves out: CrowdNav++'s random people, with the radii that their RVO2 remembers wrongly.

    python -m tools.bench.crowdnav_rvo2

compares it with the test logs in the repository of CrowdNav++, case by case.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from pyrvo.pyrvo import RVOSimulator

from tools.paper.published import ORCA_LOG, SOCIAL_FORCE_LOG, Log

DT = 0.25
LETTERS = {"success": "s", "collision": "c", "timeout": "t"}


@dataclass
class Body:
    """A person or the robot; ``simulator`` is the RVO2 of its own that CrowdNav keeps for it."""

    place: np.ndarray
    goal: np.ndarray
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    radius: float = 0.3
    speed: float = 1.0
    simulator: RVOSimulator | None = None

    def distance(self, other: Body) -> float:
        """Return the distance of both bodies, metres."""
        return float(np.linalg.norm(self.place - other.place)) - self.radius - other.radius

    def arrived(self) -> bool:
        """Return whether the goal is within the radius."""
        return bool(np.linalg.norm(self.place - self.goal) < self.radius)

    def move(self, velocity: np.ndarray) -> None:
        """Go on for a step."""
        self.place, self.velocity = self.place + DT * velocity, velocity


def rvo2(own: Body, others: Sequence[Body], margin: float, neighbors: int, reach: float = 10.0) -> np.ndarray:
    """Return the velocity that RVO2 gives to one agent, who takes all others to want to stand."""
    simulator = own.simulator
    if simulator is None:
        own.simulator = simulator = RVOSimulator(DT, reach, neighbors, 5.0, 5.0, 0.3, 1.0)
        for body, speed in ((own, own.speed), *((other, 1.0) for other in others)):
            place, velocity = body.place.tolist(), body.velocity.tolist()
            radius = body.radius + margin
            simulator.add_agent(place, reach, neighbors, 5.0, 5.0, radius, speed, velocity)
    for number, body in enumerate((own, *others)):  # later ones have the radius of the one before
        simulator.set_agent_position(number, body.place.tolist())
        simulator.set_agent_velocity(number, body.velocity.tolist())
    way = own.goal - own.place
    wish = way / max(1.0, float(np.linalg.norm(way)))
    simulator.set_agent_pref_velocity(0, wish.tolist())
    simulator.do_step()
    velocity = simulator.get_agent_velocity(0)
    return np.array([velocity.x, velocity.y])


def social_force(robot: Body, people: Sequence[Body]) -> np.ndarray:
    """Return the velocity that CrowdNav++'s social forces lead to."""
    way = robot.goal - robot.place
    force = way / np.linalg.norm(way) - robot.velocity
    for one in people:
        away = robot.place - one.place
        force = force + 2 * math.exp(-robot.distance(one)) * away / np.linalg.norm(away)
    velocity = robot.velocity + DT * force
    return velocity / max(1.0, float(np.linalg.norm(velocity)))


def free_place(draw: Callable[[], np.ndarray], others: Sequence[Body], room: float) -> np.ndarray:
    """Return the first place drawn that is clear of where others are and of where they go."""
    ends = [(other.radius + room, end) for other in others for end in (other.place, other.goal)]
    while True:
        place = draw()
        if all(np.linalg.norm(place - end) >= least for least, end in ends):
            return place


def near_circle(random: np.random.RandomState, circle: float, least: float, most: float) -> np.ndarray:
    """Draw an angle and two shifts."""
    angle = random.random_sample() * 2 * math.pi
    point = circle * np.array([math.cos(angle), math.sin(angle)])
    return point + least + (most - least) * random.random_sample(2)


def crowdnav(seed: int, safety_space: float = 0.0, visible: bool = False) -> tuple[str, float]:
    """Return how a case of CrowdNav ends whose robot has ORCA, and when."""
    random = np.random.RandomState(seed)
    robot = Body(np.array([0.0, -4.0]), np.array([0.0, 4.0]))
    people: list[Body] = []
    for _ in range(5):
        place = free_place(lambda: near_circle(random, 4.0, -0.5, 0.5), [robot, *people], 0.3 + 0.2)
        people.append(Body(place, -place))
    seconds, ended = 0.0, ""
    while not ended:
        action = rvo2(robot, people, 0.01 + safety_space, 10)
        walked = []
        for one in people:
            others = [other for other in people if other is not one] + [robot] * visible
            walked.append(rvo2(one, others, 0.01, 10))
        touched = False
        for one in people:
            away, move = one.place - robot.place, (one.velocity - action) * DT
            part = float(np.clip(-(away @ move) / (move @ move), 0, 1)) if move.any() else 0.0
            touched |= bool(np.linalg.norm(away + part * move) < 0.6)
        late = seconds >= 24
        robot.move(action)
        ended = "timeout" if late else "collision" if touched else "success" if robot.arrived() else ""
        for one, velocity in zip(people, walked, strict=True):
            one.move(velocity)
        seconds += DT
    return ended, seconds


class CrowdNavPP:
    """CrowdNav++ with 20 people; a robot with ORCA keeps its RVO2 from case to case, as theirs does."""

    def __init__(self, policy: str = "orca", random_people: bool = False) -> None:
        """Take ``orca`` or ``social_force`` for the robot; people may change radius, speed and goal."""
        self.policy, self.random_people = policy, random_people
        self.robot = Body(np.zeros(2), np.zeros(2))

    def case(self, seed: int) -> tuple[str, float]:
        """Return how a case ends, and when."""
        self.random, self.reach = np.random.RandomState(seed), 10.0
        robot, people = self.robot, list[Body]()
        ends = np.zeros(4)
        while np.linalg.norm(ends[:2] - ends[2:]) < 8:
            ends = self.random.uniform(-6.0, 6.0, 4)
        robot.place, robot.goal, robot.velocity = ends[:2], ends[2:], np.zeros(2)
        for _ in range(20):
            people.append(self.newcomer(people))
        known = [Body(np.full(2, 15.0), np.zeros(2)) for _ in people]
        seconds = 0.0
        self.look(known, people, 0.0)
        while True:
            by_orca = self.policy == "orca"
            action = rvo2(robot, known, 0.16, 20, self.reach) if by_orca else social_force(robot, known)
            others = [[other for other in people if other is not one] for one in people]
            walked = [rvo2(one, rest, 0.16, 19, self.reach) for one, rest in zip(people, others, strict=True)]
            if seconds >= 49:
                return "timeout", seconds
            if min(one.distance(robot) for one in people) < 0:
                return "collision", seconds
            if robot.arrived():
                return "success", seconds
            robot.move(action)
            for one, velocity in zip(people, walked, strict=True):
                one.move(velocity)
            seconds += DT
            self.look(known, people, DT)
            if self.random_people and seconds % 5 == 0:
                self.change_goals(people)
            for slot, one in enumerate(people):
                if one.arrived():
                    people[slot] = self.newcomer(people)

    def newcomer(self, people: Sequence[Body]) -> Body:
        """Draw a person near the circle."""
        radius, speed = 0.3, 1.0
        if self.random_people:  # every new person changes the reach of all who get their RVO2 later
            self.reach, speed, radius = self.random.uniform([5, 0.5, 0.3], [10, 1.5, 0.5])
        circle = 6 * math.sqrt(2)
        others = [self.robot, *people]
        place = free_place(lambda: near_circle(self.random, circle, 0.0, 2.0), others, radius + 0.25)
        return Body(place, -place, radius=radius, speed=speed)

    def change_goals(self, people: Sequence[Body]) -> None:
        """Give half of the people another goal."""
        for one in people:
            if self.random.random_sample() <= 0.5:
                half, others = one.speed / 2, [self.robot, *(other for other in people if other is not one)]
                draw = partial(near_circle, self.random, 6 * math.sqrt(2), -half, half)
                one.goal = free_place(draw, others, one.radius + 0.25)

    def look(self, known: Sequence[Body], people: Sequence[Body], seconds: float) -> None:
        """See the people within 5 m; others go straight on, for all that the robot knows."""
        for one, person in zip(known, people, strict=True):
            if person.distance(self.robot) <= 5:
                one.place, one.velocity, one.radius = person.place, person.velocity, person.radius
            else:
                one.place = one.place + seconds * one.velocity


def compare(log: Log, policy: str, random_people: bool, cases: int) -> int:
    """Return how many of the first cases end as in a log."""
    world = CrowdNavPP(policy, random_people)
    ends = [world.case(seed)[0] for seed in log.seeds[:cases]]
    return sum(LETTERS[end] == other for end, other in zip(ends, log.outcomes, strict=False))


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 250
    for log, policy, random_people in (
        (SOCIAL_FORCE_LOG, "social_force", False), (ORCA_LOG, "orca", False), (ORCA_LOG, "orca", True),
    ):  # fmt: skip
        same = compare(log, policy, random_people, count)
        people = "random people" if random_people else "people as configured"
        print(f"{policy}, {people}: {same} of {count} cases end as in the log")
