"""Queues at doors: people leave a room by its only door, which is narrow for so many."""

from typing import ClassVar

from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite

PEOPLE = 20, 75, 150

WIDTHS = 0.5, 0.7, 0.85, 1.2, 2.0
"""Metres."""

EPISODES = 20

CLEARANCE = 0.2
"""Metres that ways keep from walls: less than half of the narrowest door."""


class Queues(Suite):
    """Every number of people at every door: whether all get through, how fast, and how they wait."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)
    headline: ClassVar[tuple[str, ...]] = ("all_through", "specific_flow_per_m_s")
    columns: ClassVar[tuple[str, ...]] = (
        "through",
        "all_through",
        "success",
        "failed",
        "agent_contact_episodes",
        "wall_contact_episodes",
        "specific_flow_per_m_s",
        "headway_p05_s",
        "headway_p50_s",
        "headway_p95_s",
        "wall_drift_m",
        "sharp_turns",
        "intervention_share",
        "intervention_m",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each width and each number of people."""
        return [
            self.case(
                options,
                name=f"{people} at {width:g} m",
                scenario=f"room_exit:people={people},entering=0,width={width:g}",
                episodes=EPISODES,
                case={"people": str(people), "width": f"{width:g}"},
                effort=float(people**2),
                table=f"{self.name} of {people}",
                clearance=CLEARANCE,
            )
            for people in PEOPLE
            for width in WIDTHS
        ]
