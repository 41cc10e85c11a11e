"""People come towards each other in a corridor."""

from __future__ import annotations

from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import check_lengths, rectangles, room
from pedzoo.sim.encounter import BEHIND, BEYOND, CELL, WALL, Encounter, abreast, lanes_in, whole_cells


class Hallway(Encounter):
    """A corridor along x; some come from the left, some from the right, and meet at x = 0.

    *Frontal approach* of Francis et al. 2023 (Fig. 7, Table 3), and *narrow hallway* with a small width:
    two people pass each other from about 0.7 m on, comfortably from 1.5 m on. Without jitter two groups of
    the same size and speed are mirror images of each other in the origin.
    """

    def __init__(
        self,
        width: float = 2.0,
        offset: float = 0.0,
        people: int = 2,
        against: int | None = None,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres, a multiple of 0.05.
            offset: Metres that everybody keeps to the right of the corridor's middle; 0 is head-on.
            people: 2 to 50, side by side where the corridor has room, and one behind the other.
            against: How many of them come from the right; None: half of them.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter)
        check_lengths(self.name, CELL, width=width)
        against = people // 2 if against is None else against
        if not 1 <= against < people:
            raise UserError(f"hallway: against {against} of {people} people: expected 1 to {people - 1}")
        room_aside = width / 2 - 0.3
        if abs(offset) > max(0.0, room_aside):
            raise UserError(
                f"hallway: offset {offset} in a corridor of {width} m: expected at most {room_aside:.2f} m"
            )
        self.width = width
        fit = lanes_in(width - 2 * abs(offset))
        self.lanes = [
            *abreast(people - against, (1.0, 0.0), fit, right=offset),
            *abreast(against, (-1.0, 0.0), fit, right=offset),
        ]

    def plans(self) -> list[OccupancyGrid]:
        """Return the corridor."""
        x = whole_cells(max(self.reach, BEYOND) + BEHIND)
        walls = room((-x, -self.width / 2), (x, self.width / 2), WALL)
        return [rectangles(walls, CELL, name=self.name)]
