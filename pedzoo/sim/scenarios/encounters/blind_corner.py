"""People meet behind a corner around which they cannot see."""

from __future__ import annotations

from pedzoo.maps.plans import Rectangle, room
from pedzoo.sim.scenario_parts.encounter import BEHIND, CELL, WALL, Encounter, EncounterSettings, whole_cells
from pedzoo.sim.scenario_parts.lanes import BEYOND, Lane, abreast, beside, lanes_in
from pedzoo.sim.scenario_parts.variants import Numbers, Variant


class BlindCorner(Encounter):
    """A corridor from the left that bends down at the origin; people come from both ends.

    *Blind corner* of Francis et al. 2023 (Fig. 7, Table 3). When the episode begins, no person sees those
    from the other end; the first ones are at the corner at the same time. The two groups mirror each other
    in the diagonal if size and speed are equal and ``jitter``, ``aside`` and ``delay`` are 0.
    """

    def __init__(
        self, width: Numbers = (1.2, 1.5, 2.0), common: EncounterSettings = EncounterSettings()
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres, a multiple of 0.05; a list: one per scene.
            common: Half of them from the left, the others from below.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, meet=3.0, width=width)
        self.variants.check_lengths(CELL, "width")

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from below."""
        width = variant["width"]
        fit, beyond = lanes_in(width), BEYOND + width / 2
        lanes = []
        for side, people in enumerate((self.people - self.people // 2, self.people // 2)):
            straight = abreast(people, (1.0, 0.0), fit)
            mine = self.varied(side, straight, beside(straight, width))
            # two people this far from the corner do not see each other
            unseen = width + max(lane.middle[1] + lane.aside for lane in mine) + self.jitter + 0.1
            before = max(0.0, unseen - self.meet * self.slowest)
            for lane in mine:
                # people at the outer wall before the corner are there behind it, too
                bent = lane._replace(before=before, goals=((lane.middle[1], -beyond),))
                lanes.append(_mirrored(bent) if side else bent)
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor: a square without all but its upper and its right side."""
        side = variant["width"] / 2
        far = whole_cells(max(reach, BEYOND + side) + BEHIND)
        return [*room((-far, -far), (side, side), WALL), (-far, -far, -side, -side)]


def _mirrored(lane: Lane) -> Lane:
    """Return a lane on the other side of the diagonal."""
    swapped = tuple((y, x) for x, y in lane.goals)
    return lane._replace(heading=lane.heading[::-1], middle=lane.middle[::-1], goals=swapped)
