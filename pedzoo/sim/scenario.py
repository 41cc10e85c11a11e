"""The interface of scenarios: floor plans, people's starts, speeds and goals, and how they are simulated."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.randomness import Draws
from pedzoo.core.registry import name_of_class
from pedzoo.core.types import AHEAD_SECONDS, GOAL_RADIUS, STEP_SECONDS, TOP_SPEED_RATIO
from pedzoo.core.untrusted import MOST_PEOPLE
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, Unknown
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner, planner_class
from pedzoo.sim.script import Script
from pedzoo.sim.state import SLOWEST, State

MIN_INITIAL_PATH = 1.0
"""Minimum path length to the first goal, metres; nearer goals are redrawn."""

WARM_SECONDS = 7 * STEP_SECONDS
"""Duration of the warm start: with the start itself it fills the 8 observed steps."""

TIME_RATIO, LEAST_TIME_LIMIT = 4.0, 20.0
"""Time limit of a goal, divided by the time of its path at the preferred speed; the least one, seconds."""


class Layout(NamedTuple):
    """How B scenes begin. All after the goal may be left out: None is what most scenarios mean.

    What is not listed here is as of `State`, and None for what is usual there.

    Attributes:
        map_id: Floor plan (B,) long, -1 for none.
        start: Positions before the warm start (B, A, 2), metres; anything finite in empty slots.
        mask: Which agents are there (B, A) bool.
        pref_speed: The speed that people like (B, A), m/s.
        goal: First goals (B, A) long, as the planner numbers them.
        history: Recorded positions (B, A, 8, 2) for the warm start ``recorded``; the last one is where
            the episode begins.
        stand: How long people stand where they start, after the warm start, before they set out (B, A),
            seconds; 0 for agents that do not. No policy moves them so long.
        hold: How long people wait at their first goal, where they start, after the warm start (B, A),
            seconds; 0 for agents that do not, infinite until they are called or to the end. Their policy has
            to hold them there. Heeded where `Scenario.waits` says so.
        radius: None for that of the environment. None may be smaller than `Scenario.smallest_radius`.
        drive: Like the accelerations and the track, read where `Scenario.wheels` says so.
        top_speed: At most `Scenario.fastest_agent`.
        heading: Where bodies face at first (B, A), radians; None for where they walk, or else their goal.
        person: Where it is given people are on their way as ``history`` says: no warm start moves them.
        controlled: None: all who do not stand.
        deadline: Until when they have to arrive (B, A), seconds on the clock; None for the usual time limit.
        later: Their goals after the first (B, A, G) long, -1 for none; None: the scenario draws them.
    """

    map_id: Tensor
    start: Tensor
    mask: Tensor
    pref_speed: Tensor
    goal: Tensor
    pose: Tensor | None = None
    history: Tensor | None = None
    stand: Tensor | None = None
    hold: Tensor | None = None
    radius: Tensor | None = None
    kind: Tensor | None = None
    group: Tensor | None = None
    drive: Tensor | None = None
    acceleration: Tensor | None = None
    turn_acceleration: Tensor | None = None
    track: Tensor | None = None
    top_speed: Tensor | None = None
    heading: Tensor | None = None
    person: Tensor | None = None
    scene: Tensor | None = None
    controlled: Tensor | None = None
    observed_points: Tensor | None = None
    velocity: Tensor | None = None
    deadline: Tensor | None = None
    later: Tensor | None = None


def filled(value: Tensor | None, usual: Tensor) -> Tensor:
    """Return a value of a layout, or the ``usual`` one where the scenario leaves it out."""
    return usual if value is None else value


class Scenario(ABC):
    """A family of scenes: its settings, and how scenes begin. It stays as ``__init__`` made it.

    What takes time or files is in what `prepare` returns. All randomness comes from draws. Settings that give
    no scene raise `UserError`, there or in ``__init__``.

    Attributes:
        name: In messages and floor plans.
        people: A, the largest number of people in a scene; where there is a script, that says it.
        goals: Goals that each agent has to reach.
        patience: Seconds that agents have for their first goal at least, where that is more than usual.
        finished: An agent that has reached them all will ``leave`` the scene, ``continue`` to later goals
            until all agents have, or ``stand``.
        later: Goals after the first that are drawn ahead for each agent, and used in turn.
        wheels: Some agents have wheels or a limited acceleration: see `Layout.drive`.
        smallest_radius: Of any body, metres; None where all have that of the environment. Sub-steps are so
            short that no agent moves more than half of it.
        begun: People begin on their way, see `Layout.person`; no warm start moves them.
        waits: Some people wait at places: see `Layout.hold` and `pauses`.
        meet: Seconds after the warm start at which people meet who walk from the start on; None where they
            need not. A robot, which stands in the warm start, then starts as far ahead.
        unknown: Meaning of unknown cells of the floor plans.
        place_of_robot: Settings by which one robot takes the place of one person, each with its values, the
            usual one first; empty where robots are more people than ``people`` says.
    """

    place_of_robot: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    unknown: Unknown = "wall"
    finished: Literal["leave", "continue", "stand"] = "leave"
    wheels: bool = False
    begun: bool = False
    waits: bool = False
    smallest_radius: float | None = None
    meet: float | None = None
    later: int = 0
    goals: int = 1
    patience: float = 0.0
    people: int

    def __init__(self, people: int, speed: float = 1.3, speed_std: float = 0.2) -> None:
        """Say how many people there are at most, and how fast they like to walk.

        ``speed`` is the mean, m/s; what is farther from it than three times ``speed_std`` is cut off.
        """
        self.name = name_of_class(type(self).__name__)
        people = as_integer("people", people)
        if not 1 <= people <= MOST_PEOPLE:
            # thousands of digits are neither a float nor a text
            given = people if abs(people) < 10**9 else "beyond all use"
            raise UserError(f"people {given}: expected 1 to {MOST_PEOPLE:,}")
        if not (SLOWEST <= speed < math.inf and 0 <= speed_std < math.inf):
            raise UserError(
                f"speed {speed}, speed_std {speed_std}: expected at least {SLOWEST} and 0 (metres per second)"
            )
        self.people, self.speed, self.speed_std = people, speed, speed_std

    def check(self, valid: bool, given: str, expected: str) -> None:
        """Raise the error of settings ``given`` that are not as ``expected``, unless they are valid."""
        if not valid:
            raise UserError(f"{name_of_class(type(self).__name__)}: {given}: expected {expected}")

    @property
    def fastest(self) -> float:
        """The largest preferred speed that can be drawn, m/s."""
        return self.speed + 3 * self.speed_std

    @property
    def fastest_agent(self) -> float:
        """The largest top speed of any agent, m/s."""
        return TOP_SPEED_RATIO * self.fastest

    @abstractmethod
    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plans, possibly none."""

    @abstractmethod
    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return the beginning of the scenes of ``draws``; `prepare` returned ``prepared``."""

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return the next goals (P,) long of people who have just reached one; -1 for none.

        Also asked for people who would begin an episode nearer than `MIN_INITIAL_PATH` to their first goal.
        ``draws`` has one entry per person, that of their scene; ``agent`` are their slots in it, ``number``
        how many goals they have reached, and ``last`` the goal just reached, (P,) long each.
        """
        return torch.full_like(last, -1)

    def pauses(self, draws: Draws, number: Tensor) -> Tensor:
        """Return how long people wait where their present goal is, once they reach it (B, A), seconds.

        0: they do not, and the goal counts as reached. Infinite: until the person in the slot before theirs
        has taken more goals than they have; then they take the next one, on the way, too. ``number`` (B, A)
        says how many goals people took after the first.
        """
        return torch.zeros_like(number, dtype=torch.float32)

    def gate(self, draws: Draws) -> Tensor | None:
        """Return the door that the scenes of ``draws`` are about (B, 5); None where there is none.

        Its centre x and y, the unit normal x and y of the wall that it is in, and its clear width, metres.
        """
        return None

    def adapted(self, other: PreparedScenario) -> PreparedScenario | None:
        """Return this with the floor plans and ways of another, which are prepared once; None for others."""
        return None

    def prepare(self, clearance: float, planner: str = Planner.name) -> PreparedScenario:
        """Return the scenario with floor plans, and with ways to all goals, ``clearance`` m from walls.

        ``planner`` finds them: one of `pedzoo.maps.planning.planner.PLANNERS`.
        """
        ways = planner_class(planner)(MapBank(self.plans(), self.unknown), clearance)
        return PreparedScenario(scenario=self, planner=ways)

    def speeds(self, draws: Draws) -> Tensor:
        """Return the preferred speeds (B, A), m/s."""
        deviation = draws.normal("speed", self.people).clamp(-3, 3) * self.speed_std
        return (self.speed + deviation).clamp_min(SLOWEST)


@dataclass(frozen=True, eq=False, kw_only=True)
class PreparedScenario:
    """The result of `Scenario.prepare`. Environments of one clearance may share it: path fields take time.

    Attributes:
        scenario: The settings.
        planner: Ways to goals.
        tables: Tables of the scenario's own methods, such as the planner's numbers of goals.
        script: Plays people back and lets them come and go; None where all are there from the beginning.
    """

    scenario: Scenario
    planner: Planner
    tables: Any = None
    script: Script | None = None

    @property
    def bank(self) -> MapBank:
        """The floor plans."""
        return self.planner.bank

    @property
    def people(self) -> int:
        """A, the largest number of people in a scene."""
        return self.scenario.people if self.script is None else self.script.occupants.shape[1]

    @property
    def fastest(self) -> float:
        """The largest preferred speed, m/s; with a script, see `Script.fastest`."""
        return self.scenario.fastest if self.script is None else self.script.fastest

    @property
    def fastest_agent(self) -> float:
        """The largest top speed of any agent, m/s."""
        return self.scenario.fastest_agent if self.script is None else TOP_SPEED_RATIO * self.script.fastest

    def layout(self, draws: Draws) -> Layout:
        """Return the beginning of the scenes of ``draws``."""
        return self.scenario.layout(self, draws)


@dataclass(frozen=True)
class Rules:
    """Constants of all scenes of a simulation.

    Attributes:
        guidance: The planner's short-term goals and desired velocities of all agents.
        ticks: S, trace points of 0.1 s in one decision.
        substeps: M, sub-steps of every 0.1 s.
        goals: Goals that an agent has to reach.
        leave: An agent that has reached them all leaves the scene.
        keep_goal: An agent without a later goal keeps the one that it has reached; else it has none, and
            stands.
        wheels: Some bodies have wheels or a limited acceleration; without it `State.drive` and both
            accelerations are not looked at.
        waits: Says how long people wait where their goals are (B, A), seconds; None where no person does.
        script: Plays recorded people back; None for none.
        deadline: Seconds for every goal; None as `deadline` says.
    """

    guidance: Callable[[State], Guidance]
    ticks: int
    substeps: int
    goals: int = 1
    leave: bool = True
    keep_goal: bool = False
    wheels: bool = False
    waits: Callable[[State], Tensor] | None = None
    script: Script | None = None
    deadline: float | None = None


def rules_of(
    prepared: PreparedScenario,
    ticks: int,
    substeps: int,
    device: torch.device | str = "cpu",
    deadline: float | None = None,
) -> Rules:
    """Return the rules of a scenario for decisions of S ``ticks``, for scenes on a device.

    Raises:
        UserError: A deadline that is no time, or one for people of recordings, who have their own.
    """
    scenario, script = prepared.scenario, prepared.script
    check_deadline(deadline)
    if deadline is not None and script is not None:
        raise UserError(f"deadline {deadline}: people of recordings have the time that they took there")

    script = None if script is None else script.to(device)
    waits = partial(_pauses, prepared) if script is None else script.pauses
    return Rules(
        guidance=partial(_guidance, prepared),
        ticks=ticks,
        substeps=substeps,
        goals=scenario.goals,
        leave=scenario.finished == "leave",
        wheels=scenario.wheels,
        waits=waits if scenario.waits else None,
        script=script,
        deadline=deadline,
    )


def _pauses(prepared: PreparedScenario, state: State) -> Tensor:
    return prepared.scenario.pauses(Draws(state.key), state.goal_index)


def _guidance(prepared: PreparedScenario, state: State) -> Guidance:
    """Return the planner's guidance of all agents; people who wait go back to their place in one step."""
    guidance = prepared.planner.guidance(
        state.position,
        torch.where(state.mask, state.goal_id, -1),
        state.row,
        state.pose,
        state.pref_speed,
        AHEAD_SECONDS,
        prepared.fastest,
    )
    if not prepared.scenario.waits:
        return guidance
    holds = state.holds.unsqueeze(2)
    back = (guidance.goal_point - state.position) / STEP_SECONDS
    speed = back.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    back = back * (state.pref_speed.unsqueeze(2) / speed).clamp_max(1.0)
    return guidance._replace(
        goal=torch.where(holds, guidance.goal_point, guidance.goal),
        carrot=torch.where(holds, guidance.goal_point, guidance.carrot),
        desired_velocity=torch.where(holds, back, guidance.desired_velocity),
    )


def planned(way: Tensor) -> Tensor:
    """Return how far people with paths (B, A) of such lengths to their goals have to walk, metres."""
    return (way.detach() - GOAL_RADIUS).clamp_min(0)


def deadline(clock: Tensor, way: Tensor, pref_speed: Tensor, seconds: float | None = None) -> Tensor:
    """Return when a goal at the end of ``way`` (B, A), metres, must be reached: in four times its time.

    At least 20 s from ``clock`` (B,), the end of the decision in which the goal was drawn. Where ``seconds``
    are given, there are so many for every goal instead.
    """
    ways, least = (TIME_RATIO, LEAST_TIME_LIMIT) if seconds is None else (0.0, seconds)
    return clock.unsqueeze(1) + torch.clamp(ways * way / pref_speed, min=least)


def check_deadline(seconds: float | None) -> None:
    """Refuse seconds for every goal that are no time; None stands for the usual ones."""
    if seconds is not None and not 0 < seconds < math.inf:
        raise UserError(f"deadline {seconds}: expected a number of seconds above 0")
