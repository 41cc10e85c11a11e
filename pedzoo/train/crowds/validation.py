"""Whole recordings that the training does not see, walked from begin to end, to choose checkpoints by."""

from collections.abc import Sequence

import torch
from torch import Tensor

from pedzoo.core.types import OBS_LEN
from pedzoo.maps.planning.planner import Planner
from pedzoo.metrics.realism.distances import wasserstein
from pedzoo.metrics.realism.features import FEATURES, Clips
from pedzoo.metrics.realism.two_sample import FOLDS, auc, two_sample
from pedzoo.train.crowds.comparison import CrowdFeatures, coarse, compared
from pedzoo.train.crowds.crowd_walk import CrowdWalk, Policy, recorded, walked_on
from pedzoo.train.crowds.excerpts import RecordedCrowd, excerpts

_LEAST_SPREAD = 1e-3
"""Of recorded values, where all are equal."""


@torch.no_grad()
def whole_replays(
    policy: Policy,
    crowds: Sequence[RecordedCrowd],
    planner: Planner,
    device: torch.device | str = "cpu",
) -> dict[str, float]:
    """Return how unlike the crowds are in which a policy takes all people's places, from begin to end.

    ``realism``, ``auc`` and ``auc_coarse`` as in `pedzoo score`, people of all recordings together, and
    ``unlike``, their sum. The policy is on ``device``, and walks there.
    """
    made: dict[str, list[CrowdFeatures]] = {"auc": [], "auc_coarse": []}
    true: dict[str, list[CrowdFeatures]] = {"auc": [], "auc_coarse": []}
    for number, crowd in enumerate(crowds):
        real = excerpts(crowd, [1 - OBS_LEN], crowd.frames).to(device)
        walk = walked_on(policy, real, planner, torch.tensor([number], device=device))
        for into, one in ((made, _rounded(walk)), (true, _rounded(recorded(real)))):
            into["auc"].append(compared(one, real))
            into["auc_coarse"].append(compared(coarse(one), real))
    result = {name: _area(made[name], true[name]) for name in made}
    distances = [
        wasserstein(one, other) / other.std().clamp_min(_LEAST_SPREAD)
        for name in FEATURES
        for one, other in [[_all(side["auc"], name) for side in (made, true)]]
    ]
    result["realism"] = float(torch.stack(distances).mean())
    return result | {"unlike": result["realism"] + (result["auc"] + result["auc_coarse"]) / 2}


def _rounded(walk: CrowdWalk) -> CrowdWalk:
    """Return the crowd to the millimetre: the decimals of files would distinguish crowds."""
    return walk._replace(xy=(walk.xy.double() * 1000).round().div(1000).float())


def _area(made: list[CrowdFeatures], true: list[CrowdFeatures]) -> float:
    """Return the area under the classifier's ROC curve; no person is in training and test."""
    begin = torch.tensor([0, *(one.people for one in made)]).cumsum(0).tolist()
    people = begin[-1]
    part = torch.arange(people) * 2654435761 % 2**32 % FOLDS  # of Knuth: neighbours in different parts
    sides = [
        Clips(
            torch.cat([one.clips.flatten(1) for one in side]).cpu(),
            torch.cat([one.person + first for one, first in zip(side, begin, strict=False)]).cpu(),
        )
        for side in (made, true)
    ]
    each = torch.ones(1, people)
    return float(auc(two_sample(sides[0], sides[1], part, part), each, each))


def _all(side: list[CrowdFeatures], name: str) -> Tensor:
    return torch.cat([one.features[name] for one in side])
