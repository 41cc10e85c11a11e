"""The narrow door: two people meet at it from both sides."""

from typing import ClassVar

from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.sim.make import usual_physics

EPISODES = 200


class Door(Suite):
    """One case, the scenario ``door`` with its defaults."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)
    columns: ClassVar[tuple[str, ...]] = (
        "success",
        "deadlock",
        "failed",
        "agent_contacts_per_min",
        "wall_contacts_per_min",
        "time_ratio",
        "path_ratio",
        "least_distance_m",
        "symmetry_index",
        "yield_delay_s",
        "yielder_speed_m_per_s",
        "specific_flow_per_m_s",
        "intervention_share",
        "intervention_m",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return the one case."""
        return [self.case(options, "door", "door", EPISODES, {}, usual_physics())]
