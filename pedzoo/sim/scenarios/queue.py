"""People queue at a counter, are served one after the other, and leave."""

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import Point, Rectangle, room
from pedzoo.sim.scenario import WARM_SECONDS, Layout, PreparedScenario
from pedzoo.sim.scenarios._base import BEHIND, WALL, Range, Uniform, Variant, Variants, Varied, whole_cells

SPACING, COMING = 0.8, 2.0
"""Metres between places in the line, and at least between people who come to it."""

COUNTER = (0.5, -1.0, 1.1, 1.0)
"""The counter's corners, metres; the person who is served stands at the origin."""

HALF_WIDTH = 3.2
"""Metres from the line to the walls."""

EXITS = [(-3.0, 2.6), (-3.0, -2.6)]


class Queue(Varied):
    """A line along x before a counter; the first person is served and leaves to one side, others move up.

    Places in the line are goals, at which the policy has to hold people. A person takes the next place when
    the person ahead leaves it, also on the way to the line. Goals that count are the exits. Agents are
    numbered from the counter.
    """

    waits = True

    def __init__(
        self,
        people: int = 8,
        coming: int = 3,
        seconds: Range = (2.0, 6.0),
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: All together.
            coming: How many of them are not in the line when the episode begins; they come to its end.
            seconds: How long a person is served; ``[least,most]``: each draws a time.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        super().__init__(people, speed, speed_std)
        self.check(0 <= coming < people, f"coming {coming} of {people} people", f"0 to {people - 1}")
        self.in_line, self.later, self.variants = people - coming, people + 1, Variants(self.name)
        self.seconds = Uniform(self.name, "seconds", seconds, least=0.1)

    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the room and the counter."""
        coming = self.people - self.in_line
        reach = SPACING * self.people + COMING * (coming + 1) + WARM_SECONDS * self.fastest
        left = whole_cells(max(reach, -EXITS[0][0]) + BEHIND)
        return [*room((-left, -HALF_WIDTH), (2.0, HALF_WIDTH), WALL), COUNTER]

    def places(self, variant: Variant) -> list[Point]:
        """Return the places from the counter on, and the exits."""
        return [*((-SPACING * place, 0.0) for place in range(self.people)), *EXITS]

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return the place before the last one, and an exit after the counter."""
        goals, place = prepared.tables[1].to(last.device)[0], agent - number
        exit = goals[self.people + (2 * draws.uniform_at("exit", agent)).long()]
        return torch.where(place >= 0, goals[place.clamp_min(0)], torch.where(place == -1, exit, -1))

    def pauses(self, draws: Draws, number: Tensor) -> Tensor:
        """Return how long people are served at the counter; at other places they wait to be called."""
        place = torch.arange(self.people, device=number.device) - number
        served = torch.where(place == 0, self.seconds.draw(draws, self.people), 0.0)
        return torch.where(place > 0, torch.inf, served)

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people at their places, and those who come behind them."""
        speed, (map_id, goals) = self.speeds(draws), self.drawn(prepared, draws)
        slot = torch.arange(self.people, device=speed.device)
        late = (slot - self.in_line + 1).clamp_min(0)
        back = torch.where(late > 0, COMING * late + WARM_SECONDS * speed.cummax(1).values, 0.0)
        start = -SPACING * torch.where(late > 0, self.people, slot) - back
        hold = self.pauses(draws, torch.zeros_like(goals[:, :-2]))
        return Layout(
            map_id,
            torch.stack((start, torch.zeros_like(start)), -1),
            torch.ones_like(speed, dtype=torch.bool),
            speed,
            goals[:, : self.people],
            hold=torch.where(late > 0, 0.0, hold),
        )
