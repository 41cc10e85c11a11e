"""What people do indoors: they wait, queue, walk in groups, and pass each other in corridors."""

from typing import ClassVar

import torch

from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite
from pedzoo.metrics.ratios import Ratio
from pedzoo.metrics.realism.crowds import PersonSums, measured
from pedzoo.metrics.realism.features import every_step
from pedzoo.sim.rollout import Rollout

EPISODES = 20

SCENARIOS = ("waiting", "queue", "groups", "two_way")

MEASURES = ("company_share", "lane_order")


class Indoor(Suite):
    """One case for each of four scenarios, with its defaults."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)
    columns: ClassVar[tuple[str, ...]] = (
        "success",
        "deadlock",
        "agent_contacts_per_min",
        "wall_contacts_per_min",
        "time_s",
        "speed_m_per_s",
        "standing_drift_m",
        *MEASURES,
    )
    legend: ClassVar[dict[str, str]] = {
        "company_share": "share of steps with a companion: a person within 1.5 m in the last 8 steps, whose "
        "relative place changed by less than 0.5 m",
        "lane_order": "lanes along x in strips of 0.6 m: 0 as in a mixed crowd, 1 if no strip has both ways",
    }

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return a case for each scenario."""
        effort, table = 10.0, f"{self.name} {{}}".format
        return [
            self.case(options, name, name, EPISODES, {"scenario": name}, effort=effort, table=table(name))
            for name in SCENARIOS
        ]

    def more(self, rollout: Rollout) -> dict[str, Ratio]:
        """Return company and lanes."""
        people, axis = rollout.mask.shape[1], torch.tensor([1.0, 0.0])
        each: dict[str, list[PersonSums]] = {name: [] for name in MEASURES}
        for episode in range(len(rollout.failed)):
            steps = every_step(rollout.episodes(slice(episode, episode + 1)))
            values = measured(steps, people, axis)
            for name in MEASURES:
                each[name].append(values[name])
        result = {}
        for name, values in each.items():
            above, below = (torch.stack(sums).sum(1) for sums in zip(*values, strict=True))
            result[name] = Ratio(above, below)
        return result
