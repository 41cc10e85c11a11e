"""Two streams of people side by side in an open space."""

from __future__ import annotations

from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.encounter import ABREAST, Encounter, Lane, abreast, block

BEYOND = 6.0
"""Metres of the goals behind the line on which those in front are at the same time."""


class Parallel(Encounter):
    """Streams along x without walls, one left of the other, in the same direction or in opposite ones.

    *Parallel traffic* of Francis et al. 2023 (Fig. 7, Table 3). Some people change over into a lane of the
    other stream on their way; with ``opposite=true`` it is bidirectional flow, everybody on the right.
    """

    def __init__(
        self,
        opposite: bool = False,
        gap: float = 0.8,
        change: float = 0.3,
        people: int = 6,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            opposite: The second stream walks the other way.
            gap: Metres between the nearest lanes of the two streams.
            change: Share of people whose goal is in a lane of the other stream's, in their own direction.
            people: 2 to 50, half of them in each stream, five abreast at most.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter)
        self.check_share("change", change)
        if not gap >= ABREAST:
            raise UserError(f"parallel: gap {gap}: expected at least {ABREAST} m, as between lanes")
        self.stray = change
        right = people - people // 2
        most = block(right)
        aside = (gap + (most - 1) * ABREAST) / 2
        first = abreast(right, (1.0, 0.0), most, BEYOND, right=aside)
        heading, side = ((-1.0, 0.0), aside) if opposite else ((1.0, 0.0), -aside)
        second = abreast(people // 2, heading, most, BEYOND, right=side)
        self.lanes = [_changing(lane, second) for lane in first] + [_changing(lane, first) for lane in second]

    def plans(self) -> list[OccupancyGrid]:
        """Return none: there are no walls."""
        return []


def _changing(lane: Lane, others: list[Lane]) -> Lane:
    """Return a lane whose people may also go to where the other stream walks."""
    x = lane.goals[0][0]
    return lane._replace(goals=(*lane.goals, *((x, other.middle[1]) for other in others)))
