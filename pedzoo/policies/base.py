"""The base class of all policies: their name, and their controller for any simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from tensordict.nn import TensorDictModuleBase
from tensordict.nn.probabilistic import InteractionType as ExplorationType
from tensordict.nn.probabilistic import interaction_type as exploration_type

from pedzoo.maps.grid import OccupancyGrid
from pedzoo.policies.controller.controller import Controller

_DETERMINISTIC = (ExplorationType.DETERMINISTIC, ExplorationType.MODE, ExplorationType.MEAN)


def deterministic() -> bool:
    """Return whether policies are asked for their answers without noise, by TorchRL's exploration type."""
    return exploration_type() in _DETERMINISTIC


class NamedPolicy(TensorDictModuleBase):
    """A module that decides the velocities of a scene batch.

    Attributes:
        name: As it was loaded, ``orca:radius=0.3``.
        decision_dt: Seconds between its decisions.
    """

    name: str = ""
    decision_dt: float

    def policy(self) -> Self:
        """Return itself, as models return their policy."""
        return self

    def fresh(self) -> Self:
        """Return the policy as it is before its first scene: itself, for policies that remember nothing."""
        return self

    def controller(self, map: OccupancyGrid | str | Path | None = None, **settings: Any) -> Controller:
        """Return the policy as a controller for the people of any simulator; arguments as of `Controller`."""
        return Controller(self, map, **settings)

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"{type(self).__name__}({name}decides every {self.decision_dt:g} s)"
