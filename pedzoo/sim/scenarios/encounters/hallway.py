"""People come towards each other in a corridor."""

from __future__ import annotations

from pedzoo.core.errors import UserError
from pedzoo.maps.plans import Rectangle, room
from pedzoo.sim.scenario_parts.encounter import BEHIND, CELL, WALL, Encounter, EncounterSettings, whole_cells
from pedzoo.sim.scenario_parts.lanes import BEYOND, FREE, Lane, abreast, beside, lanes_in
from pedzoo.sim.scenario_parts.variants import Numbers, Variant


class Hallway(Encounter):
    """A corridor along x; some come from the left, some from the right, and meet at x = 0.

    *Frontal approach* of Francis et al. 2023 (Fig. 7, Table 3), and *narrow hallway* with a small width:
    two people pass each other from about 0.7 m on, comfortably from 1.5 m on. Two groups of the
    same size and speed are mirror images of each other in the origin where ``jitter``, ``aside`` and
    ``delay`` are 0.
    """

    def __init__(
        self,
        width: Numbers = (1.5, 2.0, 3.0),
        offset: Numbers = 0.0,
        against: int | None = None,
        common: EncounterSettings = EncounterSettings(aside=0.8, delay=1.0),
        together: bool = False,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres, a multiple of 0.05; a list: one per scene.
            offset: Metres that people keep to the right of the corridor's middle; 0 is head-on; a list: one
                per scene.
            against: How many of the people come from the right; None: half of them.
            common: People are side by side where the corridor has room, and one behind the other.
            together: People side by side walk together: equally fast, and equally late.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(common, width=width, offset=offset)
        self.variants.check_lengths(CELL, "width")
        people = self.people
        against = people // 2 if against is None else against
        if not 1 <= against < people:
            raise UserError(f"hallway: against {against} of {people} people: expected 1 to {people - 1}")
        self.against, self.together = against, together
        for variant in self.variants:
            most = variant["width"] / 2 - FREE
            if abs(variant["offset"]) > max(0.0, most):
                raise UserError(
                    f"hallway: offset {variant['offset']} in a corridor of {variant['width']} m: "
                    f"expected at most {most:.2f} m"
                )

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return lanes from the left and from the right."""
        width, offset = variant["width"], variant["offset"]
        fit = lanes_in(width - 2 * abs(offset))
        lanes = []
        for side, people in enumerate((self.people - self.against, self.against)):
            mine = abreast(people, (1.0 - 2 * side, 0.0), fit, right=offset)
            lanes += self.varied(side, mine, beside(mine, width))
        return lanes

    def walls_on(self, variant: Variant, reach: float) -> list[Rectangle]:
        """Return the corridor."""
        x, y = whole_cells(max(reach, BEYOND) + BEHIND), variant["width"] / 2
        return room((-x, -y), (x, y), WALL)
