"""Fast people catch up with slow ones in a corridor."""

from __future__ import annotations

from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Rectangle, room
from pedzoo.sim.scenario_parts.encounter import BEHIND, CELL, WALL, Encounter, EncounterSettings, whole_cells
from pedzoo.sim.scenario_parts.lanes import SPACING, Lane, abreast, beside, lanes_in
from pedzoo.sim.scenario_parts.variants import Numbers, Variant

AHEAD = 8.0
"""Metres of the goals behind the place at which the slow are caught up with."""

SLOW, FAST = 0, 1
"""Numbers of the two sides."""


class Overtaking(Encounter):
    """A corridor along x, in which all walk to the right; the fast reach the slow at x = 0.

    *Pedestrian overtaking* of Francis et al. 2023 (Fig. 7, Table 3). Agents 0 to ``slow - 1`` are the slow
    ones where each person has a lane.
    """

    def __init__(
        self,
        width: Numbers = (1.8, 2.4, 3.0),
        speed_ratio: float = 1.6,
        slow: int | None = None,
        common: EncounterSettings = EncounterSettings(aside=0.35),
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres, a multiple of 0.05; a list: one per scene.
            speed_ratio: By how much each of the fast is faster than each of the slow, at least; above 1.2.
            slow: How many of the people are slow; None: half of them.
            common: Speeds and delays are those of the fast.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, meet=3.0, width=width)
        self.variants.check_lengths(CELL, "width")
        people = self.people
        slow = people // 2 if slow is None else slow
        if not 1 <= slow < people:
            raise UserError(f"overtaking: slow {slow} of {people} people: expected 1 to {people - 1}")
        if not speed_ratio >= 1.2:
            raise UserError(f"overtaking: speed_ratio {speed_ratio}: expected at least 1.2")
        self.slow, self.speed_ratio = slow, speed_ratio

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes of the slow and of the fast."""
        width = variant["width"]
        fit, queue = lanes_in(width), self._queue(variant)
        beyond, ahead = AHEAD + 2 * queue, (1.0, 0.0)
        slow = abreast(self.slow, ahead, fit, beyond, before=-queue)
        fast = abreast(self.people - self.slow, ahead, fit, beyond)
        slow = self.varied(SLOW, slow, beside(slow, width))
        return [*(lane._replace(delay=0.0) for lane in slow), *self.varied(FAST, fast, beside(fast, width))]

    def _queue(self, variant: Variant) -> float:
        """Return how far the last of the slow are behind the first, metres: they are at x = 0."""
        return (-(-self.slow // lanes_in(variant["width"])) - 1) * SPACING

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor."""
        beyond, y = AHEAD + 2 * self._queue(variant), variant["width"] / 2
        return room((-whole_cells(reach + BEHIND), -y), (whole_cells(beyond + BEHIND), y), WALL)

    def speeds(self, draws: Draws) -> Tensor:
        """Return the preferred speeds (B, A), m/s: the slow keep a distance from the slowest fast."""
        speed = super().speeds(draws)
        slow = self.places.of_scenes(self.variants.drawn(draws)).side == SLOW
        limit = speed.masked_fill(slow, float("inf")).amin(1, keepdim=True)
        return speed.where(~slow, speed.minimum(limit) / self.speed_ratio)
