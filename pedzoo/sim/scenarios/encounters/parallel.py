"""Two streams of people side by side in an open space."""

from __future__ import annotations

from pedzoo.core.errors import UserError
from pedzoo.sim.scenario_parts.encounter import Encounter, EncounterSettings
from pedzoo.sim.scenario_parts.lanes import ABREAST, APART, Lane, abreast, block
from pedzoo.sim.scenario_parts.variants import Numbers, Variant

BEYOND = 6.0
"""Metres of the goals behind the line on which those in front are at the same time."""


class Parallel(Encounter):
    """Streams along x without walls, one left of the other, in the same direction or in opposite ones.

    *Parallel traffic* of Francis et al. 2023 (Fig. 7, Table 3). Some people change over into a lane of the
    other stream on their way; with ``opposite=true`` it is bidirectional flow, all people on the right.
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
            gap: Metres between the nearest lanes of the two streams; a list: one per scene.
            change: Share of people with a goal in a lane of the other stream, in their own direction.
            common: Half of the people are in each stream, five abreast at most.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, gap=gap)
        self.check_share("change", change)
        for least in self.variants.values["gap"]:
            if not least >= ABREAST:
                raise UserError(f"parallel: gap {least}: expected at least {ABREAST} m, as between lanes")
        self.opposite, self.stray = opposite, change

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return the lanes of both streams."""
        right = self.people - self.people // 2
        most = block(right)
        aside = (variant["gap"] + (most - 1) * ABREAST) / 2
        room = (variant["gap"] - APART) / 2
        first = self.varied(0, abreast(right, (1.0, 0.0), most, BEYOND, right=aside), room)
        heading, keeps = ((-1.0, 0.0), aside) if self.opposite else ((1.0, 0.0), -aside)
        second = self.varied(1, abreast(self.people // 2, heading, most, BEYOND, right=keeps), room)
        return [_changing(lane, second) for lane in first] + [_changing(lane, first) for lane in second]


def _changing(lane: Lane, others: list[Lane]) -> Lane:
    """Return a lane whose people may also have goals in the other stream."""
    x = lane.goals[0][0]
    return lane._replace(goals=(*lane.goals, *((x, other.middle[1]) for other in others)))
