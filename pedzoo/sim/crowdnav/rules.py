"""One step of CrowdNav for all cases at once: people walk, the robot moves, and cases end."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.geometry import closest_fraction, limit_speed
from pedzoo.policies.local_planner import ObservedPeople, Robot
from pedzoo.sim.crowdnav.cases import Cases, free_place
from pedzoo.sim.crowdnav.draws import Draws
from pedzoo.sim.crowdnav.people import people_velocity, places_ahead
from pedzoo.sim.crowdnav.settings import EARLY, TIME_STEP, Setting

GOES_ON, SUCCESS, COLLISION, TIMEOUT, FAILED = range(5)
"""How a case ends; ``FAILED``: the policy gave no number."""


class State(NamedTuple):
    """B cases at the same time.

    Attributes:
        seconds: Since their start.
        robot: The robots.
        people: The people.
        goal: Of people (B, N, 2), metres.
        known: The people as far as the robot knows of them.
        going: Which cases have not ended (B,) bool; in the others all stand.
        draws: What new people are drawn from.
    """

    seconds: float
    robot: Robot
    people: ObservedPeople
    goal: Tensor
    known: ObservedPeople
    going: Tensor
    draws: Draws


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


def begin(setting: Setting, cases: Cases) -> State:
    """Return the state in which cases start."""
    known = cases.people._replace(mask=in_range(setting, cases.robot, cases.people))
    draws = Draws(cases.draws.numbers, cases.draws.taken.clone())
    return State(
        0.0, cases.robot, cases.people, cases.goal, known, known.mask.new_ones(len(known.mask)), draws
    )


def step(setting: Setting, state: State, velocity: Tensor) -> tuple[State, Events]:
    """Return the state after `TIME_STEP`, and what happened in cases that had not ended.

    Args:
        setting: The rules.
        state: Before.
        velocity: What the robots' policy says (B, 2), m/s.
    """
    robot, people, going = state.robot, state.people, state.going
    valid = velocity.isfinite().all(1)
    velocity = torch.where((valid & going)[:, None], velocity.double(), 0)
    velocity = limit_speed(velocity, robot.v_pref)
    present = people._replace(mask=people.mask & going[:, None])
    walked = people_velocity(setting, robot, present, state.goal)
    moved = robot._replace(position=robot.position + TIME_STEP * velocity, velocity=velocity)

    judged = moved if setting.swept else robot
    clearance = swept_clearance(robot, people, velocity, TIME_STEP if setting.swept else 0.0).amin(1)
    arrived = (judged.position - robot.goal).norm(dim=-1) < robot.radius
    outcome = torch.where(clearance < 0, COLLISION, torch.where(arrived, SUCCESS, GOES_ON))
    if state.seconds >= setting.time_limit - EARLY:
        outcome = torch.full_like(outcome, TIMEOUT)
    outcome = torch.where(going, torch.where(valid, outcome, FAILED), GOES_ON)
    intruded = torch.full_like(clearance, torch.inf)
    if setting.foresight:
        apart = (places_ahead(setting, present, state.goal) - robot.position[:, None]).norm(dim=-1)
        overlaps = apart < robot.radius[:, None] + people.radius
        intruded = torch.where(overlaps & going[:, None], apart, torch.inf).amin((0, 2))
    disturbing = intruded.isfinite() if setting.foresight else clearance < setting.discomfort_dist
    depth = (clearance - setting.discomfort_dist) * setting.discomfort_factor * TIME_STEP
    ends = torch.tensor([0.0, setting.success_reward, setting.collision_penalty, 0.0, 0.0]).double()
    reward = ends[outcome] + torch.where(disturbing & going & (outcome == GOES_ON), depth, 0)

    people = people._replace(position=people.position + TIME_STEP * walked, velocity=walked)
    going = going & (outcome == GOES_ON)
    after = state._replace(seconds=state.seconds + TIME_STEP, robot=moved, people=people, going=going)
    after = after._replace(known=_known(setting, after))
    if setting.replaced:
        after = replaced(setting, after)
    seconds = after.seconds if setting.swept else state.seconds
    return after, Events(outcome, seconds, reward, clearance, intruded)


def swept_clearance(robot: Robot, people: ObservedPeople, velocity: Tensor, seconds: float) -> Tensor:
    """Return the least distances (B, N) between bodies on the way, metres; infinite for absent people.

    Args:
        robot: At the beginning.
        people: At the beginning; they go on with their velocities.
        velocity: Of the robot on the way (B, 2), m/s.
        seconds: How long the way is.
    """
    away = people.position - robot.position[:, None]
    move = (people.velocity - velocity[:, None]) * seconds
    apart = (away + closest_fraction(away, move)[..., None] * move).norm(dim=-1)
    return torch.where(people.mask, apart - robot.radius[:, None] - people.radius, torch.inf)


def in_range(setting: Setting, robot: Robot, people: ObservedPeople) -> Tensor:
    """Return which people the robot's sensor sees (B, N) bool."""
    if setting.sensor_range is None:
        return people.mask
    return people.mask & (
        swept_clearance(robot, people, torch.zeros_like(robot.position), 0.0) <= setting.sensor_range
    )


def _known(setting: Setting, state: State) -> ObservedPeople:
    """Return what the robot knows: people in sight as they are, others as if they had gone straight on."""
    seen = in_range(setting, state.robot, state.people)
    people, known = state.people, state.known
    gone_on = known.position + TIME_STEP * known.velocity
    position = torch.where(seen[..., None], people.position, gone_on)
    velocity = torch.where(seen[..., None], people.velocity, known.velocity)
    return ObservedPeople(position, velocity, people.radius, known.mask | seen)


def replaced(setting: Setting, state: State) -> State:
    """Return the state in which new people stand in for those who arrived, in the order of their slots."""
    people, goal = state.people, state.goal
    arrived = ((goal - people.position).norm(dim=-1) < people.radius) & state.going[:, None]
    place, target, velocity = people.position.clone(), goal.clone(), people.velocity.clone()
    while len(rows := arrived.any(1).nonzero()[:, 0]):
        slot = arrived[rows].long().argmax(1)
        taken = torch.stack((state.robot.position, state.robot.goal), dim=1)[rows]
        taken = torch.cat((taken, place[rows], target[rows]), dim=1)
        start = free_place(setting, state.draws, rows, taken)
        place[rows, slot], target[rows, slot], velocity[rows, slot] = start, -start, 0.0
        arrived[rows, slot] = False
    return state._replace(people=people._replace(position=place, velocity=velocity), goal=target)
