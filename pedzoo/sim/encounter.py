"""Scenes about one encounter: people come in lanes from several sides and reach a place at the same time.

Such scenarios differ in their floor plan and in their lanes; who starts where follows from these. The
encounters themselves are those of Francis et al., "Principles and Guidelines for Evaluating Social Robot
Navigation Algorithms" (2023, arXiv 2306.16740), Fig. 7 and Table 3, with people in the robot's part, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from pedzoo.draws import Draws
from pedzoo.errors import UserError
from pedzoo.maps.plain import Point
from pedzoo.sim.scenario import SLOWEST, WARM_SECONDS, Layout, Scenario

MEET = 2.5
"""Seconds after the warm start at which those in front meet if nothing holds them up."""

SPACING = 0.9
"""Metres between people who come one behind the other."""

ABREAST = 0.8
"""Metres between lanes."""

MOST_JITTER = (ABREAST - 0.5) / 2
"""Metres: with more of it people of neighbouring lanes could be nearer than 0.5 m at the start."""

BEYOND = 4.0
"""Metres of the goals behind the place of the encounter."""

BEHIND = 1.5
"""Metres of floor behind whoever comes last, and behind goals."""

CELL = 0.05
"""Metres: side of the floor plans' cells."""

WALL = 0.1
"""Metres: thickness of outer walls."""

_ASIDE = 0.45
"""Metres between the outermost lanes and walls."""


class Lane(NamedTuple):
    """People who come one behind the other.

    Attributes:
        people: How many.
        heading: Unit vector in which they walk.
        middle: Where they meet others, metres.
        goals: Where they go from there, metres; everybody to the first, but for a share of strays.
        before: Metres that they all start farther back.
    """

    people: int
    heading: Point
    middle: Point
    goals: tuple[Point, ...]
    before: float = 0.0


def abreast(
    people: int, heading: Point, most: int, beyond: float = BEYOND, right: float = 0.0, before: float = 0.0
) -> list[Lane]:
    """Return people on their way past the origin in lanes side by side.

    Args:
        people: How many, shared out evenly.
        heading: Unit vector in which they walk.
        most: Lanes, at most.
        beyond: Metres of the goals behind the origin.
        right: Metres that the middle of the lanes keeps to the right of it.
        before: Metres that they all start farther back.
    """
    count = min(most, people)
    lanes = []
    for number in range(count):
        left = (number - (count - 1) / 2) * ABREAST - right
        middle = (-heading[1] * left, heading[0] * left)
        goal = (middle[0] + beyond * heading[0], middle[1] + beyond * heading[1])
        mine = people // count + (number < people % count)
        lanes.append(Lane(mine, heading, middle, (goal,), before))
    return lanes


def lanes_in(width: float) -> int:
    """Return how many lanes fit between two walls, at least one."""
    return max(1, 1 + math.floor((width - 2 * _ASIDE) / ABREAST + 1e-6))


def block(people: int) -> int:
    """Return in how many lanes people in the open come who are as broad as deep, five at most."""
    return min(5, math.ceil(math.sqrt(people)))


def whole_cells(length: float) -> float:
    """Return the least length of whole cells that is not smaller, metres."""
    return math.ceil(length / CELL - 1e-6) * CELL


class Encounter(Scenario):
    """People in lanes who meet; subclasses say which, and on what floor plan.

    Everybody starts as far away as they walk until then, so that the slow and the fast meet. Whoever comes
    behind somebody faster starts no nearer to them than `SPACING`.

    Attributes:
        fewest: People, at least.
        most: People, at most.
        lanes: Where they come from; set by the subclass before `Scenario.prepare`. Agents are numbered
            lane by lane: first those in front, then those behind them.
        stray: Share of people who go to another goal of their lane than the first.
    """

    fewest: ClassVar[int] = 2
    most: ClassVar[int] = 50
    lanes: Sequence[Lane]
    stray: float = 0.0

    def __init__(
        self,
        people: int,
        speed: float,
        speed_std: float,
        jitter: float,
        meet: float = MEET,
        most_jitter: float = MOST_JITTER,
    ) -> None:
        """Check what all encounters have.

        Args:
            people: How many.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, to each side, evenly distributed.
            meet: Seconds after the warm start at which those in front meet.
            most_jitter: Metres with which nobody touches anybody at the start.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std)
        self.name = type(self).__module__.rpartition(".")[2]
        if not self.fewest <= people <= self.most:
            raise UserError(
                f"{self.name}: people {people}: expected {self.fewest} to {self.most}; "
                "goals:people=N takes any number"
            )
        if not 0 <= jitter <= most_jitter:
            raise UserError(f"{self.name}: jitter {jitter}: expected 0 to {most_jitter:.2f} m")
        self.jitter, self.meet = jitter, meet

    @property
    def slowest(self) -> float:
        """The smallest preferred speed that can be drawn, m/s."""
        return max(SLOWEST, self.speed - 3 * self.speed_std)

    @property
    def reach(self) -> float:
        """Metres from its middle at which a lane's last one may start."""
        longest = max(lane.before + (lane.people - 1) * SPACING for lane in self.lanes)
        return longest + (WARM_SECONDS + self.meet) * self.fastest + self.jitter

    def check_share(self, setting: str, value: float) -> None:
        """Raise the error of a ``setting`` that is no share."""
        if not 0 <= value <= 1:
            raise UserError(f"{self.name}: {setting} {value}: expected a share from 0 to 1")

    def prepare(self, clearance: float) -> None:
        """Find the ways to the lanes' goals, and give everybody a place in a lane."""
        super().prepare(clearance)
        plan = 0 if self.bank.grids else -1
        counts = [len(lane.goals) for lane in self.lanes]
        points = [point for lane in self.lanes for point in lane.goals]
        ids = self.planner.add_goals(plan, torch.tensor(points, dtype=torch.float64)).split(counts)
        self._goals = torch.nn.utils.rnn.pad_sequence(list(ids), batch_first=True, padding_value=-1)
        self._counts = torch.tensor(counts)
        slots = [(row, number) for number, lane in enumerate(self.lanes) for row in range(lane.people)]
        self.row, self.lane = torch.tensor(sorted(slots)).unbind(1)
        self._heading, self._middle = (
            torch.tensor([getattr(lane, name) for lane in self.lanes])[self.lane]
            for name in ("heading", "middle")
        )
        self._before = torch.tensor([lane.before for lane in self.lanes])[self.lane] + SPACING * self.row

    def layout(self, draws: Draws) -> Layout:
        """Return everybody as far from the middle of their lane as they walk until they meet."""
        scenes, agents, device = len(draws.key), self.people, draws.key.device
        row, lane = self.row.to(device), self.lane.to(device)
        speed = self.speeds(draws)
        in_lanes = speed.new_zeros(scenes, int(row.max()) + 1, len(self.lanes))
        in_lanes[:, row, lane] = speed
        pace = in_lanes.cummax(1).values[:, row, lane]
        away = self._before.to(device) + (WARM_SECONDS + self.meet) * pace
        off = self.jitter * (2 * draws.uniform("jitter", agents, 2) - 1)
        start = self._middle.to(device) - away.unsqueeze(-1) * self._heading.to(device) + off
        number = self.bank.grids[0].map_id if self.bank.grids else -1
        map_id = torch.full((scenes,), number, device=device)
        mask = torch.ones(scenes, agents, dtype=torch.bool, device=device)
        return Layout(map_id, start, mask, speed, self._goal(draws, lane))

    def _goal(self, draws: Draws, lane: Tensor) -> Tensor:
        """Return everybody's goal (B, A) long."""
        others = (self._counts.to(lane.device) - 1)[lane]
        strays, which = draws.uniform("goal", self.people, 2).unbind(-1)
        other = 1 + (which * others).long().minimum(others - 1)
        choice = torch.where((strays < self.stray) & (others > 0), other, 0)
        return self._goals.to(lane.device)[lane, choice]
