"""Two streams of people that cross at right angles in an open space."""

from __future__ import annotations

from pedzoo.sim.scenario_parts.encounter import Encounter, EncounterSettings
from pedzoo.sim.scenario_parts.lanes import ABREAST, BEYOND, Lane, abreast, block
from pedzoo.sim.scenario_parts.variants import Variant


class Perpendicular(Encounter):
    """Streams along x and along y without walls; those in front are at the crossing at the same time.

    *Perpendicular traffic* of Francis et al. 2023 (Fig. 7, Table 3).
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
        most = block(self.people - self.people // 2)
        beyond = BEYOND + (most - 1) * ABREAST / 2
        across = abreast(self.people - self.people // 2, (1.0, 0.0), most, beyond)
        up = abreast(self.people // 2, (0.0, 1.0), most, beyond)
        return [*self.varied(0, across), *self.varied(1, up)]
