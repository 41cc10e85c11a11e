"""People leave a room by its only door, while others come in."""

from __future__ import annotations

import math

from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import check_lengths, rectangles, room, wall
from pedzoo.sim.encounter import (
    BEHIND,
    BEYOND,
    CELL,
    WALL,
    Encounter,
    Lane,
    abreast,
    lanes_in,
    whole_cells,
)

THICKNESS = 0.1
"""Metres of the wall with the door."""

RAYS = 5
"""Directions from which people of the room come to the door, at most."""

BETWEEN = math.radians(18)
"""Angle between two of them."""


class RoomExit(Encounter):
    """A room left of x = 0, a corridor along y right of it, and a door between them at the origin.

    *Exiting room* and *entering room* of Francis et al. 2023 (Fig. 7, Table 3); with many people it is the
    bottleneck of evacuation studies. Who leaves turns left or right behind the door. Who enters comes along
    the corridor, from above and from below in turn. Agents are numbered by how far they are from the door.
    """

    def __init__(
        self,
        width: float = 0.9,
        corridor: float = 2.4,
        people: int = 4,
        entering: int = 1,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the door, metres, a multiple of 0.05.
            corridor: Its width, metres, a multiple of 0.05.
            people: 2 to 50.
            entering: How many of them come in while the others leave.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter)
        check_lengths(self.name, CELL, width=width, corridor=corridor)
        if not 0 <= entering < people:
            raise UserError(f"room_exit: entering {entering} of {people} people: expected 0 to {people - 1}")
        self.width, self.corridor, self.stray = width, corridor, 0.5
        self.lanes = [*self._leaving(people - entering), *self._entering(entering)]

    def _leaving(self, people: int) -> list[Lane]:
        """Return lanes that all end at the door."""
        middle = (THICKNESS + self.corridor) / 2
        lanes = []
        count = min(RAYS, people)
        for number in range(count):
            angle = (number - (count - 1) / 2) * BETWEEN
            heading = (math.cos(angle), math.sin(angle))
            mine = people // count + (number < people % count)
            lanes.append(Lane(mine, heading, (0.0, 0.0), ((middle, BEYOND), (middle, -BEYOND))))
        return lanes

    def _entering(self, people: int) -> list[Lane]:
        """Return lanes along the corridor to the place before the door."""
        place = (THICKNESS + self.corridor) / 2
        inside = ((-BEYOND, 1.0), (-BEYOND, -1.0))
        lanes = []
        for number, heading in enumerate(((0.0, -1.0), (0.0, 1.0))):
            mine = (people + 1 - number) // 2
            for lane in abreast(mine, heading, lanes_in(self.corridor)):
                x, y = lane.middle
                lanes.append(lane._replace(middle=(place + x, y), goals=inside))
        return lanes

    def plans(self) -> list[OccupancyGrid]:
        """Return the room, the corridor and the wall between them, symmetric about y = 0."""
        half = THICKNESS / 2
        deep = half + whole_cells(max(self.reach, BEYOND) + BEHIND)
        widest = math.sin((min(RAYS, self.people) - 1) / 2 * BETWEEN) * self.reach
        high = self.width / 2 + whole_cells(max(widest, 2.0) + BEHIND)
        ends = high + whole_cells(max(0.0, max(self.reach, BEYOND) + BEHIND - high))
        right = half + self.corridor
        walls = room((-deep, -ends), (right, ends), WALL)
        walls += wall((0.0, -ends), (0.0, ends), THICKNESS, doors=[(ends, self.width)])
        if ends > high:
            walls += [(-deep, high, -half, ends), (-deep, -ends, -half, -high)]
        return [rectangles(walls, CELL, name=self.name)]
