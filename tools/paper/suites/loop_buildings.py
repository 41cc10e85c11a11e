"""Buildings to hold up in: the cells of Table II on several floor plans, and crowds in offices."""

from __future__ import annotations

from typing import Any, ClassVar

from pedzoo.core.spec import Spec
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions
from pedzoo.eval.suites.goals import Goals
from pedzoo.metrics import contacts
from pedzoo.metrics.ratios import Ratio, ratio
from pedzoo.sim.rollout import Rollout

CROWDS = {20: 6, 50: 4}
"""People in an office, and episodes of a whole run."""

OFFICES = tuple(f"office.{seed}" for seed in range(3))
"""Where the crowds walk; every episode draws one of them."""

POOL = 40
"""Places among which a crowd's goals are drawn, per office: few of them have the same."""


class LoopBuildings(Goals):
    """The cases of `Goals`, on floor plans that no training walks through, and crowds with fast physics."""

    headline: ClassVar[tuple[str, ...]] = ("episode_success", "contact_free")
    columns: ClassVar[tuple[str, ...]] = (
        "success",
        "episode_success",
        "contact_free",
        "clean",
        "deadlock",
        "failed",
        "agent_contacts_per_min",
        "wall_contacts_per_min",
        "contacts_per_min",
        "time_ratio",
        "time_ratio_median",
        "path_ratio",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return those of `Goals` and one for each crowd.

        Raises:
            UserError: There is no such floor plan.
        """
        settings: dict[str, Any] = {"map": list(OFFICES), "goals": 1, "pool": POOL}
        return super().cases(options) + [
            EvaluationCase(
                suite=self.name,
                name=f"crowd of {people}",
                scenario=Spec("goals", settings | {"people": people}),
                physics=options.physics or "compiled",
                episodes=options.number(episodes),
                case={"map": "offices", "people": str(people), "goals": "1"},
                effort=3.0 * people,
                table=f"{self.name} crowd of {people}",
                shares="offices",
            )
            for people, episodes in CROWDS.items()
        ]

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return ``contacts_per_min``: touches of others and of walls together."""
        scored = rollout.scored
        events = [
            contacts.contact_events(which & scored) for which in (rollout.agent_contact, rollout.wall_contact)
        ]
        return {"contacts_per_min": ratio(events[0] + events[1], contacts.person_minutes(scored))}
