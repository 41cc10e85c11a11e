"""Random numbers of floor plans, the same on every machine and for every version of numpy."""

from collections.abc import Sequence
from typing import TypeVar
from zlib import crc32

import numpy as np

Item = TypeVar("Item")


class PortableRandom:
    """Draws from PCG64.

    numpy promises that the bits of PCG64 and SeedSequence stay what they are, but not what `Generator` makes
    of them. Numbers are therefore made from the bits here, by additions and multiplications alone.
    """

    def __init__(self, seed: int, *parts: int | str) -> None:
        """Start the stream of ``seed`` and of its purpose: other parts give independent numbers."""
        entropy = [seed, *(crc32(part.encode()) if isinstance(part, str) else part for part in parts)]
        self._bits = np.random.PCG64(np.random.SeedSequence(entropy))

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """Return a number from ``low`` up to ``high``."""
        return low + (high - low) * ((int(self._bits.random_raw()) >> 11) * 2.0**-53)

    def integer(self, low: int, high: int) -> int:
        """Return a whole number from ``low`` to ``high``, both of them possible."""
        return low + min(int(self.uniform() * (high - low + 1)), high - low)

    def chance(self, probability: float) -> bool:
        """Return true with this probability."""
        return self.uniform() < probability

    def choice(self, items: Sequence[Item]) -> Item:
        """Return one of the items."""
        return items[self.integer(0, len(items) - 1)]

    def shuffled(self, items: Sequence[Item]) -> list[Item]:
        """Return the items in random order (Fisher and Yates)."""
        mixed = list(items)
        for last in range(len(mixed) - 1, 0, -1):
            other = self.integer(0, last)
            mixed[last], mixed[other] = mixed[other], mixed[last]
        return mixed
