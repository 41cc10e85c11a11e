"""The encounters of Francis et al. 2023, one case each: people meet in corridors, at corners, in the open."""

from __future__ import annotations

from typing import ClassVar

from pedzoo.core.registry import SCENARIOS
from pedzoo.eval.suite import Case, Request, Suite
from pedzoo.sim.scenes.encounter import Encounter

EPISODES = 20


class Cards(Suite):
    """Every scenario of the registry that is an encounter, with its defaults."""

    uses: ClassVar[tuple[str, ...]] = ("episodes",)

    def cases(self, request: Request) -> list[Case]:
        """Return a case for each encounter."""
        names = [name for name in SCENARIOS.names() if issubclass(SCENARIOS.get(name), Encounter)]
        physics, episodes = request.physics or "compiled", request.number(EPISODES)
        return [Case(self.name, name, name, physics, episodes, {"card": name}) for name in names]
