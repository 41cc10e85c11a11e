"""Doors to hold up at: varied, hard, symmetric, crowded and obstructed ones, and the flow of a queue."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite


class Doorway(NamedTuple):
    """A case.

    Attributes:
        scenario: With settings.
        episodes: In a whole run.
        physics: Where people walk.
        people: In each episode.
    """

    scenario: str
    episodes: int
    physics: str = "bullet"
    people: int = 2


_WIDE = "width=[0.7,0.8,0.9,1.0,1.1,1.2]"
_SIDES = "offset=[-0.4,0.0,0.3,0.6]"
_VARIED = f"{_WIDE},thickness=[0.1,0.15,0.2],{_SIDES}"

DOORWAYS = {
    "varied": Doorway(f"door:{_VARIED},away=[2.5,4]", 1000),
    "hard": Doorway(
        f"door:width=[0.7,0.75,0.8,0.85],thickness=[0.1,0.15,0.2],{_SIDES},away=[2.5,4],sync=0.4", 500
    ),
    "mirror": Doorway(f"door:{_VARIED},jitter=0,speed_std=0", 500),
    "2 against 2": Doorway(f"door:{_VARIED},people=4", 200, people=4),
    "3 against 1": Doorway(f"door:{_VARIED},people=4,from_right=1", 200, people=4),
    "queue of 6": Doorway(f"door:{_VARIED},people=6,from_right=0", 200, people=6),
    "standing": Doorway(f"standing:{_WIDE},{_SIDES}", 300),
    "flow of 20": Doorway(
        "room_exit:people=20,entering=0,width=[0.8,0.9,1.0,1.1,1.2]", 20, physics="compiled", people=20
    ),
}


class LoopDoors(Suite):
    """Every doorway is a case with a table of its own: a mean over them says nothing."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)
    headline: ClassVar[tuple[str, ...]] = ("clean",)
    columns: ClassVar[tuple[str, ...]] = (
        "clean",
        "episode_success",
        "contact_free",
        "deadlock",
        "failed",
        "agent_contact_episodes",
        "wall_contact_episodes",
        "time_ratio_median",
        "least_distance_m",
        "symmetry_m",
        "yield_delay_s",
        "faster_first",
        "specific_flow_per_m_s",
        "acceleration_m_per_s2",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return one case for each doorway."""
        return [
            EvaluationCase(
                suite=self.name,
                name=name,
                scenario=doorway.scenario,
                physics=options.physics or doorway.physics,
                episodes=options.number(doorway.episodes),
                case={"doorway": name},
                effort=float(doorway.people),
                table=f"{self.name} {name}",
            )
            for name, doorway in DOORWAYS.items()
        ]
