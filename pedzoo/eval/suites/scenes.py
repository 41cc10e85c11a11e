"""Suites of scenes that need no recordings: doors, buildings, encounters, indoor crowds and queues."""

from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import torch

from pedzoo.core.machine import usual_physics
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import Spec
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.maps.plans import load_plan
from pedzoo.metrics.ratios import Ratio
from pedzoo.metrics.realism.crowds import measured
from pedzoo.metrics.realism.features import every_step
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios._lanes import Encounter

EPISODES = 20
"""Of a case, but at the door."""

CELLS = ((2, 3), (2, 5), (3, 3), (3, 5), (5, 3))
"""People and goals of Table II of the paper on iGibson."""

DRAWN = tuple(f"{kind}.{seed}" for kind in ("apartment", "office") for seed in range(3))
"""Floor plans that need no file; every episode draws one of them."""

GIVEN = "given"
"""What tables call several floor plans that were asked for: every episode draws one of those."""

POOL = 12
"""Places among which goals are drawn, per floor plan: more of them cost seconds and change little."""


class Door(Suite):
    """The narrow door: two people meet at it from both sides."""

    accepted_options = ("episodes",)
    columns = (
        *("success", "deadlock", "failed", "agent_contacts_per_min", "wall_contacts_per_min"),
        *("time_ratio", "path_ratio", "least_distance_m", "symmetry_index", "yield_delay_s"),
        *("yielder_speed_m_per_s", "specific_flow_per_m_s", "intervention_share", "intervention_m"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return the one case, the scenario ``door`` with its defaults."""
        return [self.case(options, "door", "door", 200, {}, usual_physics())]


class Encounters(Suite):
    """The encounters of Francis et al. 2023: people meet in corridors, at corners, in the open."""

    accepted_options = ("episodes",)

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each scenario that is an encounter, with its defaults."""
        names = [name for name in SCENARIOS.names() if issubclass(SCENARIOS.get(name), Encounter)]
        return [self.case(options, name, name, EPISODES, {"encounter": name}) for name in names]


class Goals(Suite):
    """From goal to goal through buildings: every cell of Table II on drawn floor plans, and on given ones."""

    accepted_options = ("episodes", "maps")

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return five cases for the drawn floor plans and five for those that were given.

        Raises:
            UserError: There is no such floor plan.
        """
        plans = {"drawn": list(DRAWN)}
        if options.maps:
            plans[Path(options.maps[0]).stem if len(options.maps) == 1 else GIVEN] = list(options.maps)
        result = []
        for name, files in plans.items():
            common: dict[str, Any] = {"inputs": " ".join(load_plan(file).digest for file in files)}
            common |= {"physics": usual_physics(), "table": f"{self.name} {name}", "shares": name}
            for people, goals in CELLS:
                scenario = Spec("goals", {"map": files, "people": people, "goals": goals, "pool": POOL})
                where = {"map": name, "people": str(people), "goals": str(goals)}
                common["effort"] = people * goals
                result.append(
                    self.case(options, f"{name} {people}/{goals}", scenario, EPISODES, where, **common)
                )
        return result


class Indoor(Suite):
    """What people do indoors: they wait, queue, walk in groups, and pass each other in corridors."""

    accepted_options = ("episodes",)
    columns = (
        *("success", "deadlock", "agent_contacts_per_min", "wall_contacts_per_min", "time_s"),
        *("speed_m_per_s", "standing_drift_m", "company_share", "lane_order"),
    )
    legend: ClassVar[dict[str, str]] = {
        "company_share": "share of steps with a companion: a person within 1.5 m in the last 8 steps, whose "
        "relative place changed by less than 0.5 m",
        "lane_order": "lanes along x in strips of 0.6 m: 0 as in a mixed crowd, 1 if no strip has both ways",
    }

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each of four scenarios, with its defaults."""
        names = ("waiting", "queue", "groups", "two_way")
        cases = (self.case(options, name, name, EPISODES, {"scenario": name}, effort=10.0) for name in names)
        return [case._replace(table=f"{self.name} {case.name}") for case in cases]

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return company and lanes."""
        people, axis = rollout.mask.shape[1], torch.tensor([1.0, 0.0])
        episodes = (rollout.episodes(slice(one, one + 1)) for one in range(len(rollout.failed)))
        each = [measured(every_step(episode), people, axis) for episode in episodes]
        sums = {name: torch.stack([one[name].sum(1) for one in each]) for name in self.legend}
        return {name: Ratio(both[:, 0], both[:, 1]) for name, both in sums.items()}


class Queues(Suite):
    """Every number of people at every door: whether all get through, how fast, and how they wait."""

    accepted_options = ("episodes",)
    headline = ("all_through", "specific_flow_per_m_s")
    columns = (
        *("through", "all_through", "success", "failed", "agent_contact_episodes", "wall_contact_episodes"),
        *("specific_flow_per_m_s", "headway_p05_s", "headway_p50_s", "headway_p95_s", "wall_drift_m"),
        *("sharp_turns", "intervention_share", "intervention_m"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each width and each number of people, who leave a room by its only door."""
        result = []
        for people, width in product((20, 75, 150), (0.5, 0.7, 0.85, 1.2, 2.0)):
            scenario = f"room_exit:people={people},entering=0,width={width:g}"
            where = {"people": str(people), "width": f"{width:g}"}
            # metres: less than half of the narrowest door
            common: dict[str, Any] = {"clearance": 0.2, "table": f"{self.name} of {people}"}
            name, common["effort"] = f"{people} at {width:g} m", float(people**2)
            result.append(self.case(options, name, scenario, EPISODES, where, **common))
        return result
