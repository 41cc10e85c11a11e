"""Encounters: people come in lanes from several sides and meet at one place at the same time.

The situations are those of Francis et al., "Principles and Guidelines for Evaluating Social Robot Navigation
Algorithms" (2023, arXiv 2306.16740), Fig. 7 and Table 3, with people in the robot's part, too.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle
from pedzoo.sim.scenario import SLOWEST, WARM_SECONDS, Layout, PreparedScenario
from pedzoo.sim.scenarios._base import CELL, Numbers, Variant, Variants, Varied, fastest_ahead

MEET, MAX_DELAY = 2.5, 10.0
"""Seconds after the warm start at which those in front meet if they are in time; greatest delay, seconds."""

SPACING, ABREAST = 0.9, 0.8
"""Metres between people one behind the other, and between lanes."""

APART, FREE, ASIDE = 0.5, 0.3, 0.45
"""Metres at least from starts to those in other lanes and to walls; from the outermost lanes to walls."""

BEYOND = 4.0
"""Metres of the goals behind the place of the encounter."""


class Lane(NamedTuple):
    """People one behind the other.

    Attributes:
        people: How many.
        heading: Unit vector in which they walk.
        middle: Where they meet others, metres.
        goals: Their goals after that, metres; all take the first, but for a share of strays.
        before: Metres that they all start farther back.
        side: Lanes of one side start aside by the same length.
        aside: Metres that they start to the left or to the right of the lane, at most.
        delay: Seconds that the first of them comes late, at most.
    """

    people: int
    heading: Point
    middle: Point
    goals: tuple[Point, ...]
    before: float = 0.0
    side: int = 0
    aside: float = 0.0
    delay: float = 0.0


class Places(NamedTuple):
    """The place of each person in a lane (V, A), on each of V variants of a scene; the rest as of `Lane`.

    Attributes:
        row: How many are ahead in the lane, long.
        lane: Number of the lane, long.
        leader: The person beside them: the first of their side and row, long.
        goal: Place of the lane's first goal among all, long.
        goals: How many the lane has, long.
        before: Metres that they start farther back, with those of their row.
    """

    row: Tensor
    lane: Tensor
    leader: Tensor
    goal: Tensor
    goals: Tensor
    side: Tensor
    heading: Tensor
    middle: Tensor
    before: Tensor
    aside: Tensor
    delay: Tensor

    @classmethod
    def of(cls, variants: Sequence[Sequence[Lane]]) -> Places:
        """Return each person's place: first those in front, lane by lane, then those behind them."""
        tables = []
        for lanes in variants:
            slots = sorted((row, number) for number, lane in enumerate(lanes) for row in range(lane.people))
            row, lane = torch.tensor(slots).unbind(1)
            side, *more = (
                torch.tensor([getattr(one, name) for one in lanes])[lane] for name in cls._fields[5:]
            )
            goals = torch.tensor([len(one.goals) for one in lanes])
            beside = (row == row.unsqueeze(1)) & (side == side.unsqueeze(1))
            first = (goals.cumsum(0) - goals)[lane]
            place = cls(row, lane, beside.int().argmax(1), first, goals[lane], side, *more)
            tables.append(place._replace(before=place.before + SPACING * row))
        return cls(*(torch.stack(table) for table in zip(*tables, strict=True)))

    def of_scenes(self, variant: Tensor) -> Places:
        """Return the places of B scenes (B, ...), each on the variant (B,) long of its own."""
        return Places(*(table.to(variant.device)[variant] for table in self))


def abreast(
    people: int, heading: Point, most: int, beyond: float = BEYOND, right: float = 0.0, before: float = 0.0
) -> list[Lane]:
    """Return people, shared out evenly, on their way past the origin in ``most`` lanes at most, side by side.

    The middle of the lanes keeps ``right`` metres to the right of the origin, goals are ``beyond`` metres
    behind it. ``heading`` and ``before`` are as of `Lane`.
    """
    lanes, (x, y) = [], heading
    for number, mine in enumerate(shares(people, min(most, people))):
        left = (number - (min(most, people) - 1) / 2) * ABREAST - right
        goal = beyond * x - y * left, beyond * y + x * left
        lanes.append(Lane(mine, heading, (-y * left, x * left), (goal,), before))
    return lanes


def shares(people: int, parts: int) -> list[int]:
    """Return how many people each of some parts has if they are shared out evenly."""
    return [people // parts + (number < people % parts) for number in range(parts)]


def beside(lanes: Sequence[Lane], width: float) -> float:
    """Return the room beside lanes in a corridor around the origin, metres, without `FREE`."""
    across = [lane.heading[0] * lane.middle[1] - lane.heading[1] * lane.middle[0] for lane in lanes]
    return width / 2 - FREE - max((abs(value) for value in across), default=0.0)


def lanes_in(width: float) -> int:
    """Return how many lanes fit between two walls, at least one."""
    return max(1, 1 + math.floor((width - 2 * ASIDE) / ABREAST + 1e-6))


def block(people: int) -> int:
    """Return how many lanes a group in the open has that is as broad as deep, five at most."""
    return min(5, math.ceil(math.sqrt(people)))


@dataclass(frozen=True)
class EncounterSettings:
    """Settings of all encounters.

    Attributes:
        people: How many; most encounters take 2 to 300.
        speed: Mean preferred speed, m/s.
        speed_std: Its standard deviation.
        jitter: Greatest distance of starts from their places in x and in y, metres, uniformly distributed.
        aside: Greatest shift of all starts of one side to the left or right of their lanes, metres, uniformly
            distributed; less where walls or others are near. Goals stay.
        delay: Greatest delay of the first of a lane, seconds, uniformly distributed.
    """

    people: int = 2
    speed: float = 1.3
    speed_std: float = 0.2
    jitter: float = 0.1
    aside: float = 0.5
    delay: float = 0.5


class Encounter(Varied):
    """People in lanes who meet; subclasses say which lanes, and on what floor plans.

    People start as far from the meeting point as they walk until then, so that slow and fast ones meet.
    People behind faster ones start at least `SPACING` from them. Scenes differ in the floor plan where there
    are several, in speeds, and in ``jitter``, ``aside`` and ``delay``; with all of these 0 they are the same.

    Attributes:
        fewest: People, at least.
        most: People, at most, and in ``more_would`` why not more.
        max_jitter: Greatest jitter with which people of different lanes keep `APART` at the start, metres.
        stray: Share of people with another goal of their lane than the first.
        together: People side by side walk together: equally fast, and equally late.
    """

    fewest: ClassVar[int] = 2
    most: ClassVar[int] = 300
    more_would: ClassVar[str] = "more need a floor plan that is hundreds of metres long"
    max_jitter: float = (ABREAST - APART) / 2
    stray: float = 0.0
    meet: float = MEET
    together: bool = False

    def __init__(self, common: EncounterSettings, meet: float = MEET, **variants: Numbers) -> None:
        """Check the settings of all encounters; ``meet`` is as `MEET`.

        Every scene draws a value of each of ``variants``; ``width`` and ``corridor`` are whole cells.
        """
        people, jitter, aside, delay = common.people, common.jitter, common.aside, common.delay
        super().__init__(people, common.speed, common.speed_std)
        why = f", as {self.more_would}" if people > self.most else ""
        enough = f"{self.fewest} to {self.most}{why}; goals:people=N takes any number"
        self.check(self.fewest <= people <= self.most, f"people {people}", enough)
        self.variants = Variants(self.name, **variants)
        self.variants.check_lengths(CELL, *(name for name in ("width", "corridor") if name in variants))
        in_time = f"at least 0 m, and 0 to {MAX_DELAY:g} s"
        self.check(aside >= 0 and 0 <= delay <= MAX_DELAY, f"aside {aside}, delay {delay}", in_time)
        self.check(0 <= jitter <= self.max_jitter, f"jitter {jitter}", f"0 to {self.max_jitter:.2f} m")
        self.jitter, self.aside, self.delay, self.meet = jitter, aside, delay, meet

    @abstractmethod
    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return where people come from; agents are numbered from those in front, lane by lane."""

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return walls between cells; the last one of a lane may start ``reach`` metres from its middle."""
        return []

    @property
    def slowest(self) -> float:
        """The smallest preferred speed that can be drawn, m/s."""
        return max(SLOWEST, self.speed - 3 * self.speed_std)

    @cached_property
    def lanes(self) -> list[list[Lane]]:
        """Where people come from, for every variant."""
        return [self.lanes_on(variant) for variant in self.variants]

    @cached_property
    def seats(self) -> Places:
        """Each person's place in a lane, for every variant."""
        return Places.of(self.lanes)

    def varied(self, side: int, lanes: list[Lane], room: float = math.inf) -> list[Lane]:
        """Return all lanes of a side, whose people start aside within ``room`` metres, and come late."""
        aside = min(self.aside, max(0.0, room - self.jitter))
        return [lane._replace(side=side, aside=aside, delay=self.delay) for lane in lanes]

    def walls(self, variant: Variant) -> list[Rectangle]:
        """See `Varied.walls`; the last of a lane have room, too."""
        lanes = self.lanes_on(variant)
        longest = max(lane.before + (lane.people - 1) * SPACING + lane.delay * self.fastest for lane in lanes)
        return self.walls_on(variant, longest + (WARM_SECONDS + self.meet) * self.fastest + self.jitter)

    def places(self, variant: Variant) -> list[Point]:
        """Return the goals of all lanes."""
        return [point for lane in self.lanes_on(variant) for point in lane.goals]

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return all people as far from the middle of their lane as they walk until they meet."""
        mine = self.seats.of_scenes(self.variants.draw(draws))
        map_id, goals = self.drawn(prepared, draws)
        speed = self.speeds(draws)
        if self.together:
            speed = speed.gather(1, mine.leader)
        late = draws.uniform("delay", int(self.seats.lane.max()) + 1)
        late = mine.delay * late.gather(1, mine.side if self.together else mine.lane)
        away = mine.before + (WARM_SECONDS + self.meet + late) * fastest_ahead(speed, mine.row, mine.lane)
        sides = draws.uniform("aside", int(self.seats.side.max()) + 1)
        right = mine.aside * (2 * sides.gather(1, mine.side) - 1)
        off = self.jitter * (2 * draws.uniform("jitter", self.people, 2) - 1)
        along, across = mine.heading, torch.stack((mine.heading[..., 1], -mine.heading[..., 0]), dim=-1)
        start = mine.middle - away.unsqueeze(-1) * along + right.unsqueeze(-1) * across + off
        strays, which = draws.uniform("goal", self.people, 2).unbind(-1)
        others = mine.goals - 1
        other = 1 + (which * others).long().minimum(others - 1)
        goal = goals.gather(1, mine.goal + other * ((strays < self.stray) & (others > 0)))
        return Layout(map_id, start, torch.ones_like(goal, dtype=torch.bool), speed, goal)
