"""People meet at a narrow door from both sides (experiment 3 of the paper on iGibson)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.draws import Draws
from pedzoo.errors import UserError
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import rectangles, room, wall
from pedzoo.sim.scenario import WARM_SECONDS, Layout, Scenario, door_at_origin
from pedzoo.sim.variants import Numbers, Variant, Variants

BEFORE = 2.5
"""Metres from the wall at which everybody is when the warm start ends."""

BEHIND = 3.0
"""Metres of the goals behind the wall."""

PUSH = 0.05
"""Metres that those behind may drive the first ones on before the episode begins."""

SPACING = 0.9
"""Metres between people who come one behind the other."""

BORDER = 2
"""Cells of the outer walls' thickness."""


class Door(Scenario):
    """Two rooms and a door between them; people come in turn from the left and from the right.

    The wall stands at x = 0 and the door in it is centred at y = 0. Without jitter two people of equal
    speed are mirror images of each other in the door's centre.
    """

    def __init__(
        self,
        width: Numbers = 0.85,
        thickness: Numbers = 0.15,
        offset: Numbers = 0.6,
        jitter: float = 0.1,
        people: int = 2,
        speed: float = 1.3,
        speed_std: float = 0.2,
        speed_ratio: float = 1.0,
        resolution: float = 0.05,
    ) -> None:
        """Set the scene.

        Args:
            width: Of the door, metres; a list: one per scene.
            thickness: Of the wall, metres; a list: one per scene.
            offset: Lateral distance of starts and goals from the door's axis, metres; 0 is head-on; a list:
                one per scene.
            jitter: Standard deviation of the starts about it, metres.
            people: Two, one from each side; more queue up behind them.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
            speed_ratio: Speed of those from the right, divided by that of those from the left.
            resolution: Of the floor plan, metres per cell.

        Raises:
            UserError: A setting that gives no scene.
        """
        super().__init__(people, speed, speed_std)
        if speed_ratio <= 0 or jitter < 0:
            raise UserError(f"door: speed_ratio {speed_ratio}, jitter {jitter}: expected above 0, at least 0")
        fine = "resolution=0.01 takes whole centimetres"
        self.variants = Variants("door", width=width, thickness=thickness, offset=offset)
        self.variants.check_lengths(resolution, "width", "thickness", instead=fine)
        self.jitter, self.speed_ratio, self.resolution = jitter, speed_ratio, resolution
        queue = -(-people // 2) * SPACING
        self.half_length = BEFORE + queue + WARM_SECONDS * self.fastest + 1.5
        self.half_width = max(map(abs, self.variants.values["offset"])) + 3 * jitter + 2.0

    @property
    def fastest(self) -> float:
        """The largest preferred speed that can be drawn, m/s."""
        return super().fastest * max(1.0, self.speed_ratio)

    def plans(self) -> list[OccupancyGrid]:
        """Return the two rooms, for every variant."""
        return [self._plan(variant) for variant in self.variants]

    def _plan(self, variant: Variant) -> OccupancyGrid:
        width, thickness = variant["width"], variant["thickness"]
        # whole cells from the door's sides and from the wall to the ends of the rooms
        x = thickness / 2 + self._whole_cells(self.half_length - thickness / 2)
        y = width / 2 + self._whole_cells(self.half_width - width / 2)
        walls = room((-x, -y), (x, y), BORDER * self.resolution)
        walls += wall((0.0, -y), (0.0, y), thickness, doors=[(y, width)])
        return rectangles(walls, self.resolution, name=self.variants.name(variant))

    def _whole_cells(self, length: float) -> float:
        return math.ceil(length / self.resolution) * self.resolution

    def prepare(self, clearance: float) -> None:
        """Find the ways through the door."""
        super().prepare(clearance)
        # variants that differ in the offset alone share a floor plan
        self._map_id = torch.tensor([self.bank.id_of(self.variants.name(one)) for one in self.variants])
        goals = []
        for variant, row in zip(self.variants, self.bank.index(self._map_id).tolist(), strict=True):
            points = [(side * BEHIND, sign * variant["offset"]) for side in (1, -1) for sign in (1, -1)]
            goals.append(self.planner.add_goals(row, torch.tensor(points, dtype=torch.float64)).view(2, 2))
        self._goals = torch.stack(goals)
        self._offset = torch.tensor([variant["offset"] for variant in self.variants])

    def gate(self, draws: Draws) -> Tensor:
        """Return the door in the middle, (B, 5)."""
        return door_at_origin(self.variants.of("width", draws))

    def layout(self, draws: Draws) -> Layout:
        """Return people on both sides, as far away as they walk before the episode begins."""
        scenes, agents, device = len(draws.key), self.people, draws.key.device
        variant = self.variants.drawn(draws)
        agent = torch.arange(agents, device=device)
        side = 2 * (agent % 2) - 1  # -1 comes from the left, 1 from the right
        speed = self.speeds(draws)
        speed = torch.where(side > 0, speed * self.speed_ratio, speed)
        away = BEFORE + WARM_SECONDS * speed + SPACING * (agent // 2) + PUSH * (agents > 2)
        offset = self._offset.to(device)[variant].unsqueeze(1)
        lateral = side * offset + self.jitter * draws.normal("jitter", agents).clamp(-3, 3)
        start = torch.stack((side * away, lateral), dim=-1)
        # everybody keeps to their side of the axis: from the left, y = -offset to y = -offset
        goal = self._goals.to(device)[variant][:, agent % 2, 1 - agent % 2]
        mask = start.new_ones(scenes, agents).bool()
        return Layout(self._map_id.to(device)[variant], start, mask, speed, goal)
