"""Groups of two to four walk together, meet others, and pass a door."""

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, check_lengths, room, wall
from pedzoo.sim.scenario import WARM_SECONDS, Layout, PreparedScenario
from pedzoo.sim.scenarios._base import BEHIND, CELL, WALL, Numbers, Variant, Variants, Varied, whole_cells
from pedzoo.sim.scenarios.door import ABREAST

HALF_WIDTH = 3.0
"""Metres from the middle of the hall to its walls."""

OUTMOST = 7
"""Half places of `ABREAST` from the middle to the outmost person."""

SPACING, BEYOND = 2.0, 5.0
"""Metres between groups one behind the other, and of the goals behind the middle."""

MEET = 1.5
"""Seconds after the warm start at which the first groups would meet in the middle."""

SIZES = (2, 4)
"""The smallest and the largest group."""


class Groups(Varied):
    """Groups come in turn from both ends of a hall of 6 m; some halls have a wall with a door at x = 0.

    People of a group start side by side, like the same speed, and have goals side by side. ``agents/group``
    names them. The last agents walk alone.
    """

    door = "door"

    def __init__(
        self,
        people: int = 14,
        alone: int = 2,
        size: tuple[int, int] = SIZES,
        door: Numbers = (0.0, 1.6),
        speed: float = 1.2,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: All together.
            alone: How many of them walk alone.
            size: The least and the largest group, 2 to 4; the last one may be smaller.
            door: Width of the door, metres; 0 for no wall. A list: one per scene.
            speed: Mean preferred speed of groups, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        self.variants = Variants(self.name, door=door)
        for width in self.variants.values["door"]:
            check_lengths(self.name, CELL, door=width or CELL)
        self.check(0 <= alone < people, f"alone {alone} of {people} people", f"0 to {people - 1}")
        fewest, most = size
        self.check(SIZES[0] <= fewest <= most <= SIZES[1], f"size {size}", "[least,most], from 2 to 4")
        self.alone, self.size = alone, (fewest, most)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the hall, and the wall with the door."""
        units = -(-(self.people - self.alone) // self.size[0]) + self.alone
        x = whole_cells((WARM_SECONDS + MEET) * self.fastest + SPACING * -(-units // 2) + BEHIND)
        walls, doors = room((-x, -HALF_WIDTH), (x, HALF_WIDTH), WALL), [(HALF_WIDTH, variant["door"])]
        if variant["door"]:
            walls += wall((0.0, -HALF_WIDTH), (0.0, HALF_WIDTH), 2 * WALL, doors)
        return walls

    def places(self, variant: Variant) -> list[Point]:
        """Return the goals on the right and on the left, from the lowest y on."""
        across = [place * ABREAST / 2 for place in range(-OUTMOST, OUTMOST + 1)]
        return [(x, y) for x in (BEYOND, -BEYOND) for y in across]

    def seats(self, draws: Draws) -> tuple[Tensor, Tensor, Tensor]:
        """Return the number of each person's group, their place in it, and its size, (B, A) long each.

        Sizes of groups are drawn; people alone have numbers after those of the groups.
        """
        together, slot = self.people - self.alone, torch.arange(self.people, device=draws.key.device)
        fewest, most = self.size
        sizes = fewest + draws.integers("size", most - fewest + 1, -(-together // fewest) or 1)
        ends = sizes.cumsum(1).clamp_max(together)
        unit = torch.searchsorted(ends, slot.expand(len(ends), -1).contiguous(), right=True)
        last = unit.clamp_max(ends.shape[1] - 1)
        begin = torch.nn.functional.pad(ends, (1, 0)).gather(1, last)
        alone = slot >= together
        units = (ends < together).sum(1, keepdim=True) + 1
        return (
            torch.where(alone, units + slot - together, unit),
            torch.where(alone, 0, slot - begin),
            torch.where(alone, 1, ends.gather(1, last) - begin),
        )

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return groups as far from the middle as they walk until they would meet."""
        unit, place, size = self.seats(draws)
        map_id, goals = self.drawn(prepared, draws)
        side, row = unit % 2, unit // 2
        speeds = torch.nn.functional.pad(self.speeds(draws), (0, self.people % 2))
        # groups behind faster ones start no nearer to them than `SPACING`
        pace = speeds.unflatten(1, (-1, 2)).cummax(1).values.flatten(1).gather(1, unit)
        away = (WARM_SECONDS + MEET) * pace + SPACING * row
        free = 2 * OUTMOST + 2 - 2 * size  # half places that a group can be shifted by
        shift = (draws.uniform("across", self.people).gather(1, unit) * (free + 1)).long()
        across = shift + 2 * place
        x = torch.where(side == 0, -away, away)
        return Layout(
            map_id,
            torch.stack((x, ABREAST / 2 * (across - OUTMOST)), -1),
            torch.ones_like(unit, dtype=torch.bool),
            speeds.gather(1, unit),
            goals.gather(1, side * (2 * OUTMOST + 1) + across),
            group=torch.where(size > 1, unit, -1),
        )
