"""People stand and wait in a hall while others walk through."""

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, room
from pedzoo.sim.scenario import Layout, PreparedScenario
from pedzoo.sim.scenarios._base import WALL, Range, Uniform, Variant, Variants, Varied

HALF = (10.0, 4.0)
"""Metres from the middle of the hall to its walls."""

APART = 1.2
"""Metres between places to wait at."""

PLACES = [
    (APART * column, APART * (row + (column % 2) / 2) - APART / 4)
    for column in range(-3, 4)
    for row in range(-2, 3)
]

LANES, ABREAST = 9, 0.8
"""Ways through the hall, and metres between them."""

EXIT, ENTER = 8.0, 1.2
"""Metres from the middle to the exits, and behind them at which people start, at most."""


class Waiting(Varied):
    """Some people wait in a hall of 20 m by 8 m, others walk through it from both ends.

    People who wait have their place as goal, and their policy has to hold them there. Some of them set out
    for an exit after a drawn time. Others stay to the end, and are not scored for arriving. Agents are
    numbered from those who wait on.
    """

    waits = True
    later = 2

    def __init__(
        self,
        people: int = 12,
        waiting: int = 7,
        stay: float = 0.5,
        seconds: Range = (3.0, 12.0),
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: All together.
            waiting: How many of them wait at first, at most 35.
            stay: Share of these who stay to the end.
            seconds: How long the others wait; ``[least,most]``: each draws a time.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        passing = people - waiting
        self.check(
            0 <= waiting <= len(PLACES) and 1 <= passing <= 2 * LANES,
            f"waiting {waiting} of {people} people",
            f"0 to {len(PLACES)} who wait, and 1 to {2 * LANES} others",
        )
        self.check(0 <= stay <= 1, f"stay {stay}", "a share from 0 to 1")
        self.waiting, self.stay, self.variants = waiting, stay, Variants(self.name)
        self.seconds = Uniform(self.name, "seconds", seconds, least=0.1)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the hall's."""
        return room((-HALF[0], -HALF[1]), HALF, WALL)

    def places(self, variant: Variant) -> list[Point]:
        """Return the exits on the left, on the right, and the places to wait at."""
        lanes = [ABREAST * (lane - LANES // 2) for lane in range(LANES)]
        return [(side * EXIT, y) for side in (-1, 1) for y in lanes] + PLACES

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return an exit for people who have waited."""
        goals = prepared.tables[1].to(last.device)[0]
        exit = goals[(draws.uniform_at("exit", agent) * 2 * LANES).long()]
        goes = (agent < self.waiting) & (number == 1) & (draws.uniform_at("stay", agent) >= self.stay)
        return torch.where(goes, exit, -1)

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people at their places, and those who walk through at the ends of the hall."""
        device, agents, waiting = draws.key.device, self.people, self.waiting
        speed, (map_id, goals) = self.speeds(draws), self.drawn(prepared, draws)
        points = torch.tensor(self.places({}), device=device)
        place = 2 * LANES + draws.uniform("place", len(PLACES)).topk(waiting).indices
        slot = torch.arange(agents - waiting, device=device)
        side = slot % 2  # 0: from the left
        lane = draws.uniform("lane", 2, LANES).argsort(2)[:, side, slot // 2]
        enter = points[side * LANES + lane]
        enter[..., 0] += (2 * side - 1) * ENTER * draws.uniform("enter", agents - waiting)
        leave = (1 - side) * LANES + draws.integers("leave", LANES, agents - waiting)
        stays = draws.uniform("stay", waiting) < self.stay
        hold = torch.where(stays, torch.inf, self.seconds.draw(draws, waiting))
        return Layout(
            map_id,
            torch.cat((points[place], enter), 1),
            torch.ones_like(speed, dtype=torch.bool),
            speed,
            goals.gather(1, torch.cat((place, leave), 1)),
            hold=torch.cat((hold, torch.zeros_like(enter[..., 0])), 1),
        )
