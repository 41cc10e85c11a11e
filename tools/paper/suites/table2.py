"""Table II of the paper on iGibson: from goal to goal through an apartment, at two walking speeds."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pedzoo.core.spec import Spec
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.eval.suites.goals import CELLS, EPISODES, GIVEN, POOL
from pedzoo.maps.plans import load_plan
from pedzoo.metrics import arrival
from pedzoo.metrics.ratios import Ratio, ratio
from pedzoo.sim.rollout import Rollout

DRAWN = tuple(f"apartment.{seed}" for seed in range(3))
"""Floor plans where none is given: every episode draws one of them."""

SPEEDS = {"1.3": (1.3, 0.2), "0.5": (0.5, 0.0)}
"""m/s, mean and deviation: as people walk, and as all of iGibson's do."""


class Table2(Suite):
    """Every cell of the table at both speeds, on the floor plans that are given or on three drawn ones."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes", "maps")
    columns: ClassVar[tuple[str, ...]] = (
        "success",
        "episode_success",
        "time_s",
        "seconds_per_goal",
        "goals_per_person",
        "agent_contacts_per_min",
        "wall_contacts_per_min",
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return five cases for each speed.

        Raises:
            UserError: There is no such floor plan.
        """
        files = list(options.maps or DRAWN)
        name = "drawn" if not options.maps else Path(files[0]).stem if len(files) == 1 else GIVEN
        inputs = " ".join(load_plan(file).digest for file in files)
        physics, episodes = options.physics or "bullet", options.number(EPISODES)
        result = []
        for speed, (mean, deviation) in SPEEDS.items():
            for people, goals in CELLS:
                cell = {"map": files, "people": people, "goals": goals, "pool": POOL}
                settings = {**cell, "speed": mean, "speed_std": deviation}
                case = {"map": name, "speed": speed, "people": str(people), "goals": str(goals)}
                result.append(
                    EvaluationCase(
                        suite=self.name,
                        name=f"{speed} m/s {people}/{goals}",
                        scenario=Spec("goals", settings),
                        physics=physics,
                        episodes=episodes,
                        case=case,
                        inputs=inputs,
                        effort=people * goals / mean,
                        table=f"{self.name} {speed} m/s",
                        shares=", ".join(files),
                    )
                )
        return result

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return ``seconds_per_goal``, of episodes in which every person reaches all goals in time."""
        reached, goals, mask = rollout.reached, rollout.goals, rollout.mask
        arrived = arrival.arrived_in_time(reached, goals, rollout.overdue, rollout.failed, mask)
        last = arrival.episode_seconds(arrival.finish_seconds(reached, goals), arrived, mask)
        return {"seconds_per_goal": ratio(*arrival.seconds_per_goal(last, reached, mask))}
