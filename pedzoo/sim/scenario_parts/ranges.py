"""Settings of a scenario that are a number or drawn evenly from a range."""

from __future__ import annotations

import math

from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws

Range = float | tuple[float, float]
"""A number, or the least and the most of an even draw: ``door:away=[2.5,4]``."""


class Drawn:
    """A setting of which every scene draws numbers of its own, evenly between two ends.

    Attributes:
        name: Of the setting; its draws are called so, too.
        least: The smallest number.
        most: The largest.
    """

    def __init__(
        self, scenario: str, name: str, given: Range, least: float = -math.inf, most: float = math.inf
    ) -> None:
        """Take a setting's value.

        Args:
            scenario: The scenario's name in messages.
            name: Of the setting.
            given: A number, or the smallest and the largest.
            least: No number may be below it.
            most: No number may be above it.

        Raises:
            UserError: A number is not finite or out of bounds, or the first is larger than the second.
        """
        self.name = name
        self.least, self.most = given if isinstance(given, tuple) else (given, given)
        finite = math.isfinite(self.least) and math.isfinite(self.most)
        if not finite or not least <= self.least <= self.most <= most:
            bounds = [
                f"{word} {end:g}" for word, end in (("from", least), ("to", most)) if math.isfinite(end)
            ]
            raise UserError(
                f"{scenario}: {name} {given}: expected a number or [least,most]"
                + (f", {' '.join(bounds)}" if bounds else "")
            )

    def of(self, draws: Draws, count: int) -> Tensor:
        """Return ``count`` numbers for every scene (B, count)."""
        return self.least + (self.most - self.least) * draws.uniform(self.name, count)
