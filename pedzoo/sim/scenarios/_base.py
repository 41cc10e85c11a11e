"""Parts of scenarios: settings of which every scene draws a value, and floor plans that follow from them."""

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import Point, Rectangle, check_lengths, rectangles
from pedzoo.sim.scenario import PreparedScenario, Scenario

CELL, WALL = 0.05, 0.1
"""Side of the floor plans' cells, and thickness of outer walls, metres."""

BEHIND = 1.5
"""Metres of floor behind the last person, and behind goals."""

Numbers = float | Sequence[float]
"""A number, or several of which every scene draws one: ``hallway:width=[1.5,2,3]``."""

Range = float | tuple[float, float]
"""A number, or the least and the most of a uniform draw: ``door:away=[2.5,4]``."""

Variant = Mapping[str, float]
"""One value of every setting, by its name."""


def whole_cells(length: float) -> float:
    """Return the smallest multiple of `CELL` that is not below ``length``, metres."""
    return math.ceil(length / CELL - 1e-6) * CELL


def fastest_ahead(speed: Tensor, row: Tensor, lane: Tensor) -> Tensor:
    """Return the greatest of the speeds (B, A) of each agent and those ahead in its lane, m/s.

    Who starts behind faster people by this speed comes no nearer to them in the warm start. ``row`` is how
    many are ahead in the lane, and ``lane`` its number, (A,) or (B, A) long.
    """
    scene = torch.arange(len(speed), device=speed.device).unsqueeze(1)
    table = speed.new_zeros(len(speed), int(row.max()) + 1, int(lane.max()) + 1)
    table[scene, row, lane] = speed
    return table.cummax(1).values[scene, row, lane]


class Variants:
    """All combinations of some settings' values, in the order of the settings: the last varies fastest.

    Attributes:
        scenario: The scenario's name in messages and floor plans.
        values: The values of every setting.
    """

    def __init__(self, scenario: str, **settings: Numbers) -> None:
        """Take the settings by name.

        Raises:
            UserError: A setting without a value, with one that is no finite number, or with one twice.
        """
        self.scenario = scenario
        self.values: dict[str, tuple[float, ...]] = {}
        for name, given in settings.items():
            values = tuple(given) if isinstance(given, Sequence) else (float(given),)
            if not values or not all(math.isfinite(value) for value in values):
                raise UserError(f"{scenario}: {name} {given}: expected a number, or a list of some")
            if twice := sorted({value for value in values if values.count(value) > 1}):
                raise UserError(f"{scenario}: {name} {list(values)}: {twice[0]:g} is there twice")
            self.values[name] = values

    def __iter__(self) -> Iterator[Variant]:
        """Yield the combinations."""
        for values in product(*self.values.values()):
            yield dict(zip(self.values, values, strict=True))

    def check_lengths(self, resolution: float, *names: str, instead: str = "") -> None:
        """Raise the error of a length that is not above 0 or no multiple of ``resolution``, metres."""
        for name in names:
            for value in self.values[name]:
                check_lengths(self.scenario, resolution, instead=instead, **{name: value})

    def name(self, variant: Variant) -> str:
        """Return the scenario with the settings of one combination, as one writes it."""
        settings = ",".join(f"{name}={value:g}" for name, value in variant.items())
        return f"{self.scenario}:{settings}"

    def draw(self, draws: Draws) -> Tensor:
        """Return the number of every scene's combination (B,) long.

        Every setting has a draw of its own: more values of one change nothing about the others.
        """
        number = torch.zeros_like(draws.key)
        for name, values in self.values.items():
            number = number * len(values) + draws.integers(name, len(values))
        return number

    def value(self, setting: str, draws: Draws) -> Tensor:
        """Return the value of a setting in every scene (B,)."""
        values = torch.tensor([variant[setting] for variant in self], device=draws.key.device)
        return values[self.draw(draws)]


class Uniform:
    """A setting that is a number, or of which every scene draws numbers uniformly between two ends.

    Attributes:
        name: Of the setting; its draws are called so, too.
        least: The smallest number.
        most: The largest.
    """

    def __init__(self, scenario: str, name: str, given: Range, least: float = -math.inf) -> None:
        """Take the value of a scenario's setting: a number, or the smallest and the largest.

        Raises:
            UserError: A number is not finite or below ``least``, or the first is larger than the second.
        """
        self.name = name
        self.least, self.most = given if isinstance(given, tuple) else (given, given)
        finite = math.isfinite(self.least) and math.isfinite(self.most)
        if not finite or not least <= self.least <= self.most:
            bound = f", from {least:g}" if math.isfinite(least) else ""
            raise UserError(f"{scenario}: {name} {given}: expected a number or [least,most]{bound}")

    def draw(self, draws: Draws, count: int) -> Tensor:
        """Return ``count`` numbers for every scene (B, count)."""
        return self.least + (self.most - self.least) * draws.uniform(self.name, count)


class Varied(Scenario):
    """People on floor plans that follow from settings; subclasses say which, and how people begin.

    Attributes:
        variants: Settings of which every scene draws a value.
        resolution: Side of the floor plans' cells, metres.
        door: The setting that is the width of a door at the origin, if there is one; 0 for no door.
    """

    variants: Variants
    resolution: float = CELL
    door: str | None = None

    @abstractmethod
    def walls(self, variant: Variant) -> list[Rectangle]:
        """Return the walls, whose edges are between cells; none for an open space."""

    @abstractmethod
    def places(self, variant: Variant) -> list[Point]:
        """Return all goals, metres."""

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plans of all variants that have walls."""
        named = ((self.walls(one), self.variants.name(one)) for one in self.variants)
        return [rectangles(walls, self.resolution, name=name) for walls, name in named if walls]

    def prepare(self, clearance: float, planner: str = Planner.name) -> PreparedScenario:
        """Find the ways to all places; tables: floor plans (V,) and goals (V, G) of variants, -1 for none."""
        prepared = super().prepare(clearance, planner)
        bank, names = prepared.bank, map(self.variants.name, self.variants)
        # variants may share a floor plan
        map_id = torch.tensor([bank.id_of(name) if bank.grids else -1 for name in names])
        goals = [
            prepared.planner.add_goals(row, torch.tensor(self.places(variant), dtype=torch.float64))
            for variant, row in zip(self.variants, bank.index(map_id).tolist(), strict=True)
        ]
        table = torch.nn.utils.rnn.pad_sequence(goals, batch_first=True, padding_value=-1)
        return replace(prepared, tables=(map_id, table))

    def drawn(self, prepared: PreparedScenario, draws: Draws) -> tuple[Tensor, Tensor]:
        """Return the floor plan (B,) long and the goals (B, G) long of every scene."""
        variant = self.variants.draw(draws)
        map_id, goals = (table.to(variant.device)[variant] for table in prepared.tables)
        return map_id, goals

    def gate(self, draws: Draws) -> Tensor | None:
        """Return the door (B, 5), where all scenes have one."""
        if self.door is None or min(self.variants.values[self.door]) <= 0:
            return None
        width = self.variants.value(self.door, draws)
        centre, across = torch.zeros_like(width), torch.ones_like(width)
        return torch.stack((centre, centre, across, centre, width), dim=-1)
