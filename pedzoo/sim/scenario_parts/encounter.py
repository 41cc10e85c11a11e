"""Scenes about one encounter: people come in lanes from several sides and reach a place at the same time.

Such scenarios differ in their floor plans and in their lanes; all starts follow from these. Scenes of
one scenario differ, too: in the floor plan where it has several, and in what people draw of ``jitter``,
``aside`` and ``delay``. With these and ``speed_std`` 0, and one number per setting, all are the same scene.

The encounters themselves are those of Francis et al., "Principles and Guidelines for Evaluating Social Robot
Navigation Algorithms" (2023, arXiv 2306.16740), Fig. 7 and Table 3, with people in the robot's part, too.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plans import Rectangle, rectangles
from pedzoo.sim.scenario_parts.lanes import ABREAST, APART, SPACING, Lane, Places
from pedzoo.sim.scenario_parts.scenario import SLOWEST, WARM_SECONDS, Layout, PreparedScenario, Scenario
from pedzoo.sim.scenario_parts.variants import Numbers, Variant, Variants

MEET = 2.5
"""Seconds after the warm start at which those in front meet if they are in time and nothing holds them up."""

MOST_JITTER = (ABREAST - APART) / 2
"""Metres: with more of it people of neighbouring lanes could be nearer than `APART` at the start."""

MOST_DELAY = 10.0
"""Seconds."""

BEHIND = 1.5
"""Metres of floor behind the last person, and behind goals."""

CELL = 0.05
"""Metres: side of the floor plans' cells."""

WALL = 0.1
"""Metres: thickness of outer walls."""


def whole_cells(length: float) -> float:
    """Return the least length of whole cells that is not smaller, metres."""
    return math.ceil(length / CELL - 1e-6) * CELL


@dataclass(frozen=True)
class EncounterSettings:
    """Settings of all encounters.

    Attributes:
        people: How many; most encounters take 2 to 300.
        speed: Mean preferred speed, m/s.
        speed_std: Its standard deviation.
        jitter: Metres that starts are off their places at most, in x and in y, evenly distributed.
        aside: Metres that all from one side start to the left or right of their lanes at most, evenly
            distributed; less where walls or others are near. Their goals stay.
        delay: Seconds that the first of a lane comes late at most, evenly distributed.
    """

    people: int = 2
    speed: float = 1.3
    speed_std: float = 0.2
    jitter: float = 0.1
    aside: float = 0.5
    delay: float = 0.5


class Encounter(Scenario):
    """People in lanes who meet; subclasses say which lanes, and on what floor plans.

    People start as far from the meeting point as they walk until then, so that slow and fast ones meet.
    People behind faster ones start at least `SPACING` from them.

    Attributes:
        fewest: People, at least.
        most: People, at most, and in ``more_would`` why not more.
        variants: Settings of which every scene draws a value.
        stray: Share of people with another goal of their lane than the first.
        together: People side by side walk together: equally fast, and equally late.
    """

    fewest: ClassVar[int] = 2
    most: ClassVar[int] = 300
    more_would: ClassVar[str] = "more need a floor plan that is hundreds of metres long"
    stray: float = 0.0
    meet: float = MEET
    together: bool = False

    def __init__(self, common: EncounterSettings, meet: float = MEET, **variants: Numbers) -> None:
        """Check the settings of all encounters.

        Args:
            common: Their settings.
            meet: Seconds after the warm start at which those in front meet.
            variants: Settings of which every scene draws a value.

        Raises:
            UserError: A setting that gives no scene.
        """
        people, jitter, aside, delay = common.people, common.jitter, common.aside, common.delay
        super().__init__(people, common.speed, common.speed_std)
        self.name = type(self).__module__.rpartition(".")[2]
        if not self.fewest <= people <= self.most:
            why = f", as {self.more_would}" if people > self.most else ""
            raise UserError(
                f"{self.name}: people {people}: expected {self.fewest} to {self.most}{why}; "
                "goals:people=N takes any number"
            )
        self.variants = Variants(self.name, **variants)
        if not aside >= 0 or not 0 <= delay <= MOST_DELAY:
            raise UserError(
                f"{self.name}: aside {aside}, delay {delay}: expected at least 0 m, and 0 to {MOST_DELAY:g} s"
            )
        if not 0 <= jitter <= self.most_jitter:
            raise UserError(f"{self.name}: jitter {jitter}: expected 0 to {self.most_jitter:.2f} m")
        self.jitter, self.aside, self.delay, self.meet = jitter, aside, delay, meet

    @abstractmethod
    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return where people come from.

        Agents are numbered lane by lane: first those in front, then those behind them.
        """

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the walls, whose edges are between cells of `CELL`; none: an open space.

        Args:
            variant: The settings' values.
            reach: Metres from its middle at which a lane's last one may start.
        """
        return []

    @property
    def most_jitter(self) -> float:
        """Metres between people at the start with which none touch."""
        return MOST_JITTER

    @property
    def slowest(self) -> float:
        """The smallest preferred speed that can be drawn, m/s."""
        return max(SLOWEST, self.speed - 3 * self.speed_std)

    @cached_property
    def lanes(self) -> list[list[Lane]]:
        """Where people come from, for every variant."""
        return [self.lanes_on(variant) for variant in self.variants]

    @cached_property
    def places(self) -> Places:
        """Each person's place in a lane, for every variant."""
        return Places.of(self.lanes)

    def check_share(self, setting: str, value: float) -> None:
        """Raise the error of a ``setting`` that is no share."""
        if not 0 <= value <= 1:
            raise UserError(f"{self.name}: {setting} {value}: expected a share from 0 to 1")

    def varied(self, side: int, lanes: list[Lane], room: float = math.inf) -> list[Lane]:
        """Return lanes whose people start aside and come late.

        Args:
            side: Its number: lanes of one side start aside by the same length.
            lanes: All lanes of the side.
            room: Metres to their left and right that are theirs.
        """
        aside = min(self.aside, max(0.0, room - self.jitter))
        return [lane._replace(side=side, aside=aside, delay=self.delay) for lane in lanes]

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plans, one for every variant; none where these are open spaces."""
        result = []
        for variant, lanes in zip(self.variants, self.lanes, strict=True):
            if walls := self.walls_on(variant, self._reach(lanes)):
                result.append(rectangles(walls, CELL, name=self.variants.name(variant)))
        return result

    def _reach(self, lanes: list[Lane]) -> float:
        longest = max(lane.before + (lane.people - 1) * SPACING + lane.delay * self.fastest for lane in lanes)
        return longest + (WARM_SECONDS + self.meet) * self.fastest + self.jitter

    def prepare(self, clearance: float) -> PreparedScenario:
        """Find the ways to the goals; tables: floor plans (V,) and goals (V, lanes, goals) of variants."""
        prepared = super().prepare(clearance)
        bank, names = prepared.bank, map(self.variants.name, self.variants)
        # variants may share a floor plan
        map_id = torch.tensor([bank.id_of(name) if bank.grids else -1 for name in names])
        most = max(len(lane.goals) for lanes in self.lanes for lane in lanes)
        goals = torch.full((len(self.lanes), max(map(len, self.lanes)), most), -1)
        for number, row in enumerate(bank.index(map_id).tolist()):
            lanes = self.lanes[number]
            points = torch.tensor([point for lane in lanes for point in lane.goals], dtype=torch.float64)
            ids = prepared.planner.add_goals(row, points).split([len(lane.goals) for lane in lanes])
            for place, mine in enumerate(ids):
                goals[number, place, : len(mine)] = mine
        return replace(prepared, tables=(map_id, goals))

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return all people as far from the middle of their lane as they walk until they meet."""
        scenes, agents, device = len(draws.key), self.people, draws.key.device
        variant = self.variants.drawn(draws)
        mine = self.places.of_scenes(variant)
        speed = self.speeds(draws)
        if self.together:
            speed = speed.gather(1, mine.leader)
        scene = torch.arange(scenes, device=device).unsqueeze(1)
        in_lanes = speed.new_zeros(scenes, int(self.places.row.max()) + 1, int(self.places.lane.max()) + 1)
        in_lanes[scene, mine.row, mine.lane] = speed
        pace = in_lanes.cummax(1).values[scene, mine.row, mine.lane]
        company = mine.side if self.together else mine.lane
        late = mine.delay * draws.uniform("delay", in_lanes.shape[2]).gather(1, company)
        away = mine.before + (WARM_SECONDS + self.meet + late) * pace
        sides = draws.uniform("aside", int(self.places.side.max()) + 1)
        right = mine.aside * (2 * sides.gather(1, mine.side) - 1)
        off = self.jitter * (2 * draws.uniform("jitter", agents, 2) - 1)
        along, across = mine.heading, torch.stack((mine.heading[..., 1], -mine.heading[..., 0]), dim=-1)
        start = mine.middle - away.unsqueeze(-1) * along + right.unsqueeze(-1) * across + off
        mask = torch.ones(scenes, agents, dtype=torch.bool, device=device)
        map_id, goals = (table.to(device) for table in prepared.tables)
        goal = self._goal(draws, goals[variant.unsqueeze(1), mine.lane])
        return Layout(map_id[variant], start, mask, speed, goal)

    def _goal(self, draws: Draws, goals: Tensor) -> Tensor:
        """Return people's goals (B, A) long, of those of their lane (B, A, G), -1 where there are fewer."""
        others = (goals >= 0).sum(2) - 1
        strays, which = draws.uniform("goal", self.people, 2).unbind(-1)
        other = 1 + (which * others).long().minimum(others - 1)
        choice = torch.where((strays < self.stray) & (others > 0), other, 0)
        return goals.gather(2, choice.unsqueeze(2)).squeeze(2)
