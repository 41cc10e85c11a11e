"""People leave a room by its only door, while others come in."""

from __future__ import annotations

import math

from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Rectangle, room, wall
from pedzoo.sim.scenario_parts.encounter import BEHIND, CELL, WALL, Encounter, EncounterSettings, whole_cells
from pedzoo.sim.scenario_parts.lanes import BEYOND, Lane, abreast, beside, lanes_in
from pedzoo.sim.scenario_parts.scenario import door_at_origin
from pedzoo.sim.scenario_parts.variants import Numbers, Variant

THICKNESS = 0.1
"""Metres of the wall with the door."""

RAYS, MANY_RAYS = 5, 17
"""Directions from which people of the room come to the door, at most, and of more than `MANY` people."""

BETWEEN = math.radians(18)
"""Angle between two of them; half of it between two of `MANY_RAYS`."""

MANY = 150
"""People of the room from whom on more directions keep their lanes short."""

BESIDE_RAYS = 0.3
"""Metres on each side of a direction that belong to it."""


SLOWEST_FLOW = 1.0
"""People per second and metre of the door's width who get out in time: half as many as in real queues."""


class RoomExit(Encounter):
    """A room left of x = 0, a corridor along y right of it, and a door between them at the origin.

    *Exiting room* and *entering room* of Francis et al. 2023 (Fig. 7, Table 3); with many people, the
    bottleneck of evacuation studies. People who leave turn left or right behind the door. People who enter
    come along the corridor, from above and from below in turn. Agents are numbered by their distance from
    the door. They have the time that a slow queue takes.
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
            width: Of the door, metres, a multiple of 0.05; a list: one per scene.
            corridor: Its width, metres, a multiple of 0.05; a list: one per scene.
            entering: How many of the people come in while the others leave.
            common: Of those who leave and those who enter.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, width=width, corridor=corridor)
        self.variants.check_lengths(CELL, "width", "corridor")
        people = self.people
        if not 0 <= entering < people:
            raise UserError(f"room_exit: entering {entering} of {people} people: expected 0 to {people - 1}")
        self.entering, self.stray = entering, 0.5
        self.patience = people / (SLOWEST_FLOW * min(self.variants.values["width"]))

    def gate(self, draws: Draws) -> Tensor:
        """Return the room's door, (B, 5)."""
        return door_at_origin(self.variants.of("width", draws))

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes of those who leave and of those who enter."""
        return [*self._leaving(variant["corridor"]), *self._entering(variant["corridor"])]

    @property
    def _rays(self) -> tuple[int, float]:
        """How many directions there are at most, and the angle between two of them."""
        return (MANY_RAYS, BETWEEN / 2) if self.people > MANY else (RAYS, BETWEEN)

    def _leaving(self, corridor: float) -> list[Lane]:
        """Return lanes that all end at the door."""
        middle, people = (THICKNESS + corridor) / 2, self.people - self.entering
        lanes = []
        rays, between = self._rays
        count = min(rays, people)
        for number in range(count):
            angle = (number - (count - 1) / 2) * between
            heading = (math.cos(angle), math.sin(angle))
            mine = people // count + (number < people % count)
            ray = Lane(mine, heading, (0.0, 0.0), ((middle, BEYOND), (middle, -BEYOND)))
            lanes += self.varied(number, [ray], BESIDE_RAYS)
        return lanes

    def _entering(self, corridor: float) -> list[Lane]:
        """Return lanes along the corridor to the place before the door."""
        place = (THICKNESS + corridor) / 2
        inside = ((-BEYOND, 1.0), (-BEYOND, -1.0))
        lanes = []
        for number, heading in enumerate(((0.0, -1.0), (0.0, 1.0))):
            people = (self.entering + 1 - number) // 2
            mine = abreast(people, heading, lanes_in(corridor))
            for lane in self.varied(self._rays[0] + number, mine, beside(mine, corridor)):
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
