"""People meet behind a corner around which they cannot see."""

from __future__ import annotations

from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import check_lengths, rectangles, room
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


class BlindCorner(Encounter):
    """A corridor from the left that bends down at the origin; people come from both ends.

    *Blind corner* of Francis et al. 2023 (Fig. 7, Table 3). Nobody sees those from the other end when the
    episode begins, and the first ones are at the corner at the same time. The two groups are mirror images
    of each other in the diagonal where they are of the same size and speed and have no jitter.
    """

    most = 20

    def __init__(
        self,
        width: float = 1.5,
        people: int = 2,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres, a multiple of 0.05.
            people: 2 to 20, half of them from the left, the others from below.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter, meet=3.0)
        check_lengths(self.name, CELL, width=width)
        self.width = width
        fit, beyond = lanes_in(width), BEYOND + width / 2
        right = [lane.middle[1] for lane in abreast(people - people // 2, (1.0, 0.0), fit)]
        # two who are so far from the corner have the inner corner between them
        unseen = width + max(right) + jitter + 0.1
        before = max(0.0, unseen - self.meet * self.slowest)
        across = abreast(people - people // 2, (1.0, 0.0), fit, before=before)
        down = abreast(people // 2, (1.0, 0.0), fit, before=before)
        # whoever keeps to the outer wall before the corner does so behind it
        self.lanes = [lane._replace(goals=((lane.middle[1], -beyond),)) for lane in across]
        self.lanes += [_mirrored(lane._replace(goals=((lane.middle[1], -beyond),))) for lane in down]

    def plans(self) -> list[OccupancyGrid]:
        """Return the corridor: a square without all but its upper and its right side."""
        far = whole_cells(max(self.reach, BEYOND + self.width / 2) + BEHIND)
        side = self.width / 2
        walls = [*room((-far, -far), (side, side), WALL), (-far, -far, -side, -side)]
        return [rectangles(walls, CELL, name=self.name)]


def _mirrored(lane: Lane) -> Lane:
    """Return a lane on the other side of the diagonal."""
    swapped = tuple((y, x) for x, y in lane.goals)
    return lane._replace(heading=lane.heading[::-1], middle=lane.middle[::-1], goals=swapped)
