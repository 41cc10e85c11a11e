"""Figure 4 of the paper on iGibson: two people meet head-on at a narrow door, equally fast or not."""

from __future__ import annotations

from typing import ClassVar

from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.metrics.ratios import Ratio
from pedzoo.sim.rollout import Rollout
from tools.paper.outcome import OUTCOMES, outcome_ratios

EPISODES = 100

RATIO = 0.7
"""Speed of the one from the right, divided by that of the one from the left, where they are unequal."""

_HEAD_ON = "door:offset=0,speed_std=0"
SCENARIOS = {
    "equal": _HEAD_ON,
    "unequal": f"{_HEAD_ON},speed_ratio={RATIO}",
    "alone": f"{_HEAD_ON},people=1",
}
"""A single person has no one to avoid: a policy that is blocked there does not fit through the door."""


class Figure4(Suite):
    """Two people of equal speed, two of unequal speed, and one alone."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)
    headline: ClassVar[tuple[str, ...]] = ("success", "agent_contact_episodes")
    columns: ClassVar[tuple[str, ...]] = (
        "success",
        *(f"outcome_{name}" for name in OUTCOMES),
        "agent_contact_episodes",
        "wall_contact_episodes",
        "time_s",
        "least_distance_m",
        "symmetry_index",
        "yield_delay_s",
        "bearing_sweep_deg",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return the three cases, each with a table of its own: a mean over them says nothing."""
        physics, episodes = options.physics or "bullet", options.number(EPISODES)
        return [
            EvaluationCase(
                self.name, name, scenario, physics, episodes, {"speeds": name}, table=f"{self.name} {name}"
            )
            for name, scenario in SCENARIOS.items()
        ]

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return how the two get past each other."""
        return outcome_ratios(rollout)
