"""Results computed once for each bank of floor plans, such as wall segments or a network's features."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import torch

from pedzoo.maps.bank import MapBank

T = TypeVar("T")

MOST = 4
"""Banks of which something is kept: a policy meets a training set, an environment and little else."""


class PerBank(Generic[T]):
    """Values by bank and device; the least recently used ones are dropped. Copies begin empty."""

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._kept: OrderedDict[tuple[MapBank, torch.device], T] = OrderedDict()

    def of(self, bank: MapBank, make: Callable[[MapBank], T]) -> T:
        """Return the value of a bank on its device, made by ``make(bank)`` where it is not kept."""
        key = bank, bank.device
        if key not in self._kept:
            self._kept[key] = make(bank)
            while len(self._kept) > MOST:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def __reduce__(self) -> tuple[type[PerBank[Any]], tuple[()]]:
        return PerBank, ()
