"""People on a circle change places with whoever stands opposite."""

from __future__ import annotations

import math

from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.encounter import Encounter, Lane

CHORD = 1.0
"""Metres between neighbours, at least."""

USUAL_RADIUS, LEAST_RADIUS = 4.0, 2.0
"""Metres."""


class Circle(Encounter):
    """People evenly around a circle without walls, who all want to go through its middle.

    *Circular crossing* of Francis et al. 2023 (Fig. 7), the antipodal swap by which collision avoidance is
    tested since van den Berg et al., "Reciprocal n-body collision avoidance" (2011). People come from outside
    and are about on the circle when the episode begins.
    """

    def __init__(
        self,
        radius: float | None = None,
        people: int = 4,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            radius: Of the circle, metres; None: 4, or more where neighbours would be closer than 1 m.
            people: 2 to 50.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, in x and in y.

        Raises:
            UserError: A setting that gives no scene.
        """
        # neighbours are a chord apart
        half_chord = math.sin(math.pi / max(people, 2))
        room = CHORD / (2 * half_chord)
        if radius is not None and not radius >= max(room, LEAST_RADIUS):
            raise UserError(
                f"circle: radius {radius} for {people} people: expected at least "
                f"{max(room, LEAST_RADIUS):.2f} m, which puts them {CHORD} m apart or more"
            )
        self.radius = max(room, USUAL_RADIUS) if radius is None else radius
        most_jitter = min(1.0, self.radius * half_chord - 0.25)
        super().__init__(people, speed, speed_std, jitter, meet=0.0, most_jitter=most_jitter)
        self.lanes = []
        for number in range(people):
            angle = 2 * math.pi * number / people
            x, y = math.cos(angle), math.sin(angle)
            goal = (-self.radius * x, -self.radius * y)
            self.lanes.append(Lane(1, (-x, -y), (0.0, 0.0), (goal,), self.radius))

    def plans(self) -> list[OccupancyGrid]:
        """Return none: there are no walls."""
        return []
