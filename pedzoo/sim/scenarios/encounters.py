"""The encounters of Francis et al. 2023 (Fig. 7, Table 3): every public class here is a scenario by its name.

Lengths of walls are multiples of 0.05 m. A setting with a list has one of its values in each scene.
"""

import math
from collections.abc import Sequence

from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, room, wall
from pedzoo.sim.scenarios._base import BEHIND, WALL, Numbers, Variant, whole_cells
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

OVERTAKING_BEYOND, PARALLEL_BEYOND = 8.0, 6.0
"""Metres of the goals behind where the slow are caught up with, or where streams are side by side."""

CHORD, RADII, MIN_RADIUS = 1.0, (3.0, 4.0, 5.0), 2.0
"""Metres between neighbours on a circle, at least; its radii by default, and the smallest one."""

RAYS, MANY_RAYS = (5, math.radians(18)), (17, math.radians(9))
"""Most directions from which people come to a room's door, and the angle between two; those of 151 people."""


class BlindCorner(Encounter):
    """People meet behind a corner around which they cannot see.

    *Blind corner*: a corridor from the left that bends down at the origin; people come from both ends. When
    the episode begins, no person sees those from the other end. The first ones are at the corner at the same
    time. Without variation groups of one size mirror each other in the diagonal.
    """

    def __init__(
        self, width: Numbers = (1.2, 1.5, 2.0), common: EncounterSettings = EncounterSettings()
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres; or a list.
            common: Half of them from the left, the others from below.
        """
        super().__init__(common, meet=3.0, width=width)

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from below."""
        width, lanes = variant["width"], []
        for side, people in enumerate(shares(self.people, 2)):
            straight = abreast(people, HEADINGS[0], lanes_in(width))
            mine = self.varied(side, straight, beside(straight, width))
            # two people this far from the corner do not see each other
            unseen = width + max(lane.middle[1] + lane.aside for lane in mine) + self.jitter + 0.1
            before = max(0.0, unseen - self.meet * self.slowest)
            for lane in mine:
                # people at the outer wall before the corner are there behind it, too
                goal = lane.middle[1], -(BEYOND + width / 2)
                if side:  # in the mirror of the diagonal
                    lane = lane._replace(heading=lane.heading[::-1], middle=lane.middle[::-1])
                lanes.append(lane._replace(before=before, goals=(goal[::-1] if side else goal,)))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor: a square without all but its upper and its right side."""
        side = variant["width"] / 2
        far = whole_cells(max(reach, BEYOND + side) + BEHIND)
        return [*room((-far, -far), (side, side), WALL), (-far, -far, -side, -side)]


class Circle(Encounter):
    """People on a circle change places with those opposite.

    *Circular crossing*: the antipodal swap of van den Berg et al., "Reciprocal n-body collision avoidance"
    (2011), without walls. People come from outside, and are about on the circle when the episode begins.
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
        """
        people = common.people
        self.half_chord = math.sin(math.pi / max(people, 2))  # between neighbours, for a radius of 1
        least = CHORD / (2 * self.half_chord)
        if radius is None:
            radius = [usual for usual in RADII if usual >= least] or [least]
        least = max(least, MIN_RADIUS)
        radii = radius if isinstance(radius, Sequence) else [radius]
        for given in radii:
            expected = f"at least {least:.2f} m, which puts them {CHORD} m apart or more"
            self.check(given >= least, f"radius {given} for {people} people", expected)
        self.max_jitter = min(1.0, max(0.0, min(radii, default=0.0) * self.half_chord - APART / 2))
        super().__init__(common, meet=0.0, radius=radius)

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return a lane for each person, from their place on the circle through its middle."""
        radius, lanes = variant["radius"], []
        for number in range(self.people):
            angle = 2 * math.pi * number / self.people
            x, y = math.cos(angle), math.sin(angle)
            lane = Lane(1, (-x, -y), (0.0, 0.0), ((-radius * x, -radius * y),), radius)
            lanes += self.varied(number, [lane], radius * self.half_chord - APART / 2)
        return lanes


class Hallway(Encounter):
    """People come towards each other in a corridor.

    *Frontal approach*: a corridor along x; some come from the left, some from the right, and meet at x = 0.
    *Narrow hallway* with a small width: two people pass each other from about 0.7 m on, comfortably from
    1.5 m on. Without variation groups of one size mirror each other in the origin.
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
        """
        super().__init__(common, width=width, offset=offset)
        people = self.people
        self.against, self.together = people // 2 if against is None else against, together
        self.check(
            1 <= self.against < people, f"against {self.against} of {people} people", f"1 to {people - 1}"
        )
        for variant in self.variants:
            most = variant["width"] / 2 - FREE
            given = f"offset {variant['offset']} in a corridor of {variant['width']} m"
            self.check(abs(variant["offset"]) <= max(0.0, most), given, f"at most {most:.2f} m")

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from the right."""
        width, offset, lanes = variant["width"], variant["offset"], []
        for side, people in enumerate((self.people - self.against, self.against)):
            mine = abreast(people, HEADINGS[2 * side], lanes_in(width - 2 * abs(offset)), right=offset)
            lanes += self.varied(side, mine, beside(mine, width))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor."""
        x, y = whole_cells(max(reach, BEYOND) + BEHIND), variant["width"] / 2
        return room((-x, -y), (x, y), WALL)


class Intersection(Encounter):
    """People cross where two corridors do.

    *Intersection*, without gestures: two corridors of the same width that cross at the origin. Those in front
    are in the middle at the same time.
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
        """
        super().__init__(common, width=width)
        self.check(0 <= turn <= 1, f"turn {turn}", "a share from 0 to 1")
        self.check(2 <= arms <= 4, f"arms {arms}", "2 to 4")
        self.arms, self.stray = arms, turn

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the arms."""
        width, lanes = variant["width"], []
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
        arms = ((-ends, -side), (side, ends))
        corners = [(x0, y0, x1, y1) for x0, x1 in arms for y0, y1 in arms]
        return [*room((-ends, -ends), (ends, ends), WALL), *corners]


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
        """
        super().__init__(common, meet=3.0, width=width)
        people = self.people
        self.slow, self.speed_ratio = people // 2 if slow is None else slow, speed_ratio
        self.check(1 <= self.slow < people, f"slow {self.slow} of {people} people", f"1 to {people - 1}")
        self.check(speed_ratio >= 1.2, f"speed_ratio {speed_ratio}", "at least 1.2")

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes of the slow, side 0, and of the fast."""
        width, queue = variant["width"], self._queue(variant)
        fit, beyond, lanes = lanes_in(width), OVERTAKING_BEYOND + 2 * queue, []
        for side, people in enumerate((self.slow, self.people - self.slow)):
            mine = abreast(people, HEADINGS[0], fit, beyond, before=0.0 if side else -queue)
            mine = self.varied(side, mine, beside(mine, width))
            lanes += mine if side else [lane._replace(delay=0.0) for lane in mine]
        return lanes

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
        slow = self.seats.of_scenes(self.variants.draw(draws)).side == 0
        limit = speed.masked_fill(slow, float("inf")).amin(1, keepdim=True)
        return speed.where(~slow, speed.minimum(limit) / self.speed_ratio)


class Parallel(Encounter):
    """Two streams of people side by side in an open space.

    *Parallel traffic*: streams along x without walls, one left of the other. Some people change over into a
    lane of the other stream on their way. ``opposite=true`` is bidirectional flow, all people on the right.
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
        """
        super().__init__(common, gap=gap)
        self.check(0 <= change <= 1, f"change {change}", "a share from 0 to 1")
        for least in self.variants.values["gap"]:
            self.check(least >= ABREAST, f"gap {least}", f"at least {ABREAST} m, as between lanes")
        self.opposite, self.stray = opposite, change

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return the lanes of both streams; people may have goals in the other one, too."""
        right, left = shares(self.people, 2)
        most = block(right)
        aside, beside = (variant["gap"] + (most - 1) * ABREAST) / 2, (variant["gap"] - APART) / 2
        heading, keeps = (HEADINGS[2], aside) if self.opposite else (HEADINGS[0], -aside)
        first = self.varied(0, abreast(right, HEADINGS[0], most, PARALLEL_BEYOND, aside), beside)
        second = self.varied(1, abreast(left, heading, most, PARALLEL_BEYOND, keeps), beside)
        pairs = [(lane, second) for lane in first] + [(lane, first) for lane in second]
        return [
            lane._replace(goals=(*lane.goals, *((lane.goals[0][0], one.middle[1]) for one in others)))
            for lane, others in pairs
        ]


class Perpendicular(Encounter):
    """Two streams of people that cross at right angles in an open space.

    *Perpendicular traffic*: streams along x and along y without walls; the first meet at the crossing.
    """

    def __init__(self, common: EncounterSettings = EncounterSettings(people=6, aside=1.0)) -> None:
        """Set the scene.

        Args:
            common: Half of the people are from the left, the others from below, five abreast at most.
        """
        super().__init__(common)

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from below."""
        streams, lanes = shares(self.people, 2), []
        most = block(streams[0])
        for side, people in enumerate(streams):
            mine = abreast(people, HEADINGS[side], most, BEYOND + (most - 1) * ABREAST / 2)
            lanes += self.varied(side, mine)
        return lanes


class RoomExit(Encounter):
    """People leave a room by its only door, while others come in.

    *Exiting room* and *entering room*; with many people, the bottleneck of evacuation studies. The room is
    left of x = 0, a corridor along y right of it, and the door between them at the origin. People who leave
    turn left or right there, people who enter come along the corridor from both sides. Agents are numbered by
    their distance from the door, and have the time that a slow queue takes.
    """

    door = "width"
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
        """
        super().__init__(common, width=width, corridor=corridor)
        people = self.people
        self.check(0 <= entering < people, f"entering {entering} of {people} people", f"0 to {people - 1}")
        self.entering, self.stray = entering, 0.5
        # 1 person per second and metre of the door gets out in time: half as many as in real queues
        self.patience = people / min(self.variants.values["width"])
        self._rays = MANY_RAYS if people > 150 else RAYS  # which keep their lanes short

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes of those who leave, which all end at the door, and of those who enter."""
        place, (rays, between), lanes = (WALL + variant["corridor"]) / 2, self._rays, []
        people = self.people - self.entering
        count = min(rays, people)
        for number, mine in enumerate(shares(people, count)):
            angle = (number - (count - 1) / 2) * between
            heading = (math.cos(angle), math.sin(angle))
            ray = Lane(mine, heading, (0.0, 0.0), ((place, BEYOND), (place, -BEYOND)))
            lanes += self.varied(number, [ray], 0.3)
        for number, (heading, mine) in enumerate(zip(HEADINGS[3::-2], shares(self.entering, 2), strict=True)):
            straight = abreast(mine, heading, lanes_in(variant["corridor"]))
            for lane in self.varied(rays + number, straight, beside(straight, variant["corridor"])):
                x, y = lane.middle
                lanes.append(lane._replace(middle=(place + x, y), goals=((-BEYOND, 1.0), (-BEYOND, -1.0))))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the room, the corridor and the wall between them, symmetric about y = 0."""
        half, width, (rays, between) = WALL / 2, variant["width"], self._rays
        length = max(reach, BEYOND) + BEHIND
        deep = half + whole_cells(length)
        widest = math.sin((min(rays, self.people) - 1) / 2 * between) * reach + self.aside
        high = width / 2 + whole_cells(max(widest, 2.0) + BEHIND)
        ends = high + whole_cells(max(0.0, length - high))
        walls = room((-deep, -ends), (half + variant["corridor"], ends), WALL)
        walls += wall((0.0, -ends), (0.0, ends), WALL, doors=[(ends, width)])
        if ends > high:
            walls += [(-deep, high, -half, ends), (-deep, -ends, -half, -high)]
        return walls
