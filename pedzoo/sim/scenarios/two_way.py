"""Two streams meet in a corridor, as in experiments on bidirectional flow."""

import math

import torch

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, check_lengths, room
from pedzoo.sim.scenario import WARM_SECONDS, Layout, PreparedScenario
from pedzoo.sim.scenarios._base import BEHIND, CELL, WALL, Variant, Variants, Varied, whole_cells
from pedzoo.sim.scenarios._lanes import APART, FREE

FRONT, LANES = 0.5, 8
"""Metres from the middle to the first of a stream when the episode begins; goals at each end."""


class TwoWay(Varied):
    """Half of the people come from each end of a corridor along x, in no order; they meet in its middle.

    Both streams together have the given density where they are in the same place. Goals are behind the
    other stream, straight ahead: people need not change sides. Agents of even numbers come from the left.
    """

    def __init__(
        self,
        people: int = 40,
        width: float = 3.6,
        density: float = 0.9,
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: In both streams; with the width and the density they say how long these are.
            width: Of the corridor, metres, a multiple of 0.05.
            density: People per square metre where the streams are in the same place.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        check_lengths(self.name, CELL, width=width)
        self.check(people >= 2, f"people {people}", "at least 2")
        self.check(0 < density <= 2, f"density {density}", "people per square metre, up to 2")
        self.width, self.variants = width, Variants(self.name)
        # every person of a stream has a cell, as wide as possible
        self.columns = max(1, math.ceil(APART * density * width / 2))
        self.across = width / self.columns
        self.along = 2 / (density * self.across)
        cell = f"{self.across:.2f} m by {self.along:.2f} m for each person"
        self.check(self.across >= APART, cell, f"at least {APART} m: a lower density")
        self.length = self.along * -(-((people + 1) // 2) // self.columns)
        self.end = FRONT + self.length + WARM_SECONDS * speed

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the corridor's."""
        x = whole_cells(self.end + BEHIND)
        return room((-x, -self.width / 2), (x, self.width / 2), WALL)

    def places(self, variant: Variant) -> list[Point]:
        """Return the goals at the right end, and those at the left end."""
        step = (self.width - 2 * FREE) / LANES
        across = [step * (lane + 0.5) - LANES * step / 2 for lane in range(LANES)]
        return [(x, y) for x in (self.end, -self.end) for y in across]

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return both streams, each person somewhere in a cell, at least 0.5 m from others of the stream."""
        speed, (map_id, goals) = self.speeds(draws), self.drawn(prepared, draws)
        slot = torch.arange(self.people, device=speed.device)
        number, side = slot // 2, slot % 2
        row, column = number // self.columns, number % self.columns
        along, across = (draws.uniform(name, self.people) - 0.5 for name in ("along", "across"))
        away = FRONT + self.along * (row + 0.5) + (self.along - APART) * along + WARM_SECONDS * self.speed
        aside = self.across * (column + 0.5) - self.width / 2 + (self.across - APART) * across
        start = torch.stack((torch.where(side == 0, -away, away), aside), -1)
        lane = ((aside / (self.width - 2 * FREE) + 0.5) * LANES).long().clamp(0, LANES - 1)
        mask = torch.ones_like(speed, dtype=torch.bool)
        return Layout(map_id, start, mask, speed, goals.gather(1, side * LANES + lane))
