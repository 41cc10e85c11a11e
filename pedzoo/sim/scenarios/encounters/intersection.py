"""People cross where two corridors do."""

from __future__ import annotations

from pedzoo.core.errors import UserError
from pedzoo.maps.plans import Point, Rectangle, room
from pedzoo.sim.scenario_parts.encounter import BEHIND, CELL, WALL, Encounter, EncounterSettings, whole_cells
from pedzoo.sim.scenario_parts.lanes import BEYOND, Lane, abreast, beside, lanes_in
from pedzoo.sim.scenario_parts.variants import Numbers, Variant

HEADINGS: tuple[Point, ...] = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
"""Of those from the left, from below, from the right and from above."""


class Intersection(Encounter):
    """Two corridors of the same width that cross at the origin; people come from their arms in turn.

    *Intersection* of Francis et al. 2023 (Fig. 7, Table 3), without gestures: no waving on. Those
    in front are in the middle at the same time.
    """

    def __init__(
        self,
        width: Numbers = (1.5, 2.5),
        arms: int = 4,
        turn: float = 0.0,
        common: EncounterSettings = EncounterSettings(),
    ) -> None:
        """Set the scene.

        Args:
            width: Of both corridors, metres, a multiple of 0.05; a list: one per scene.
            arms: From how many arms people come, 2 (from the left and from below) to 4.
            turn: Share of people who turn left or right there; all others go straight on.
            common: People are shared out evenly over the arms.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, width=width)
        self.variants.check_lengths(CELL, "width")
        self.check_share("turn", turn)
        if not 2 <= arms <= 4:
            raise UserError(f"intersection: arms {arms}: expected 2 to 4")
        self.arms, self.stray = arms, turn

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the arms."""
        width = variant["width"]
        lanes = []
        for arm in range(min(self.arms, self.people)):
            people = self.people // self.arms + (arm < self.people % self.arms)
            straight = abreast(people, HEADINGS[arm], lanes_in(width), BEYOND + width / 2)
            mine = self.varied(arm, straight, beside(straight, width))
            lanes += [_turning(lane) for lane in mine] if self.stray else mine
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridors: a square without its four corners."""
        side = variant["width"] / 2
        ends = whole_cells(max(reach, BEYOND + side) + BEHIND) + side
        walls = room((-ends, -ends), (ends, ends), WALL)
        for x0, x1 in ((-ends, -side), (side, ends)):
            walls += [(x0, y0, x1, y1) for y0, y1 in ((-ends, -side), (side, ends))]
        return walls


def _turning(lane: Lane) -> Lane:
    """Return a lane from which goals in the arms to the left and to the right can be reached, too."""
    ((x, y),) = lane.goals
    return lane._replace(goals=((x, y), (-y, x), (y, -x)))
