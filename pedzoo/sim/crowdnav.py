"""CrowdNav, a benchmark of a robot among people who cross a circle: its own rules, not the kernel's.

They are those of the two papers at `CROWDNAV` and `CROWDNAV_PP`, for many cases at once, in double precision.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.geometry import closest_fraction, direction_of, limit_speed
from pedzoo.policies.robots._base import ObservedPeople, Robot
from pedzoo.policies.robots.baselines import toward
from pedzoo.policies.rule_based.orca import OrcaSettings, orca_velocity

TIME_STEP = 0.25
"""Seconds of a step."""

EARLY = 1.0
"""Seconds before the limit at which a case counts as timed out."""

RADIUS, SPEED = 0.3, 1.0
"""Metres and m/s of all people, and of the robot."""

MARGIN = 0.01
"""Metres by which ORCA takes all radii longer."""

TEST = 1000
"""Offset of the test cases' seeds: case i of the test draws from seed 1000 + i, of the validation from i."""

TRIES = 2500
"""Most draws of a place that keeps clear of others."""

GOES_ON, SUCCESS, COLLISION, TIMEOUT, FAILED = range(5)
"""How a case ends; ``FAILED``: the policy gave no number."""


@dataclass(frozen=True)
class Setting:
    """A crowd, its rules and its rewards.

    Attributes:
        people: In each case, N.
        circle: Radius of the circle on which people start, metres.
        shift: Least and most shift of their starts along x and along y, metres.
        arena: Half the side of the square where the robot's start and goal are drawn, metres; None: from
            (0, -circle) to (0, circle).
        far: Least distance between the two, metres.
        discomfort_dist: Metres between bodies below which people are disturbed; starts keep them.
        time_limit: Seconds; a case ends `EARLY` before it.
        swept: Whether a collision counts on the way of a step, with the people's velocities of the step
            before, or where a step begins.
        replaced: Whether people who arrive make place for new ones on the circle.
        sensor_range: Metres between bodies up to which the robot sees people; None: all. The robot takes
            people whom it does not see any more to go straight on.
        foresight: Steps ahead: a robot in the place of a person at that time intrudes; 0: not looked at.
        visible: Whether people avoid the robot.
        safety_space: Metres by which all radii are longer for the people's ORCA, beside `MARGIN`.
        success_reward: For the goal.
        collision_penalty: For a collision.
        discomfort_factor: Of the time and depth of discomfort, per metre and second.
    """

    people: int = 5
    circle: float = 4.0
    shift: tuple[float, float] = (-0.5, 0.5)
    arena: float | None = None
    far: float = 8.0
    discomfort_dist: float = 0.2
    time_limit: float = 25.0
    swept: bool = True
    replaced: bool = False
    sensor_range: float | None = None
    foresight: int = 0
    visible: bool = False
    safety_space: float = 0.0
    success_reward: float = 1.0
    collision_penalty: float = -0.25
    discomfort_factor: float = 0.5


CROWDNAV = Setting()
"""Chen, Liu, Kreiss and Alahi, "Crowd-Robot Interaction", ICRA 2019: ``crowd_nav/configs/env.config``."""

CROWDNAV_PP = Setting(
    people=20,
    circle=6 * math.sqrt(2),
    shift=(0.0, 2.0),
    arena=6.0,
    discomfort_dist=0.25,
    time_limit=50.0,
    swept=False,
    replaced=True,
    sensor_range=5.0,
    foresight=5,
    safety_space=0.15,
    success_reward=10.0,
    collision_penalty=-20.0,
    discomfort_factor=10.0,
)
"""Liu et al., "Intention Aware Robot Crowd Navigation", ICRA 2023: ``crowd_nav/configs/config.py``, people
whose goals, radii and speeds do not change (``no_rand``)."""


class State(NamedTuple):
    """B cases at the same time, double precision.

    Attributes:
        seconds: Since their start.
        robot: The robots.
        people: The people.
        goal: Of people (B, N, 2), metres.
        known: The people as far as the robot knows of them.
        going: Which cases have not ended (B,) bool; in the others all stand.
        draws: numpy's legacy generator of each case, from which new people are drawn.
    """

    seconds: float
    robot: Robot
    people: ObservedPeople
    goal: Tensor
    known: ObservedPeople
    going: Tensor
    draws: list[np.random.RandomState]

    def copy(self) -> State:
        """Return the cases with generators of their own."""
        return self._replace(draws=copy.deepcopy(self.draws))


class Events(NamedTuple):
    """What happened in a step.

    Attributes:
        outcome: How cases ended in this step, or `GOES_ON` (B,) long.
        seconds: When those that ended did.
        reward: Of the step (B,).
        clearance: Least distance between the robot's body and people's (B,), metres; infinite without any.
        intruded: Least distance between the centres of the robot and of where a person will be, if the two
            bodies would overlap (B,), metres; else infinite.
    """

    outcome: Tensor
    seconds: float
    reward: Tensor
    clearance: Tensor
    intruded: Tensor


def cases(setting: Setting, seeds: Sequence[int]) -> State:
    """Return the start of the cases that are drawn from seeds of numpy's legacy generator, one for each."""
    draws, scenes = [np.random.RandomState(seed) for seed in seeds], len(seeds)
    start = torch.tensor([0.0, -setting.circle]).double().repeat(scenes, 1)
    end, left = -start, torch.arange(scenes if setting.arena else 0)
    while setting.arena and len(left):
        start[left], end[left] = (setting.arena * (2 * _numbers(draws, left, 4) - 1)).split(2, dim=1)
        left = left[(start[left] - end[left]).norm(dim=-1) < setting.far]
    place = start.new_full((scenes, setting.people, 2), torch.nan)
    for slot in range(setting.people):
        others = torch.cat((start[:, None], end[:, None], place, -place), dim=1)
        place[:, slot] = _free_place(setting, draws, torch.arange(scenes), others)
    radius = place.new_full(place.shape[:2], RADIUS)
    people = ObservedPeople(place, torch.zeros_like(place), radius, torch.ones_like(radius, dtype=torch.bool))
    own = start.new_full((scenes,), RADIUS), start.new_full((scenes,), SPEED)
    return begin(setting, Robot(start, torch.zeros_like(start), end, *own), people, -place, draws)


def begin(
    setting: Setting, robot: Robot, people: ObservedPeople, goal: Tensor, draws: list[np.random.RandomState]
) -> State:
    """Return cases at their start; see `State`."""
    known = people._replace(mask=in_range(setting, robot, people))
    return State(0.0, robot, people, goal, known, people.mask.new_ones(len(goal)), draws)


def _numbers(draws: list[np.random.RandomState], rows: Tensor, count: int) -> Tensor:
    """Return the next numbers (R, count) from 0 to 1 of some cases ``rows`` (R,) long."""
    return torch.from_numpy(np.stack([draws[row].random_sample(count) for row in rows.tolist()]))


def _free_place(setting: Setting, draws: list[np.random.RandomState], rows: Tensor, taken: Tensor) -> Tensor:
    """Return places (R, 2) of cases ``rows`` (R,) near the circle, each drawn until it keeps clear of others.

    ``taken`` (R, K, 2) is where others are and where they go, metres; NaN is nowhere.
    """
    result, left, (least, most) = taken.new_zeros(len(rows), 2), torch.arange(len(rows)), setting.shift
    for _ in range(TRIES):
        if not len(left):
            return result
        numbers = _numbers(draws, rows[left], 3)
        shift = least + (most - least) * numbers[:, 1:]
        result[left] = place = setting.circle * direction_of(numbers[:, 0] * (2 * math.pi)) + shift
        apart = (place[:, None] - taken[left]).norm(dim=-1)
        left = left[(apart < 2 * RADIUS + setting.discomfort_dist).any(1)]
    raise RuntimeError(f"a case drew {TRIES} places and found none for another person")


def step(setting: Setting, state: State, velocity: Tensor) -> tuple[State, Events]:
    """Return the state after `TIME_STEP`, and what happened in cases that had not ended.

    ``velocity`` (B, 2) is what the robots' policy says, m/s.
    """
    robot, people, going = state.robot, state.people, state.going
    valid = velocity.isfinite().all(1)
    velocity = limit_speed(torch.where((valid & going)[:, None], velocity.double(), 0), robot.v_pref)
    present = people._replace(mask=people.mask & going[:, None])
    chosen = people_velocity(setting, robot, present, state.goal)
    moved = robot._replace(position=robot.position + TIME_STEP * velocity, velocity=velocity)

    judged = moved if setting.swept else robot
    clearance = swept_clearance(robot, people, velocity, TIME_STEP if setting.swept else 0.0).amin(1)
    arrived = (judged.position - robot.goal).norm(dim=-1) < robot.radius
    outcome = torch.where(clearance < 0, COLLISION, torch.where(arrived, SUCCESS, GOES_ON))
    if state.seconds >= setting.time_limit - EARLY:
        outcome = torch.full_like(outcome, TIMEOUT)
    outcome = torch.where(going, torch.where(valid, outcome, FAILED), GOES_ON)
    intruded, later = torch.full_like(clearance, torch.inf), present
    for _ in range(setting.foresight):  # as if no person were replaced
        later = walked(later, people_velocity(setting, None, later, state.goal))
        apart = (later.position - robot.position[:, None]).norm(dim=-1)
        overlaps = (apart < robot.radius[:, None] + people.radius) & going[:, None]
        intruded = intruded.minimum(torch.where(overlaps, apart, torch.inf).amin(1))
    disturbing = intruded.isfinite() if setting.foresight else clearance < setting.discomfort_dist
    depth = (clearance - setting.discomfort_dist) * setting.discomfort_factor * TIME_STEP
    ends = torch.tensor([0.0, setting.success_reward, setting.collision_penalty, 0.0, 0.0]).double()
    reward = ends[outcome] + torch.where(disturbing & going & (outcome == GOES_ON), depth, 0)

    people, going = walked(people, chosen), going & (outcome == GOES_ON)
    seen, known = in_range(setting, moved, people), walked(state.known, state.known.velocity)
    pairs = zip(people[:2], known[:2], strict=True)
    position, velocity = (torch.where(seen[..., None], now, guess) for now, guess in pairs)
    known = ObservedPeople(position, velocity, people.radius, known.mask | seen)
    after = State(state.seconds + TIME_STEP, moved, people, state.goal, known, going, state.draws)
    seconds = after.seconds if setting.swept else state.seconds
    return replaced(setting, after), Events(outcome, seconds, reward, clearance, intruded)


def walked(people: ObservedPeople, velocity: Tensor) -> ObservedPeople:
    """Return people after a step with velocities (B, N, 2), m/s."""
    return people._replace(position=people.position + TIME_STEP * velocity, velocity=velocity)


def people_velocity(setting: Setting, robot: Robot | None, people: ObservedPeople, goal: Tensor) -> Tensor:
    """Return the people's next velocities (B, N, 2), m/s: ORCA in single precision, as RVO2 computes.

    People go to ``goal`` (B, N, 2), metres; ``robot`` is among them, or None.
    """
    wanted, slots = toward(goal - people.position), people.mask.shape[1]
    if setting.visible and robot is not None:  # what others want changes no velocity
        own = (*robot[:2], robot.radius, torch.ones_like(robot.radius, dtype=torch.bool))
        pairs = zip(people, own, strict=True)
        people = ObservedPeople(*(torch.cat((them, it[:, None]), 1) for them, it in pairs))
        wanted = torch.nn.functional.pad(wanted, (0, 0, 0, 1))
    speed, most = torch.full(people.mask.shape, SPEED), max(10, setting.people)
    orca = OrcaSettings(dt=TIME_STEP, neighbor_dist=10.0, max_neighbors=most, time_horizon=5.0)
    given = people.position.float(), people.velocity.float(), wanted.float(), speed, people.mask, orca
    radius = people.radius.float() + (MARGIN + setting.safety_space)
    return orca_velocity(*given, radius=radius)[:, :slots].double()


def swept_clearance(robot: Robot, people: ObservedPeople, velocity: Tensor, seconds: float) -> Tensor:
    """Return the least distances (B, N) between bodies on the way, metres; infinite for absent people.

    For so many ``seconds`` the robots have a ``velocity`` (B, 2), m/s, and people go on with theirs.
    """
    away = people.position - robot.position[:, None]
    move = (people.velocity - velocity[:, None]) * seconds
    apart = (away + closest_fraction(away, move)[..., None] * move).norm(dim=-1)
    return torch.where(people.mask, apart - robot.radius[:, None] - people.radius, torch.inf)


def in_range(setting: Setting, robot: Robot, people: ObservedPeople) -> Tensor:
    """Return which people the robot's sensor sees (B, N) bool."""
    reach = math.inf if setting.sensor_range is None else setting.sensor_range
    return people.mask & (swept_clearance(robot, people, torch.zeros_like(robot.position), 0.0) <= reach)


def replaced(setting: Setting, state: State) -> State:
    """Return the state in which new people stand in for those who arrived, in the order of their slots."""
    people, goal = state.people, state.goal
    arrived = ((goal - people.position).norm(dim=-1) < people.radius) & state.going[:, None]
    if not setting.replaced or not arrived.any():
        return state
    place, target, velocity = people.position.clone(), goal.clone(), people.velocity.clone()
    while len(rows := arrived.any(1).nonzero()[:, 0]):
        slot = arrived[rows].long().argmax(1)
        taken = torch.stack((state.robot.position, state.robot.goal), dim=1)[rows]
        taken = torch.cat((taken, place[rows], target[rows]), dim=1)
        start = _free_place(setting, state.draws, rows, taken)
        place[rows, slot], target[rows, slot], velocity[rows, slot] = start, -start, 0.0
        arrived[rows, slot] = False
    return state._replace(people=people._replace(position=place, velocity=velocity), goal=target)
