"""Two streams of people that cross at right angles in an open space."""

from __future__ import annotations

from pedzoo.sim.scenario_parts.encounter import Encounter
from pedzoo.sim.scenario_parts.lanes import ABREAST, BEYOND, Lane, abreast, block
from pedzoo.sim.scenario_parts.variants import Variant


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
        aside: float = 1.0,
        delay: float = 0.5,
    ) -> None:
        """Set the scene.

        Args:
            people: 2 to 50, half of them from the left, the others from below, five abreast at most.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.
            aside: Metres that all from one side start to the left or right of their lanes at most, less where
                walls are near; their goals stay.
            delay: Seconds that the first of each lane comes late at most.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter, aside, delay)

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from below."""
        most = block(self.people - self.people // 2)
        beyond = BEYOND + (most - 1) * ABREAST / 2
        across = abreast(self.people - self.people // 2, (1.0, 0.0), most, beyond)
        up = abreast(self.people // 2, (0.0, 1.0), most, beyond)
        return [*self.varied(0, across), *self.varied(1, up)]
