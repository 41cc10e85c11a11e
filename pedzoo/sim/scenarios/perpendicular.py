"""Two streams of people that cross at right angles in an open space."""

from __future__ import annotations

from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.encounter import ABREAST, BEYOND, Encounter, abreast, block


class Perpendicular(Encounter):
    """Streams along x and along y without walls; those in front are at the crossing at the same time.

    *Perpendicular traffic* of Francis et al. 2023 (Fig. 7, Table 3).
    """

    def __init__(
        self,
        people: int = 6,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            people: 2 to 50, half of them from the left, the others from below, five abreast at most.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter)
        most = block(people - people // 2)
        beyond = BEYOND + (most - 1) * ABREAST / 2
        self.lanes = [
            *abreast(people - people // 2, (1.0, 0.0), most, beyond),
            *abreast(people // 2, (0.0, 1.0), most, beyond),
        ]

    def plans(self) -> list[OccupancyGrid]:
        """Return none: there are no walls."""
        return []
