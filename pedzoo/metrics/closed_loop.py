"""All closed-loop metrics of a rollout, each as a ratio of two sums over episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor
from torchmetrics import Metric

from pedzoo.metrics.intervals import Interval, bootstrap, wilson
from pedzoo.metrics.navigation import deadlocked, episode_seconds, finish_seconds, success
from pedzoo.metrics.rollout import Rollout
from pedzoo.metrics.safety import contact_events, least_distance, person_minutes

NAMES = (
    *("success", "episode_success", "failed", "deadlock"),
    *("goals_per_person", "goals_per_person_min"),
    *("agent_contact_episodes", "wall_contact_episodes", "agent_contacts_per_min", "wall_contacts_per_min"),
    *("least_distance_m", "time_s", "decisions"),
)
"""Every metric there is, in the order of tables."""


class Ratio(NamedTuple):
    """A metric: ``above.sum() / below.sum()``; episodes about which it says nothing have 0 in both.

    Attributes:
        above: Of each episode (E,) float64.
        below: Likewise: how many episodes, people, frames, ... the sum above is over.
        share: Whether it is a share of episodes or people.
    """

    above: Tensor
    below: Tensor
    share: bool = False


def closed_loop(rollout: Rollout, decision_dt: float) -> dict[str, Ratio]:
    """Return every metric that applies to a rollout, by its name, those of `NAMES` in their order.

    Args:
        rollout: Some episodes.
        decision_dt: Seconds between two decisions of the policy.
    """
    mask, reached, goals = rollout.mask, rollout.reached, rollout.goals
    there = mask.sum(1)
    one = torch.ones(len(mask))
    arrived = success(reached, goals, rollout.late, rollout.failed, mask)
    seconds = finish_seconds(reached, goals)
    stuck = deadlocked(rollout.trace, rollout.goal, rollout.controlled)
    walked = reached[..., -1].where(mask, 0)
    fewest = walked.masked_fill(~mask, int(walked.max())).amin(1)
    agents, walls = contact_events(rollout.agent_contact), contact_events(rollout.wall_contact)
    minutes = person_minutes(rollout.controlled).sum(1)
    nearest = least_distance(rollout.trace, rollout.present).amin(1)
    time = episode_seconds(seconds, arrived, mask)
    found = {
        "success": _share(arrived.sum(1), there),
        "episode_success": _share((arrived | ~mask).all(1) & ~rollout.failed, one),
        "failed": _share(rollout.failed, one),
        "deadlock": _share(stuck.sum(1), there),
        "goals_per_person": _ratio(walked.sum(1), there),
        "goals_per_person_min": _ratio(fewest, one),
        "agent_contact_episodes": _share((agents > 0).any(1), one),
        "wall_contact_episodes": _share((walls > 0).any(1), one),
        "agent_contacts_per_min": _ratio(agents.sum(1), minutes),
        "wall_contacts_per_min": _ratio(walls.sum(1), minutes),
        "least_distance_m": _finite(nearest),
        "time_s": _finite(time),
        "decisions": _finite((time / decision_dt - 1e-6).ceil()),
    }
    return {name: found[name] for name in NAMES if name in found}


def summarised(ratios: Mapping[str, Ratio]) -> tuple[dict[str, float], dict[str, Interval]]:
    """Return the values of metrics and their 95 % intervals over episodes.

    A metric about which no episode says anything is in neither; one about which all say the same has no
    interval, unless it is a share: a bootstrap knows nothing then.
    """
    metrics: dict[str, float] = {}
    intervals: dict[str, Interval] = {}
    for name, (above, below, share) in ratios.items():
        if not float(below.sum()) > 0:
            continue  # nobody arrived, nobody met, nobody walked
        metrics[name] = float(above.sum() / below.sum())
        trials = int((below > 0).sum())
        interval = wilson(metrics[name], trials) if share else bootstrap(above, below)
        if interval[0] < interval[1]:
            intervals[name] = interval
    return metrics, intervals


class ClosedLoopScore(Metric):
    """All closed-loop metrics over any number of rollouts; sums in float64, added over processes."""

    full_state_update = False
    above: Tensor
    below: Tensor

    def __init__(self) -> None:
        """Nothing to set."""
        super().__init__()
        for state in ("above", "below"):
            self.add_state(state, torch.zeros(len(NAMES), dtype=torch.float64), dist_reduce_fx="sum")

    def update(self, rollout: Rollout, decision_dt: float) -> None:
        """Add episodes whose policy decided every ``decision_dt`` seconds."""
        for name, ratio in closed_loop(rollout, decision_dt).items():
            self.above[NAMES.index(name)] += ratio.above.sum()
            self.below[NAMES.index(name)] += ratio.below.sum()

    def compute(self) -> dict[str, Tensor]:
        """Return every metric about which an episode said something, as `NAMES` orders them."""
        values = (self.above / self.below).unbind()
        known = (self.below > 0).tolist()
        return {name: value for name, value, is_known in zip(NAMES, values, known, strict=True) if is_known}


def _ratio(above: Tensor, below: Tensor) -> Ratio:
    return Ratio(above.double(), below.double())


def _share(above: Tensor, below: Tensor) -> Ratio:
    return Ratio(above.double(), below.double(), share=True)


def _finite(value: Tensor) -> Ratio:
    """Return the mean of the finite values (E,)."""
    known = value.isfinite()
    return _ratio(value.where(known, 0.0), known)
