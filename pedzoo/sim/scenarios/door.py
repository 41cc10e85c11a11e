"""People meet at a narrow door from both sides (experiment 3 of the paper on iGibson)."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, room, wall
from pedzoo.sim.scenario import SLOWEST, WARM_SECONDS, Layout, PreparedScenario
from pedzoo.sim.scenarios._base import Numbers, Range, Uniform, Variant, Variants, Varied, fastest_ahead

BEFORE, NEAREST = 2.5, 1.0
"""Metres from the wall at which the first ones are when the warm start ends, and the least to ask for."""

PUSH = 0.05
"""Metres that those behind may drive the first ones on before the episode begins."""

SPACING, ABREAST = 0.9, 0.75
"""Metres between people in a line, and in pairs (Zanlungo et al. 2014, 10.1103/PhysRevE.89.012811)."""


@dataclass(frozen=True)
class DoorSettings:
    """Settings of people who come to a door.

    Attributes:
        jitter: Standard deviation of the starts about their lateral distance from the door's axis, metres.
        people: All together, also those who stand; at first two, one from each side; more queue up behind.
        speed: Mean preferred speed, m/s.
        speed_std: Its standard deviation.
        speed_ratio: Speed of those from the right, divided by that of those from the left.
        resolution: Of the floor plan, metres per cell.
        away: Metres from the middle of the wall of the first person of a side when the warm start ends, if
            not held up; ``[least,most]``: each side draws one.
        sync: Most seconds between the first persons of the two sides at the door if each walked alone,
            uniformly distributed. People who would be there too early start farther away than ``away``.
            None: ``away`` and their speeds decide.
        from_right: How many of the people come from the right; None: every other one.
        abreast: How many of a side walk together, side by side and equally fast, 1 to 3; an incomplete row is
            centred.
    """

    jitter: float = 0.1
    people: int = 2
    speed: float = 1.3
    speed_std: float = 0.2
    speed_ratio: float = 1.0
    resolution: float = 0.05
    away: Range = BEFORE
    sync: float | None = None
    from_right: int | None = None
    abreast: int = 1


class Door(Varied):
    """Two rooms and a door between them; people come in turn from the left and from the right.

    The wall stands at x = 0 and the door in it is centred at y = 0. Without jitter two people of equal
    speed are mirror images of each other in the door's centre. Agents are numbered from the door: the first
    from the left, the first from the right, the second from the left, ...
    """

    meet = 0.0
    door = "width"

    def __init__(
        self,
        width: Numbers = 0.85,
        thickness: Numbers = 0.15,
        offset: Numbers = 0.6,
        common: DoorSettings = DoorSettings(),
    ) -> None:
        """Set the scene.

        Args:
            width: Of the door, metres; a list: one per scene.
            thickness: Of the wall, metres; a list: one per scene.
            offset: Lateral distance of starts and goals from the door's axis, metres; 0 is head-on; a list:
                one per scene.
            common: Of those who come to the door.
        """
        people, jitter, ratio, sync = common.people, common.jitter, common.speed_ratio, common.sync
        super().__init__(people, common.speed, common.speed_std)
        self.check(ratio > 0 and jitter >= 0, f"speed_ratio {ratio}, jitter {jitter}", "above 0, at least 0")
        fine = "resolution=0.01 takes whole centimetres"
        self.variants = Variants(self.name, width=width, thickness=thickness, offset=offset)
        self.variants.check_lengths(common.resolution, "width", "thickness", instead=fine)
        self.jitter, self.speed_ratio, self.resolution, self.sync = jitter, ratio, common.resolution, sync
        self.away = Uniform(self.name, "away", common.away, least=NEAREST)
        self._seat(common)
        queue = (int(self._row.max()) + 1) * SPACING
        aside = max(map(abs, self.variants.values["offset"])) + 3 * jitter
        self.half_length = self.away.most + queue + WARM_SECONDS * self.fastest + 1.5
        if sync is not None:
            both = sync >= 0 and 0 < int(self._right.sum()) < people
            self.check(both, f"sync {sync}", "at least 0 s, and people from both sides")
            # faster people wait for slower ones
            alone = math.hypot(self.away.most + PUSH, aside) / self.slowest + sync
            self.half_length = self.fastest * (WARM_SECONDS + alone) + queue + 1.5
        self.half_width = aside + 2.0 + ABREAST * (common.abreast - 1) / 2

    def _seat(self, common: DoorSettings) -> None:
        """Give each person a side, a row, and the people beside them."""
        people, abreast = self.people, common.abreast
        from_right = people // 2 if common.from_right is None else common.from_right
        self.check(0 <= from_right <= people, f"from_right {from_right} of {people} people", f"0 to {people}")
        self.check(1 <= abreast <= 3, f"abreast {abreast}", "1 to 3")
        sides = (people - from_right, from_right)
        seats = sorted((number, side) for side, count in enumerate(sides) for number in range(count))
        number, self._right = torch.tensor(seats).unbind(1)
        self._row = number // abreast
        in_row = (torch.tensor(sides)[self._right] - self._row * abreast).clamp_max(abreast)
        self._left_of_row = ABREAST * (number % abreast - (in_row - 1) / 2)
        leaders = [seats.index((number - number % abreast, side)) for number, side in seats]
        self._leader = torch.tensor(leaders)

    @property
    def fastest(self) -> float:
        """The largest preferred speed that can be drawn, m/s."""
        return super().fastest * max(1.0, self.speed_ratio)

    @property
    def slowest(self) -> float:
        """The smallest preferred speed that can be drawn, m/s."""
        return max(SLOWEST, self.speed - 3 * self.speed_std) * min(1.0, self.speed_ratio)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the two rooms and the wall between them."""
        width, thickness = variant["width"], variant["thickness"]
        # whole cells from the door's sides, and from the wall, to the ends of the rooms
        x, y = (
            near + math.ceil((far - near) / self.resolution) * self.resolution
            for near, far in ((thickness / 2, self.half_length), (width / 2, self.half_width))
        )
        walls = room((-x, -y), (x, y), 2 * self.resolution)
        return walls + wall((0.0, -y), (0.0, y), thickness, doors=[(y, width)])

    def places(self, variant: Variant) -> list[Point]:
        """Return the goals of both sides, 3 m behind the wall: people keep to their side of the axis."""
        return [(3.0, -variant["offset"]), (-3.0, variant["offset"])]

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people on both sides, as far away as they walk before the episode begins."""
        device, agents = draws.key.device, len(self._row)
        right, row, leader = (table.to(device) for table in (self._right, self._row, self._leader))
        side = 2 * right - 1  # -1 comes from the left, 1 from the right
        speed = self.speeds(draws)[:, leader]
        speed = torch.where(side > 0, speed * self.speed_ratio, speed)
        pace = fastest_ahead(speed, row, right)
        away = self.away.draw(draws, 2)[:, right] + WARM_SECONDS * pace
        away = away + SPACING * row + PUSH * (row.max() > 0)
        offset = self.variants.value("offset", draws).unsqueeze(1)
        lateral = side * (offset + self._left_of_row.to(device))
        lateral = lateral + self.jitter * draws.normal("jitter", agents)[:, leader].clamp(-3, 3)
        if self.sync is not None:
            away = away + self._later(draws, away, lateral, speed, self.sync)[:, right]
        map_id, goals = self.drawn(prepared, draws)
        mask = torch.ones_like(away, dtype=torch.bool)
        return Layout(map_id, torch.stack((side * away, lateral), -1), mask, speed, goals[:, right])

    def _later(self, draws: Draws, away: Tensor, lateral: Tensor, speed: Tensor, sync: float) -> Tensor:
        """Return the metres that each side starts farther back (B, 2), so that both come in time."""
        first = [int((self._right == side).nonzero()[0]) for side in (0, 1)]
        away, lateral, speed = away[:, first], lateral[:, first], speed[:, first]
        left, right = (torch.hypot(away, lateral) / speed).unbind(1)  # seconds until they are at the door
        later = sync * (2 * draws.uniform("sync") - 1)
        left = left.maximum(right - later)
        seconds = torch.stack((left, left + later), dim=1)
        return ((seconds * speed).square() - lateral.square()).sqrt() - away
