"""From what happened step by step to the rollout that metrics read, for policies and recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from pedzoo.core.randomness import Draws
from pedzoo.core.types import STEP_SECONDS
from pedzoo.sim.rollout import OVER_TIME, Rollout
from pedzoo.sim.scenario_parts.scenario import Scenario
from pedzoo.sim.state import State


def rollout_of(
    scenario: Scenario,
    start: State,
    steps: Sequence[Mapping[str, Tensor]],
    overdue: Tensor,
    failed: Tensor,
    decision_dt: float = STEP_SECONDS,
) -> Rollout:
    """Return the rollout of scenes that began in a state.

    Args:
        scenario: Where they are from.
        start: How they began.
        steps: What has a value for every trace point, piece by piece (E, A, S, ...).
        overdue: Which agents did not reach a goal in time (E, A) bool.
        failed: In which the policy gave no number (E,) bool.
        decision_dt: Seconds between two decisions.
    """
    return Rollout(
        **{key: torch.cat([step[key] for step in steps], dim=2) for key in OVER_TIME},
        overdue=overdue,
        failed=failed,
        mask=start.mask,
        past=start.past,
        pref_speed=start.pref_speed,
        first_path_length=start.remaining_path,
        radius=start.radius,
        kind=start.kind,
        map_id=start.map_id,
        pose=start.pose,
        goals=scenario.goals,
        gate=scenario.gate(Draws(start.key)),
        decision_dt=decision_dt,
    )
