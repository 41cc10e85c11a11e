"""The encounters of Francis et al. 2023, one case each: people meet in corridors, at corners, in the open."""

from typing import ClassVar

from pedzoo.core.registry import SCENARIOS
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.sim.scenarios._lanes import Encounter

EPISODES = 20


class Encounters(Suite):
    """Every scenario of the registry that is an encounter, with its defaults."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each encounter."""
        names = [name for name in SCENARIOS.names() if issubclass(SCENARIOS.get(name), Encounter)]
        return [self.case(options, name, name, EPISODES, {"encounter": name}) for name in names]
