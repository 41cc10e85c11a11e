"""How well people hold the places where they wait."""

import torch

from pedzoo.core.types import GOAL_RADIUS
from pedzoo.metrics.ratios import Ratio, mean, metric
from pedzoo.sim.rollout import Rollout


@metric("ordinary")
def standing_drift_m(rollout: Rollout) -> Ratio:
    """Greatest distance from the place where a person waits when the episode begins, mean over people.

    It counts until they get another goal. People wait whose way to their first goal has no length.
    """
    place = rollout.goal[:, :, :1]
    there = ((rollout.goal == place).all(-1) & rollout.controlled).cummin(2).values
    off = (rollout.trace - place).norm(dim=-1).where(there, torch.zeros(()))
    waits = rollout.mask & (rollout.first_path_length < GOAL_RADIUS) & there[..., 0]
    return mean(off.amax(2), waits)
