"""What a model's noise changes: the same scenes are walked with several draws of it.

A policy without noise would walk every scene alike: it has no rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from pedzoo.eval.rollout import joined, prepare, walk
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, ShareDone, Suite, WorkUnit, prepared
from pedzoo.metrics.closed_loop import closed_loop
from pedzoo.metrics.ratios import Ratio, ratio, summarised
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise, walkers
from pedzoo.sim.rollout import Rollout
from tools.paper.choices import first_through, passing_side, varied
from tools.paper.suites.loop_doors import DOORWAYS

DRAWS = 10
"""Of the noise, for each scene."""

EPISODES = 200

ALSO = ("clean", "contact_free", "episode_success")
"""What says whether variety costs safety."""


class Choice(NamedTuple):
    """Something that two people settle between them.

    Attributes:
        scenario: Where.
        settled: Which way, of a rollout (E,) float64: 0 or 1, NaN where they did not settle it.
    """

    scenario: str
    settled: Callable[[Rollout], Tensor]


CHOICES = {
    "who goes first": Choice(DOORWAYS["hard"].scenario, first_through),
    "passing side": Choice("hallway:width=[2.0,2.5,3.0],aside=0.2,delay=0.5", passing_side),
}
"""At the hard door of `tools.paper.suites.loop_doors`, and nearly head-on in a corridor."""


class LoopNoise(Suite):
    """One case for each choice."""

    accepted_options: ClassVar[tuple[str, ...]] = ("episodes",)
    counted: ClassVar[str] = "scenes"
    headline: ClassVar[tuple[str, ...]] = ("varied",)
    columns: ClassVar[tuple[str, ...]] = ("varied", "disagreement", "settled", *ALSO)

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return the cases."""
        return [
            EvaluationCase(
                suite=self.name,
                name=name,
                scenario=choice.scenario,
                physics=options.physics or "compiled",
                episodes=options.number(EPISODES),
                case={"choice": name},
                effort=2.0 * DRAWS,
                table=f"{self.name} {name}",
            )
            for name, choice in CHOICES.items()
        ]

    def units(
        self, case: EvaluationCase, policies: Any, seeds: tuple[int, ...], deterministic: bool
    ) -> list[WorkUnit]:
        """Return the work on a case, of policies that have noise."""
        noisy = [] if deterministic else [name for name in policies if has_noise(load_policy(name))]
        return super().units(case, noisy, seeds, deterministic)

    def rows(self, unit: WorkUnit, tell: ShareDone | None = None) -> list[dict[str, Any]]:
        """Walk one unit, ``n`` scenes with `DRAWS` draws of noise each.

        * ``varied``: share of scenes in which not all draws that settle the choice settle it the same way.
        * ``disagreement``: mean over scenes of the share of pairs of draws that settle it in different ways:
          0.5 where each way is as likely as the other, however many draws there are.
        * ``settled``: share of all walks in which both are through, or past each other.
        * ``clean``, ``contact_free``, ``episode_success``: of all walks; intervals over scenes.
        """
        case, choice = unit.case, CHOICES[unit.case.name]
        scenario, step = prepared(case.scenario, case.inputs), 0.0
        paths, also = [], {key: [] for key in ALSO}
        for draw in range(DRAWS):
            walked = []
            for number, seed in enumerate(unit.seeds):
                policy, env = prepare(
                    unit.walks, scenario, case.physics, case.episodes, seed, device=unit.device
                )
                for walker in walkers(policy):
                    walker.noise_seed = draw
                step = env.decision_dt
                try:
                    walked.extend(walk(policy, env, case.episodes))
                finally:
                    env.physics.close()
                if tell:
                    tell((draw + (number + 1) / len(unit.seeds)) / DRAWS)
            rollout = joined(walked)
            paths.append(choice.settled(rollout))
            result = closed_loop(rollout)
            for key in ALSO:
                also[key].append(result[key].above)
        settled = torch.stack(paths, dim=1)
        ratios: dict[str, Ratio] = varied(settled)
        for key, values in also.items():
            total = torch.stack(values, dim=1)
            ratios[key] = ratio(total, torch.ones_like(total))
        metrics, intervals = summarised(ratios)
        return [
            {
                "name": unit.policy,
                "case": {},
                "decision_dt_s": step,
                "n": len(settled),
                "draws": DRAWS,
                "metrics": metrics,
                "ci95": intervals,
                "per_agent": [],
            }
        ]
