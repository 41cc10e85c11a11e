"""Crowds in halls: people wait, queue, or walk in groups or two streams. Every class here is a scenario."""

import math

import torch
from torch import Tensor
from torch.nn.functional import pad

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, check_lengths, room, wall
from pedzoo.sim.scenario import WARM_SECONDS, Layout, PreparedScenario
from pedzoo.sim.scenarios._base import (
    BEHIND,
    CELL,
    WALL,
    Numbers,
    Range,
    Uniform,
    Variant,
    Variants,
    Varied,
    whole_cells,
)
from pedzoo.sim.scenarios._lanes import APART, FREE
from pedzoo.sim.scenarios.door import ABREAST

GROUPS_HALF = 3.0
"""Metres from the middle of the hall to its walls."""

OUTMOST = 7
"""Half places of `ABREAST` from the middle to the outmost person."""

GROUP_SPACING, BEYOND = 2.0, 5.0
"""Metres between groups one behind the other, and of the goals behind the middle."""

MEET = 1.5
"""Seconds after the warm start at which the first groups would meet in the middle."""

SIZES = (2, 4)
"""The smallest and the largest group."""


class Groups(Varied):
    """Groups come in turn from both ends of a hall of 6 m; some halls have a wall with a door at x = 0.

    People of a group start side by side, like the same speed, and have goals side by side. ``agents/group``
    names them. The last agents walk alone.
    """

    door = "door"

    def __init__(
        self,
        people: int = 14,
        alone: int = 2,
        size: tuple[int, int] = SIZES,
        door: Numbers = (0.0, 1.6),
        speed: float = 1.2,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: All together.
            alone: How many of them walk alone.
            size: The least and the largest group, 2 to 4; the last one may be smaller.
            door: Width of the door, metres; 0 for no wall. A list: one per scene.
            speed: Mean preferred speed of groups, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        self.variants = Variants(self.name, door=door)
        for width in self.variants.values["door"]:
            check_lengths(self.name, CELL, door=width or CELL)
        self.check(0 <= alone < people, f"alone {alone} of {people} people", f"0 to {people - 1}")
        fewest, most = size
        self.check(SIZES[0] <= fewest <= most <= SIZES[1], f"size {size}", "[least,most], from 2 to 4")
        self.alone, self.size = alone, (fewest, most)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the hall, and the wall with the door."""
        units = -(-(self.people - self.alone) // self.size[0]) + self.alone
        x = whole_cells((WARM_SECONDS + MEET) * self.fastest + GROUP_SPACING * -(-units // 2) + BEHIND)
        walls, doors = room((-x, -GROUPS_HALF), (x, GROUPS_HALF), WALL), [(GROUPS_HALF, variant["door"])]
        if variant["door"]:
            walls += wall((0.0, -GROUPS_HALF), (0.0, GROUPS_HALF), 2 * WALL, doors)
        return walls

    def places(self, variant: Variant) -> list[Point]:
        """Return the goals on the right and on the left, from the lowest y on."""
        across = [place * ABREAST / 2 for place in range(-OUTMOST, OUTMOST + 1)]
        return [(x, y) for x in (BEYOND, -BEYOND) for y in across]

    def seats(self, draws: Draws) -> tuple[Tensor, Tensor, Tensor]:
        """Return the number of each person's group, their place in it, and its size, (B, A) long each.

        Sizes of groups are drawn; people alone have numbers after those of the groups.
        """
        together, slot = self.people - self.alone, torch.arange(self.people, device=draws.key.device)
        fewest, most = self.size
        sizes = fewest + draws.integers("size", most - fewest + 1, -(-together // fewest) or 1)
        ends = sizes.cumsum(1).clamp_max(together)
        unit = torch.searchsorted(ends, slot.expand(len(ends), -1).contiguous(), right=True)
        last = unit.clamp_max(ends.shape[1] - 1)
        begin = pad(ends, (1, 0)).gather(1, last)
        alone = slot >= together
        units = (ends < together).sum(1, keepdim=True) + 1
        return (
            torch.where(alone, units + slot - together, unit),
            torch.where(alone, 0, slot - begin),
            torch.where(alone, 1, ends.gather(1, last) - begin),
        )

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return groups as far from the middle as they walk until they would meet."""
        unit, place, size = self.seats(draws)
        map_id, goals = self.drawn(prepared, draws)
        side, row = unit % 2, unit // 2
        speeds = pad(self.speeds(draws), (0, self.people % 2))
        # groups behind faster ones start no nearer to them than `GROUP_SPACING`
        pace = speeds.unflatten(1, (-1, 2)).cummax(1).values.flatten(1).gather(1, unit)
        away = (WARM_SECONDS + MEET) * pace + GROUP_SPACING * row
        free = 2 * OUTMOST + 2 - 2 * size  # half places that a group can be shifted by
        shift = (draws.uniform("across", self.people).gather(1, unit) * (free + 1)).long()
        across = shift + 2 * place
        x = torch.where(side == 0, -away, away)
        return Layout(
            map_id,
            torch.stack((x, ABREAST / 2 * (across - OUTMOST)), -1),
            torch.ones_like(unit, dtype=torch.bool),
            speeds.gather(1, unit),
            goals.gather(1, side * (2 * OUTMOST + 1) + across),
            group=torch.where(size > 1, unit, -1),
        )


LINE_SPACING, COMING = 0.8, 2.0
"""Metres between places in the line, and at least between people who come to it."""

COUNTER = (0.5, -1.0, 1.1, 1.0)
"""The counter's corners, metres; the person who is served stands at the origin."""

LINE_HALF = 3.2
"""Metres from the line to the walls."""

EXITS = [(-3.0, 2.6), (-3.0, -2.6)]


class Queue(Varied):
    """A line along x before a counter; the first person is served and leaves to one side, others move up.

    Places in the line are goals, at which the policy has to hold people. A person takes the next place when
    the person ahead leaves it, also on the way to the line. Goals that count are the exits. Agents are
    numbered from the counter.
    """

    waits = True

    def __init__(
        self,
        people: int = 8,
        coming: int = 3,
        seconds: Range = (2.0, 6.0),
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: All together.
            coming: How many of them are not in the line when the episode begins; they come to its end.
            seconds: How long a person is served; ``[least,most]``: each draws a time.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        self.check(0 <= coming < people, f"coming {coming} of {people} people", f"0 to {people - 1}")
        self.in_line, self.later, self.variants = people - coming, people + 1, Variants(self.name)
        self.seconds = Uniform(self.name, "seconds", seconds, least=0.1)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the room and the counter."""
        coming = self.people - self.in_line
        reach = LINE_SPACING * self.people + COMING * (coming + 1) + WARM_SECONDS * self.fastest
        left = whole_cells(max(reach, -EXITS[0][0]) + BEHIND)
        return [*room((-left, -LINE_HALF), (2.0, LINE_HALF), WALL), COUNTER]

    def places(self, variant: Variant) -> list[Point]:
        """Return the places from the counter on, and the exits."""
        return [*((-LINE_SPACING * place, 0.0) for place in range(self.people)), *EXITS]

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return the place before the last one, and an exit after the counter."""
        goals, place = prepared.tables[1].to(last.device)[0], agent - number
        exit = goals[self.people + (2 * draws.uniform_at("exit", agent)).long()]
        return torch.where(place >= 0, goals[place.clamp_min(0)], torch.where(place == -1, exit, -1))

    def pauses(self, draws: Draws, number: Tensor) -> Tensor:
        """Return how long people are served at the counter; at other places they wait to be called."""
        place = torch.arange(self.people, device=number.device) - number
        served = torch.where(place == 0, self.seconds.draw(draws, self.people), 0.0)
        return torch.where(place > 0, torch.inf, served)

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people at their places, and those who come behind them."""
        speed, (map_id, goals) = self.speeds(draws), self.drawn(prepared, draws)
        slot = torch.arange(self.people, device=speed.device)
        late = (slot - self.in_line + 1).clamp_min(0)
        back = torch.where(late > 0, COMING * late + WARM_SECONDS * speed.cummax(1).values, 0.0)
        start = -LINE_SPACING * torch.where(late > 0, self.people, slot) - back
        hold = self.pauses(draws, torch.zeros_like(goals[:, :-2]))
        return Layout(
            map_id,
            torch.stack((start, torch.zeros_like(start)), -1),
            torch.ones_like(speed, dtype=torch.bool),
            speed,
            goals[:, : self.people],
            hold=torch.where(late > 0, 0.0, hold),
        )


FRONT, STREAM_LANES = 0.5, 8
"""Metres from the middle to the first of a stream when the episode begins; goals at each end."""


class TwoWay(Varied):
    """Half of the people come from each end of a corridor along x, in no order; they meet in its middle.

    Both streams together have the given density where they are in the same place. Goals are behind the
    other stream, straight ahead: people need not change sides. Agents of even numbers come from the left.
    """

    def __init__(
        self,
        people: int = 40,
        width: float = 3.6,
        density: float = 0.9,
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: In both streams; with the width and the density they say how long these are.
            width: Of the corridor, metres, a multiple of 0.05.
            density: People per square metre where the streams are in the same place.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        check_lengths(self.name, CELL, width=width)
        self.check(people >= 2, f"people {people}", "at least 2")
        self.check(0 < density <= 2, f"density {density}", "people per square metre, up to 2")
        self.width, self.variants = width, Variants(self.name)
        # every person of a stream has a cell, as wide as possible
        self.columns = max(1, math.ceil(APART * density * width / 2))
        self.across = width / self.columns
        self.along = 2 / (density * self.across)
        cell = f"{self.across:.2f} m by {self.along:.2f} m for each person"
        self.check(self.across >= APART, cell, f"at least {APART} m: a lower density")
        self.length = self.along * -(-((people + 1) // 2) // self.columns)
        self.end = FRONT + self.length + WARM_SECONDS * speed

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the corridor's."""
        x = whole_cells(self.end + BEHIND)
        return room((-x, -self.width / 2), (x, self.width / 2), WALL)

    def places(self, variant: Variant) -> list[Point]:
        """Return the goals at the right end, and those at the left end."""
        step = (self.width - 2 * FREE) / STREAM_LANES
        across = [step * (lane + 0.5) - STREAM_LANES * step / 2 for lane in range(STREAM_LANES)]
        return [(x, y) for x in (self.end, -self.end) for y in across]

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return both streams, each person somewhere in a cell, at least 0.5 m from others of the stream."""
        speed, (map_id, goals) = self.speeds(draws), self.drawn(prepared, draws)
        slot = torch.arange(self.people, device=speed.device)
        number, side = slot // 2, slot % 2
        row, column = number // self.columns, number % self.columns
        along, across = (draws.uniform(name, self.people) - 0.5 for name in ("along", "across"))
        away = FRONT + self.along * (row + 0.5) + (self.along - APART) * along + WARM_SECONDS * self.speed
        aside = self.across * (column + 0.5) - self.width / 2 + (self.across - APART) * across
        start = torch.stack((torch.where(side == 0, -away, away), aside), -1)
        lane = ((aside / (self.width - 2 * FREE) + 0.5) * STREAM_LANES).long().clamp(0, STREAM_LANES - 1)
        mask = torch.ones_like(speed, dtype=torch.bool)
        return Layout(map_id, start, mask, speed, goals.gather(1, side * STREAM_LANES + lane))


HALL = (10.0, 4.0)
"""Metres from the middle of the hall to its walls."""

PLACE_APART = 1.2
"""Metres between places to wait at."""

PLACES = [
    (PLACE_APART * column, PLACE_APART * (row + (column % 2) / 2) - PLACE_APART / 4)
    for column in range(-3, 4)
    for row in range(-2, 3)
]

WAYS, WAY_APART = 9, 0.8
"""Ways through the hall, and metres between them."""

EXIT, ENTER = 8.0, 1.2
"""Metres from the middle to the exits, and behind them at which people start, at most."""


class Waiting(Varied):
    """Some people wait in a hall of 20 m by 8 m, others walk through it from both ends.

    People who wait have their place as goal, and their policy has to hold them there. Some of them set out
    for an exit after a drawn time. Others stay to the end, and are not scored for arriving. Agents are
    numbered from those who wait on.
    """

    waits = True
    later = 2

    def __init__(
        self,
        people: int = 12,
        waiting: int = 7,
        stay: float = 0.5,
        seconds: Range = (3.0, 12.0),
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: All together.
            waiting: How many of them wait at first, at most 35.
            stay: Share of these who stay to the end.
            seconds: How long the others wait; ``[least,most]``: each draws a time.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        passing = people - waiting
        self.check(
            0 <= waiting <= len(PLACES) and 1 <= passing <= 2 * WAYS,
            f"waiting {waiting} of {people} people",
            f"0 to {len(PLACES)} who wait, and 1 to {2 * WAYS} others",
        )
        self.check(0 <= stay <= 1, f"stay {stay}", "a share from 0 to 1")
        self.waiting, self.stay, self.variants = waiting, stay, Variants(self.name)
        self.seconds = Uniform(self.name, "seconds", seconds, least=0.1)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the hall's."""
        return room((-HALL[0], -HALL[1]), HALL, WALL)

    def places(self, variant: Variant) -> list[Point]:
        """Return the exits on the left, on the right, and the places to wait at."""
        lanes = [WAY_APART * (lane - WAYS // 2) for lane in range(WAYS)]
        return [(side * EXIT, y) for side in (-1, 1) for y in lanes] + PLACES

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return an exit for people who have waited."""
        goals = prepared.tables[1].to(last.device)[0]
        exit = goals[(draws.uniform_at("exit", agent) * 2 * WAYS).long()]
        goes = (agent < self.waiting) & (number == 1) & (draws.uniform_at("stay", agent) >= self.stay)
        return torch.where(goes, exit, -1)

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people at their places, and those who walk through at the ends of the hall."""
        device, agents, waiting = draws.key.device, self.people, self.waiting
        speed, (map_id, goals) = self.speeds(draws), self.drawn(prepared, draws)
        points = torch.tensor(self.places({}), device=device)
        place = 2 * WAYS + draws.uniform("place", len(PLACES)).topk(waiting).indices
        slot = torch.arange(agents - waiting, device=device)
        side = slot % 2  # 0: from the left
        lane = draws.uniform("lane", 2, WAYS).argsort(2)[:, side, slot // 2]
        enter = points[side * WAYS + lane]
        enter[..., 0] += (2 * side - 1) * ENTER * draws.uniform("enter", agents - waiting)
        leave = (1 - side) * WAYS + draws.integers("leave", WAYS, agents - waiting)
        stays = draws.uniform("stay", waiting) < self.stay
        hold = torch.where(stays, torch.inf, self.seconds.draw(draws, waiting))
        return Layout(
            map_id,
            torch.cat((points[place], enter), 1),
            torch.ones_like(speed, dtype=torch.bool),
            speed,
            goals.gather(1, torch.cat((place, leave), 1)),
            hold=torch.cat((hold, torch.zeros_like(enter[..., 0])), 1),
        )
