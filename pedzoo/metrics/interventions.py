"""How much a safety layer does, for policies that have one: it should be their last resort.

A step is what a person walks from one decision to the next. What the policy asked for counts as far as the
person's top speed allows it.
"""

import torch

from pedzoo.metrics.ratios import Ratio, mean, metric, ratio
from pedzoo.sim.rollout import Rollout

NOTICED = 0.02
"""Metres by which a step is changed at least."""


def _nothing(rollout: Rollout) -> Ratio:
    return ratio(torch.zeros(len(rollout.failed)), torch.zeros(len(rollout.failed)))


@metric()
def intervention_share(rollout: Rollout) -> Ratio:
    """Share of people's steps that the safety layer changes by more than 2 cm."""
    if rollout.changed is None:
        return _nothing(rollout)
    return mean(rollout.changed > NOTICED, rollout.scored)


@metric()
def intervention_m(rollout: Rollout) -> Ratio:
    """Metres by which the safety layer changes a step, mean over all steps of people."""
    if rollout.changed is None:
        return _nothing(rollout)
    return mean(rollout.changed, rollout.scored)
