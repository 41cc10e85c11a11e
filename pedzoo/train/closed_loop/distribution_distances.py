"""How alike the walks of two crowds are: distances of distributions through which gradients flow.

The features are those by which the suite ``replay`` judges a crowd (`pedzoo.metrics.realism.features`), of
every step of 0.4 s, and so is the distance: Wasserstein-1, in units of how much recorded people differ.
"""

from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of, goals_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.realism.features import others_of, step_features
from pedzoo.train.closed_loop.unroll import Unrolled

SPREADS = {
    "speed": 0.52,
    "acceleration": 0.30,
    "heading_rate": 0.39,
    "nearest_distance": 1.52,
    "time_to_collision": 3.25,
    "lateral_deviation": 0.72,
}
"""Standard deviation of each feature in all training windows of ETH/UCY with 20 steps on the true clock;
units as in `pedzoo.metrics.realism.features.FEATURES`. Constants: where all are alone a batch has none."""


def features(walk: Unrolled, batch: TensorDict) -> dict[str, Tensor]:
    """Return the values of every feature, of all steps in which a person ``walked`` and has it.

    They are those of `pedzoo.metrics.realism.features.step_features`; lines begin where the windows' observed
    part ends. A time to a collision has a gradient where it is above 0 and below 10 s.
    """
    agents = agents_of(batch)
    begin, end = agents["history"][:, :, -1], goals_of(batch, "walking on")[0]
    # all that is there at once stands together: (B, N, A)
    xy, walked, present = (value.transpose(1, 2) for value in walk)
    velocity = torch.cat((begin.unsqueeze(1), xy), 1).diff(dim=1) / STEP_SECONDS
    earlier = torch.cat((agents["velocity"].unsqueeze(1), velocity[:, :-1]), 1)
    radius = cast("Tensor", agents["radius"])[..., 0].unsqueeze(1).expand(walked.shape)
    scene, step, slot = walked.nonzero().unbind(1)
    place, moving, there, body = (value.flatten(0, 1) for value in (xy, velocity, present, radius))
    moment = scene * xy.shape[1] + step
    around = others_of(place, moving, there, there, body, moment, slot, smooth=True)
    offset, way = xy[walked] - begin[scene, slot], (end - begin)[scene, slot]
    values = step_features(velocity[walked], earlier[walked], around, offset, way)
    return {name: value for name, (value, _) in values.items()}


def tail(first: Tensor, second: Tensor) -> Tensor:
    """Return how far the upper tails of two sets of values (M,) and (L,) differ, as a share of the second's.

    The mean over the quantiles from 90 to 99 %, of values above 0; 0 if a set is empty.
    """
    if not len(first) or not len(second):
        return first.sum() * 0 + second.sum() * 0
    ranks = torch.linspace(0.9, 0.99, 10, dtype=first.dtype, device=first.device)
    made, true = (_quantiles(values, ranks) for values in (first, second))
    return ((made - true).abs() / true.clamp_min(1e-3)).mean()


def _quantiles(values: Tensor, ranks: Tensor) -> Tensor:
    """Return quantiles; torch's own function refuses more than 16 million values."""
    place = ranks * (len(values) - 1)
    below, values = place.floor().long(), values.sort().values
    return torch.lerp(values[below], values[(below + 1).clamp_max(len(values) - 1)], place - below)
