"""People on a circle change places with those opposite."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pedzoo.core.errors import UserError
from pedzoo.sim.scenario_parts.encounter import Encounter, EncounterSettings
from pedzoo.sim.scenario_parts.lanes import APART, Lane
from pedzoo.sim.scenario_parts.variants import Numbers, Variant

CHORD = 1.0
"""Metres between neighbours, at least."""

USUAL_RADII, LEAST_RADIUS = (3.0, 4.0, 5.0), 2.0
"""Metres."""


class Circle(Encounter):
    """People evenly around a circle without walls, who all want to go through its middle.

    *Circular crossing* of Francis et al. 2023 (Fig. 7): the antipodal swap of van den Berg et al.,
    "Reciprocal n-body collision avoidance" (2011). People come from outside and are about on the circle when
    the episode begins.
    """

    def __init__(
        self,
        radius: Numbers | None = None,
        common: EncounterSettings = EncounterSettings(people=4, aside=1.0),
    ) -> None:
        """Set the scene.

        Args:
            radius: Of the circle, metres; a list: one per scene; None: 3, 4 and 5, without those at which
                neighbours would be closer than 1 m, or the least at which they are not.
            common: People are late and start aside each on their own.

        Raises:
            UserError: A setting that gives no scene.
        """
        people = common.people
        # neighbours are a chord apart
        self.half_chord = math.sin(math.pi / max(people, 2))
        room = CHORD / (2 * self.half_chord)
        if radius is None:
            radius = [usual for usual in USUAL_RADII if usual >= room] or [room]
        for given in radius if isinstance(radius, Sequence) else [radius]:
            if not given >= max(room, LEAST_RADIUS):
                raise UserError(
                    f"circle: radius {given} for {people} people: expected at least "
                    f"{max(room, LEAST_RADIUS):.2f} m, which puts them {CHORD} m apart or more"
                )
        super().__init__(common, meet=0.0, radius=radius)

    @property
    def most_jitter(self) -> float:
        """Metres between people at the start with which none touch."""
        return min(1.0, max(0.0, self._room(min(self.variants.values["radius"]))))

    def _room(self, radius: float) -> float:
        """Return the metres beside each person on the circle that are theirs."""
        return radius * self.half_chord - APART / 2

    def lanes_on(self, variant: Variant) -> list[Lane]:
        """Return a lane for each person, from their place on the circle through its middle."""
        radius, lanes = variant["radius"], []
        for number in range(self.people):
            angle = 2 * math.pi * number / self.people
            x, y = math.cos(angle), math.sin(angle)
            lane = Lane(1, (-x, -y), (0.0, 0.0), ((-radius * x, -radius * y),), radius)
            lanes += self.varied(number, [lane], self._room(radius))
        return lanes
