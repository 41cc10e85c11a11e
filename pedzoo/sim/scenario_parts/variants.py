"""Settings of a scenario that take several values: every scene draws one of each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.maps.plans import check_lengths

Numbers = float | Sequence[float]
"""A number, or several of which every scene draws one: ``hallway:width=[1.5,2,3]``."""

Variant = Mapping[str, float]
"""One value of every setting, by its name."""


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

    def drawn(self, draws: Draws) -> Tensor:
        """Return the number of every scene's combination (B,) long.

        Every setting has a draw of its own: more values of one change nothing about the others.
        """
        number = torch.zeros_like(draws.key)
        for name, values in self.values.items():
            number = number * len(values) + draws.integers(name, len(values))
        return number

    def of(self, setting: str, draws: Draws) -> Tensor:
        """Return the value of a setting in every scene (B,)."""
        values = torch.tensor([variant[setting] for variant in self], device=draws.key.device)
        return values[self.drawn(draws)]
