"""Fast people catch up with slow ones in a corridor."""

from __future__ import annotations

from torch import Tensor

from pedzoo.draws import Draws
from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import check_lengths, rectangles, room
from pedzoo.sim.encounter import BEHIND, CELL, SPACING, WALL, Encounter, abreast, lanes_in, whole_cells

AHEAD = 8.0
"""Metres of the goals behind the place at which the slow are caught up with."""


class Overtaking(Encounter):
    """A corridor along x, in which all walk to the right; the fast reach the slow at x = 0.

    *Pedestrian overtaking* of Francis et al. 2023 (Fig. 7, Table 3). Agents 0 to ``slow - 1`` are the slow
    ones where everybody has a lane.
    """

    most = 20

    def __init__(
        self,
        width: float = 2.4,
        speed_ratio: float = 1.6,
        people: int = 2,
        slow: int | None = None,
        speed: float = 1.3,
        speed_std: float = 0.2,
        jitter: float = 0.1,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the corridor, metres, a multiple of 0.05.
            speed_ratio: By how much each of the fast is faster than each of the slow, at least; above 1.2.
            people: 2 to 20.
            slow: How many of them are slow; None: half of them.
            speed: Mean preferred speed of the fast, m/s.
            speed_std: Its standard deviation.
            jitter: Metres that starts are off their places at most, along and across.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std, jitter, meet=3.0)
        check_lengths(self.name, CELL, width=width)
        slow = people // 2 if slow is None else slow
        if not 1 <= slow < people:
            raise UserError(f"overtaking: slow {slow} of {people} people: expected 1 to {people - 1}")
        if not speed_ratio >= 1.2:
            raise UserError(f"overtaking: speed_ratio {speed_ratio}: expected at least 1.2")
        self.width, self.speed_ratio = width, speed_ratio
        fit = lanes_in(width)
        # the last of the slow are at x = 0 when the first of the fast are
        queue = (-(-slow // fit) - 1) * SPACING
        self.ahead = AHEAD + 2 * queue
        self._slow_lanes = min(fit, slow)
        self.lanes = [
            *abreast(slow, (1.0, 0.0), fit, self.ahead, before=-queue),
            *abreast(people - slow, (1.0, 0.0), fit, self.ahead),
        ]

    def plans(self) -> list[OccupancyGrid]:
        """Return the corridor."""
        left, right = whole_cells(self.reach + BEHIND), whole_cells(self.ahead + BEHIND)
        walls = room((-left, -self.width / 2), (right, self.width / 2), WALL)
        return [rectangles(walls, CELL, name=self.name)]

    def speeds(self, draws: Draws) -> Tensor:
        """Return everybody's preferred speed (B, A), m/s: the slow keep a distance from the slowest fast."""
        speed = super().speeds(draws)
        slow = self.lane.to(speed.device) < self._slow_lanes
        limit = speed.masked_fill(slow, float("inf")).amin(1, keepdim=True)
        return speed.where(~slow, speed.minimum(limit) / self.speed_ratio)
