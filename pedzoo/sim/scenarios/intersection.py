"""People cross where two corridors do."""

from __future__ import annotations

from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import Point, check_lengths, rectangles, room
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

HEADINGS: tuple[Point, ...] = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
"""Of those from the left, from below, from the right and from above."""


class Intersection(Encounter):
    """Two corridors of the same width that cross at the origin; people come from their arms in turn.

    *Intersection* of Francis et al. 2023 (Fig. 7, Table 3), without gestures: nobody waves anybody on. Those
    in front are in the middle at the same time.
    """

    def __init__(
        self,
        width: float = 2.0,
        arms: int = 4,
        turn: float = 0.0,
        people: int = 2,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            width: Of both corridors, metres, a multiple of 0.05.
            arms: From how many arms people come, 2 (from the left and from below) to 4.
            turn: Share of people who turn left or right there; all others go straight on.
            people: 2 to 50, shared out evenly over the arms.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter)
        check_lengths(self.name, CELL, width=width)
        self.check_share("turn", turn)
        if not 2 <= arms <= 4:
            raise UserError(f"intersection: arms {arms}: expected 2 to 4")
        self.width, self.stray = width, turn
        self.lanes = []
        for arm in range(min(arms, people)):
            mine = people // arms + (arm < people % arms)
            straight = abreast(mine, HEADINGS[arm], lanes_in(width), self._beyond)
            self.lanes += [_turning(lane) for lane in straight] if turn else straight

    @property
    def _beyond(self) -> float:
        return BEYOND + self.width / 2

    def plans(self) -> list[OccupancyGrid]:
        """Return the corridors: a square without its four corners."""
        far = whole_cells(max(self.reach, self._beyond) + BEHIND)
        side, ends = self.width / 2, far + self.width / 2
        walls = room((-ends, -ends), (ends, ends), WALL)
        for x0, x1 in ((-ends, -side), (side, ends)):
            walls += [(x0, y0, x1, y1) for y0, y1 in ((-ends, -side), (side, ends))]
        return [rectangles(walls, CELL, name=self.name)]


def _turning(lane: Lane) -> Lane:
    """Return a lane from which goals in the arms to the left and to the right can be reached, too."""
    ((x, y),) = lane.goals
    return lane._replace(goals=((x, y), (-y, x), (y, -x)))
