"""The encounters of Francis et al. 2023 (Fig. 7, Table 3): every public class here is a scenario by its name.

Lengths of walls are multiples of 0.05 m. A setting with a list has one of its values in each scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, room, wall
from pedzoo.sim.scenario import door_at_origin
from pedzoo.sim.scenarios._base import BEHIND, CELL, WALL, Numbers, Variant, whole_cells
from pedzoo.sim.scenarios._lanes import (
    ABREAST,
    APART,
    BEYOND,
    FREE,
    SPACING,
    Encounter,
    EncounterSettings,
    Lane,
    abreast,
    beside,
    block,
    lanes_in,
    shares,
)

HEADINGS: tuple[Point, ...] = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
"""Of those from the left, from below, from the right and from above."""

OVERTAKING_BEYOND = 8.0
"""Metres of the goals behind the place at which the slow are caught up with."""

SLOW, FAST = 0, 1
"""Numbers of the two sides of `Overtaking`."""

PARALLEL_BEYOND = 6.0
"""Metres of the goals behind the line on which those in front are at the same time."""

CHORD = 1.0
"""Minimum distance of neighbours on a circle, metres."""

RADII, MIN_RADIUS = (3.0, 4.0, 5.0), 2.0
"""Radii of a circle by default, and the smallest one, metres."""

THICKNESS = 0.1
"""Metres of the wall with the door of a room."""

MANY = 150
"""People of a room from whom on more directions keep their lanes short."""

RAYS = {False: (5, math.radians(18)), True: (17, math.radians(9))}
"""Most directions from which people come to a room's door, and the angle between two; with `MANY`: True."""

BESIDE_RAYS = 0.3
"""Metres on each side of a direction that belong to it."""

MIN_FLOW = 1.0
"""People per second and metre of a door's width who get out in time: half as many as in real queues."""


class BlindCorner(Encounter):
    """People meet behind a corner around which they cannot see.

    *Blind corner*: a corridor from the left that bends down at the origin; people come from both ends. When
    the episode begins, no person sees those from the other end; the first ones are at the corner at the same
    time. The two groups mirror each other in the diagonal if size and speed are equal and ``jitter``,
    ``aside`` and ``delay`` are 0.
    """

    def __init__(
        self, width: Numbers = (1.2, 1.5, 2.0), common: EncounterSettings = EncounterSettings()
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres; or a list.
            common: Half of them from the left, the others from below.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, meet=3.0, width=width)
        self.variants.check_lengths(CELL, "width")

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from below."""
        width = variant["width"]
        fit, beyond = lanes_in(width), BEYOND + width / 2
        lanes = []
        for side, people in enumerate((self.people - self.people // 2, self.people // 2)):
            straight = abreast(people, (1.0, 0.0), fit)
            mine = self.varied(side, straight, beside(straight, width))
            # two people this far from the corner do not see each other
            unseen = width + max(lane.middle[1] + lane.aside for lane in mine) + self.jitter + 0.1
            before = max(0.0, unseen - self.meet * self.slowest)
            for lane in mine:
                # people at the outer wall before the corner are there behind it, too
                bent = lane._replace(before=before, goals=((lane.middle[1], -beyond),))
                lanes.append(_mirrored(bent) if side else bent)
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor: a square without all but its upper and its right side."""
        side = variant["width"] / 2
        far = whole_cells(max(reach, BEYOND + side) + BEHIND)
        return [*room((-far, -far), (side, side), WALL), (-far, -far, -side, -side)]


def _mirrored(lane: Lane) -> Lane:
    """Return a lane on the other side of the diagonal."""
    swapped = tuple((y, x) for x, y in lane.goals)
    return lane._replace(heading=lane.heading[::-1], middle=lane.middle[::-1], goals=swapped)


class Circle(Encounter):
    """People on a circle change places with those opposite.

    *Circular crossing*: the antipodal swap of van den Berg et al., "Reciprocal n-body collision avoidance"
    (2011). People come from outside, evenly around a circle without walls, are about on it when the episode
    begins, and all want to go through its middle.
    """

    def __init__(
        self,
        radius: Numbers | None = None,
        common: EncounterSettings = EncounterSettings(people=4, aside=1.0),
    ) -> None:
        """Set the scene.

        Args:
            radius: Of the circle, metres; or a list. None: 3, 4 and 5, without those at which neighbours
                would be closer than 1 m, or the least at which they are not.
            common: People are late and start aside each on their own.

        Raises:
            UserError: A setting that gives no scene.
        """
        people = common.people
        self.half_chord = math.sin(math.pi / max(people, 2))  # between neighbours, for a radius of 1
        least = CHORD / (2 * self.half_chord)
        if radius is None:
            radius = [usual for usual in RADII if usual >= least] or [least]
        least = max(least, MIN_RADIUS)
        for given in radius if isinstance(radius, Sequence) else [radius]:
            expected = f"at least {least:.2f} m, which puts them {CHORD} m apart or more"
            self.check(given >= least, f"radius {given} for {people} people", expected)
        super().__init__(common, meet=0.0, radius=radius)

    @property
    def max_jitter(self) -> float:
        """Greatest jitter with which no people touch at the start, metres."""
        return min(1.0, max(0.0, self._room(min(self.variants.values["radius"]))))

    def _room(self, radius: float) -> float:
        """Return the metres beside each person on the circle that are theirs."""
        return radius * self.half_chord - APART / 2

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return a lane for each person, from their place on the circle through its middle."""
        radius, lanes = variant["radius"], []
        for number in range(self.people):
            angle = 2 * math.pi * number / self.people
            x, y = math.cos(angle), math.sin(angle)
            lane = Lane(1, (-x, -y), (0.0, 0.0), ((-radius * x, -radius * y),), radius)
            lanes += self.varied(number, [lane], self._room(radius))
        return lanes


class Hallway(Encounter):
    """People come towards each other in a corridor.

    *Frontal approach*: a corridor along x; some come from the left, some from the right, and meet at x = 0.
    *Narrow hallway* with a small width: two people pass each other from about 0.7 m on, comfortably from
    1.5 m on. Two groups of the same size and speed are mirror images of each other in the origin where
    ``jitter``, ``aside`` and ``delay`` are 0.
    """

    def __init__(
        self,
        width: Numbers = (1.5, 2.0, 3.0),
        offset: Numbers = 0.0,
        against: int | None = None,
        common: EncounterSettings = EncounterSettings(aside=0.8, delay=1.0),
        together: bool = False,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres; or a list.
            offset: Metres that people keep to the right of the corridor's middle; 0 is head-on; or a list.
            against: How many of the people come from the right; None: half of them.
            common: People are side by side where the corridor has room, and one behind the other.
            together: People side by side walk together: equally fast, and equally late.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, width=width, offset=offset)
        self.variants.check_lengths(CELL, "width")
        people = self.people
        against = people // 2 if against is None else against
        self.check(1 <= against < people, f"against {against} of {people} people", f"1 to {people - 1}")
        self.against, self.together = against, together
        for variant in self.variants:
            most = variant["width"] / 2 - FREE
            given = f"offset {variant['offset']} in a corridor of {variant['width']} m"
            self.check(abs(variant["offset"]) <= max(0.0, most), given, f"at most {most:.2f} m")

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from the right."""
        width, offset = variant["width"], variant["offset"]
        lanes = []
        for side, people in enumerate((self.people - self.against, self.against)):
            mine = abreast(people, (1.0 - 2 * side, 0.0), lanes_in(width - 2 * abs(offset)), right=offset)
            lanes += self.varied(side, mine, beside(mine, width))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor."""
        x, y = whole_cells(max(reach, BEYOND) + BEHIND), variant["width"] / 2
        return room((-x, -y), (x, y), WALL)


class Intersection(Encounter):
    """People cross where two corridors do.

    *Intersection*, without gestures: two corridors of the same width that cross at the origin; people come
    from their arms in turn. Those in front are in the middle at the same time.
    """

    def __init__(
        self,
        width: Numbers = (1.5, 2.5),
        arms: int = 4,
        turn: float = 0.0,
        common: EncounterSettings = EncounterSettings(),
    ) -> None:
        """Set the scene.

        Args:
            width: Of both corridors, metres; or a list.
            arms: From how many arms people come, 2 (from the left and from below) to 4.
            turn: Share of people who turn left or right there; all others go straight on.
            common: People are shared out evenly over the arms.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, width=width)
        self.variants.check_lengths(CELL, "width")
        self.check(0 <= turn <= 1, f"turn {turn}", "a share from 0 to 1")
        self.check(2 <= arms <= 4, f"arms {arms}", "2 to 4")
        self.arms, self.stray = arms, turn

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the arms."""
        width = variant["width"]
        lanes = []
        for arm, people in enumerate(shares(self.people, self.arms)[: self.people]):
            straight = abreast(people, HEADINGS[arm], lanes_in(width), BEYOND + width / 2)
            for lane in self.varied(arm, straight, beside(straight, width)):
                ((x, y),) = lane.goals
                turns = ((-y, x), (y, -x)) if self.stray else ()
                lanes.append(lane._replace(goals=((x, y), *turns)))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridors: a square without its four corners."""
        side = variant["width"] / 2
        ends = whole_cells(max(reach, BEYOND + side) + BEHIND) + side
        walls = room((-ends, -ends), (ends, ends), WALL)
        for x0, x1 in ((-ends, -side), (side, ends)):
            walls += [(x0, y0, x1, y1) for y0, y1 in ((-ends, -side), (side, ends))]
        return walls


class Overtaking(Encounter):
    """Fast people catch up with slow ones in a corridor.

    *Pedestrian overtaking*: all walk to the right in a corridor along x; the fast reach the slow at x = 0.
    Agents 0 to ``slow - 1`` are the slow ones where each person has a lane.
    """

    def __init__(
        self,
        width: Numbers = (1.8, 2.4, 3.0),
        speed_ratio: float = 1.6,
        slow: int | None = None,
        common: EncounterSettings = EncounterSettings(aside=0.35),
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres; or a list.
            speed_ratio: By how much each of the fast is faster than each of the slow, at least; above 1.2.
            slow: How many of the people are slow; None: half of them.
            common: Speeds and delays are those of the fast.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, meet=3.0, width=width)
        self.variants.check_lengths(CELL, "width")
        people = self.people
        slow = people // 2 if slow is None else slow
        self.check(1 <= slow < people, f"slow {slow} of {people} people", f"1 to {people - 1}")
        self.check(speed_ratio >= 1.2, f"speed_ratio {speed_ratio}", "at least 1.2")
        self.slow, self.speed_ratio = slow, speed_ratio

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes of the slow and of the fast."""
        width = variant["width"]
        fit, queue = lanes_in(width), self._queue(variant)
        beyond, ahead = OVERTAKING_BEYOND + 2 * queue, (1.0, 0.0)
        slow = abreast(self.slow, ahead, fit, beyond, before=-queue)
        fast = abreast(self.people - self.slow, ahead, fit, beyond)
        slow = self.varied(SLOW, slow, beside(slow, width))
        return [*(lane._replace(delay=0.0) for lane in slow), *self.varied(FAST, fast, beside(fast, width))]

    def _queue(self, variant: Variant) -> float:
        """Return how far the last of the slow are behind the first, metres: they are at x = 0."""
        return (-(-self.slow // lanes_in(variant["width"])) - 1) * SPACING

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor."""
        beyond, y = OVERTAKING_BEYOND + 2 * self._queue(variant), variant["width"] / 2
        return room((-whole_cells(reach + BEHIND), -y), (whole_cells(beyond + BEHIND), y), WALL)

    def speeds(self, draws: Draws) -> Tensor:
        """Return the preferred speeds (B, A), m/s: the slow keep a distance from the slowest fast."""
        speed = super().speeds(draws)
        slow = self.places.of_scenes(self.variants.draw(draws)).side == SLOW
        limit = speed.masked_fill(slow, float("inf")).amin(1, keepdim=True)
        return speed.where(~slow, speed.minimum(limit) / self.speed_ratio)


class Parallel(Encounter):
    """Two streams of people side by side in an open space.

    *Parallel traffic*: streams along x without walls, one left of the other, in the same direction or in
    opposite ones. Some people change over into a lane of the other stream on their way; with
    ``opposite=true`` it is bidirectional flow, all people on the right.
    """

    def __init__(
        self,
        opposite: bool = False,
        gap: Numbers = (0.8, 1.2, 1.6),
        change: float = 0.3,
        common: EncounterSettings = EncounterSettings(people=6),
    ) -> None:
        """Set the scene.

        Args:
            opposite: The second stream walks the other way.
            gap: Metres between the nearest lanes of the two streams; or a list.
            change: Share of people with a goal in a lane of the other stream, in their own direction.
            common: Half of the people are in each stream, five abreast at most.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, gap=gap)
        self.check(0 <= change <= 1, f"change {change}", "a share from 0 to 1")
        for least in self.variants.values["gap"]:
            self.check(least >= ABREAST, f"gap {least}", f"at least {ABREAST} m, as between lanes")
        self.opposite, self.stray = opposite, change

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return the lanes of both streams."""
        right = self.people - self.people // 2
        most = block(right)
        aside = (variant["gap"] + (most - 1) * ABREAST) / 2
        room = (variant["gap"] - APART) / 2
        first = self.varied(0, abreast(right, (1.0, 0.0), most, PARALLEL_BEYOND, right=aside), room)
        heading, keeps = ((-1.0, 0.0), aside) if self.opposite else ((1.0, 0.0), -aside)
        second = abreast(self.people // 2, heading, most, PARALLEL_BEYOND, right=keeps)
        second = self.varied(1, second, room)
        return [_changing(lane, second) for lane in first] + [_changing(lane, first) for lane in second]


def _changing(lane: Lane, others: list[Lane]) -> Lane:
    """Return a lane whose people may also have goals in the other stream."""
    x = lane.goals[0][0]
    return lane._replace(goals=(*lane.goals, *((x, other.middle[1]) for other in others)))


class Perpendicular(Encounter):
    """Two streams of people that cross at right angles in an open space.

    *Perpendicular traffic*: streams along x and along y without walls; those in front are at the crossing at
    the same time.
    """

    def __init__(self, common: EncounterSettings = EncounterSettings(people=6, aside=1.0)) -> None:
        """Set the scene.

        Args:
            common: Half of the people are from the left, the others from below, five abreast at most.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common)

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from below."""
        across = self.people - self.people // 2
        most = block(across)
        beyond = BEYOND + (most - 1) * ABREAST / 2
        sides = zip((across, self.people // 2), HEADINGS[:2], strict=True)
        return [
            lane
            for side, (people, heading) in enumerate(sides)
            for lane in self.varied(side, abreast(people, heading, most, beyond))
        ]


class RoomExit(Encounter):
    """People leave a room by its only door, while others come in.

    *Exiting room* and *entering room*; with many people, the bottleneck of evacuation studies. The room is
    left of x = 0, a corridor along y right of it, and the door between them at the origin. People who leave
    turn left or right behind the door. People who enter come along the corridor, from above and from below
    in turn. Agents are numbered by their distance from the door. They have the time that a slow queue takes.
    """

    most = 1000
    more_would = "more queue at one door for over a quarter of an hour"

    def __init__(
        self,
        width: Numbers = (0.9, 1.2),
        corridor: Numbers = 2.4,
        entering: int = 1,
        common: EncounterSettings = EncounterSettings(people=4),
    ) -> None:
        """Set the scene.

        Args:
            width: Of the door, metres; or a list.
            corridor: Its width, metres; or a list.
            entering: How many of the people come in while the others leave.
            common: Of those who leave and those who enter.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, width=width, corridor=corridor)
        self.variants.check_lengths(CELL, "width", "corridor")
        people = self.people
        self.check(0 <= entering < people, f"entering {entering} of {people} people", f"0 to {people - 1}")
        self.entering, self.stray = entering, 0.5
        self.patience = people / (MIN_FLOW * min(self.variants.values["width"]))
        self._rays = RAYS[people > MANY]

    def gate(self, draws: Draws) -> Tensor:
        """Return the room's door, (B, 5)."""
        return door_at_origin(self.variants.value("width", draws))

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes of those who leave, which all end at the door, and of those who enter."""
        place = (THICKNESS + variant["corridor"]) / 2
        rays, between = self._rays
        people, lanes = self.people - self.entering, []
        count = min(rays, people)
        for number, mine in enumerate(shares(people, count)):
            angle = (number - (count - 1) / 2) * between
            heading = (math.cos(angle), math.sin(angle))
            ray = Lane(mine, heading, (0.0, 0.0), ((place, BEYOND), (place, -BEYOND)))
            lanes += self.varied(number, [ray], BESIDE_RAYS)
        inside = ((-BEYOND, 1.0), (-BEYOND, -1.0))
        for number, heading in enumerate(((0.0, -1.0), (0.0, 1.0))):
            mine = abreast((self.entering + 1 - number) // 2, heading, lanes_in(variant["corridor"]))
            for lane in self.varied(rays + number, mine, beside(mine, variant["corridor"])):
                x, y = lane.middle
                lanes.append(lane._replace(middle=(place + x, y), goals=inside))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the room, the corridor and the wall between them, symmetric about y = 0."""
        half, width = THICKNESS / 2, variant["width"]
        length = max(reach, BEYOND) + BEHIND
        deep = half + whole_cells(length)
        rays, between = self._rays
        widest = math.sin((min(rays, self.people) - 1) / 2 * between) * reach + self.aside
        high = width / 2 + whole_cells(max(widest, 2.0) + BEHIND)
        ends = high + whole_cells(max(0.0, length - high))
        walls = room((-deep, -ends), (half + variant["corridor"], ends), WALL)
        walls += wall((0.0, -ends), (0.0, ends), THICKNESS, doors=[(ends, width)])
        if ends > high:
            walls += [(-deep, high, -half, ends), (-deep, -ends, -half, -high)]
        return walls
