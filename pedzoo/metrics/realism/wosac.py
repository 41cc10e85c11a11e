"""How likely what people really did was under many joint rollouts: WOSAC's score for pedestrians.

Montali et al., "The Waymo Open Sim Agents Challenge", NeurIPS 2023, with walls for roads and without traffic
lights. K rollouts of W windows of A people, S steps of 0.4 s. Values are (K, W, A, S), NaN where there is
none.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.realism.features import SampledRollout, surroundings
from pedzoo.metrics.smoothness import STANDS

BINS, PSEUDO_COUNT = 10, 0.1
"""Of every histogram."""

ROLLOUTS = 32
"""What a histogram holds of every window."""

WEIGHTS = {
    "agent_contact": 0.25,
    "wall_contact": 0.25,
    "nearest_distance": 0.10,
    "time_to_collision": 0.10,
    "speed": 0.05,
    "acceleration": 0.05,
    "turn_rate": 0.05,
    "turn_acceleration": 0.05,
    "wall_distance": 0.05,
}
"""WOSAC's, whose other 0.05 is the traffic light's: they are divided by their sum."""

CONTACTS = ("agent_contact", "wall_contact")
"""Happen or not, within the window."""

MEASURED = tuple(name for name in WEIGHTS if name not in CONTACTS)
"""Have a value in every step."""

Ranges = Mapping[str, tuple[float, float]]
"""Ends of the bins of each of `MEASURED`; values beyond count in the last bin."""

LogSums = tuple[Tensor, Tensor]
"""Log likelihoods of a feature: the sum over people and steps of each window, and their number (W,)."""


def step_values(steps: SampledRollout, wall: Tensor) -> dict[str, Tensor]:
    """Return the values (E, A, S) of `MEASURED` in every scored step, NaN elsewhere.

    Acceleration is the change of the speed; turns are positive to the left, of people faster than 0.1 m/s.
    ``wall``: distances to the nearest wall (E, A, S), metres, NaN without.
    """
    scored, known = steps.scored, steps.known
    speed = steps.velocity.norm(dim=3)
    around, at = surroundings(steps), scored.nonzero().unbind(1)
    nowhere = torch.full_like(speed, math.nan)
    nearest, collision = nowhere.clone(), nowhere.clone()
    nearest[at] = around.place[:, 0].norm(dim=1).where(around.company, math.nan)
    collision[at] = around.collision.where(around.company, math.nan)
    heading = torch.atan2(steps.velocity[..., 1], steps.velocity[..., 0])
    heading = heading.where(known & (speed > STANDS), math.nan)
    turn = _change(heading) * STEP_SECONDS
    turn = (torch.remainder(turn + math.pi, 2 * math.pi) - math.pi) / STEP_SECONDS
    values = {
        "nearest_distance": nearest,
        "time_to_collision": collision,
        "speed": speed,
        "acceleration": _change(speed.where(known, math.nan)),
        "turn_rate": turn,
        "turn_acceleration": _change(turn),
        "wall_distance": wall,
    }
    return {name: value.where(scored, math.nan) for name, value in values.items()}


def measured_likelihood(simulated: Tensor, true: Tensor, ends: tuple[float, float]) -> LogSums:
    """Return how likely the true values (W, A, S) are under histograms of each person's simulated ones.

    A histogram has all rollouts and steps (K, W, A, S) of one person in one window, in bins between ``ends``,
    and counts them as `ROLLOUTS` rollouts.
    """
    times = ROLLOUTS / len(simulated)
    bins, own = _bin(simulated, ends), _bin(true, ends)
    there, known = ~simulated.isnan(), ~true.isnan()
    place = torch.arange(true[..., 0].numel()).view(1, *true.shape[:2], 1) * BINS + bins
    counts = torch.bincount(place[there], minlength=true[..., 0].numel() * BINS).double() * times
    counts = counts.view(*true.shape[:2], BINS) + PSEUDO_COUNT
    log = (counts / counts.sum(2, keepdim=True)).log().gather(2, own)
    return log.where(known, 0.0).sum((1, 2)), known.sum((1, 2)).double()


def contact_likelihood(simulated: Tensor, true: Tensor, people: Tensor) -> LogSums:
    """Return how likely touches of ``people`` (W, A) bool were, true ones (W, A) by simulated (K, W, A)."""
    touches = simulated.double().mean(0) * ROLLOUTS + PSEUDO_COUNT
    share = touches / (ROLLOUTS + 2 * PSEUDO_COUNT)
    log = torch.where(true, share, 1 - share).log()
    return log.where(people, 0.0).sum(1), people.sum(1).double()


def composite(sums: Mapping[str, LogSums], weights: Tensor) -> dict[str, Tensor]:
    """Return each feature's likelihood (R,), and ``likelihood``, their weighted mean, for weights (R, W).

    A likelihood is ``exp`` of the mean of the logarithms. Features without values are out.
    """
    values = {name: (weights @ total / (weights @ count)).exp() for name, (total, count) in sums.items()}
    share = torch.tensor([WEIGHTS[name] for name in values], dtype=torch.float64).unsqueeze(1)
    each = torch.stack([*values.values()])
    known = ~each.isnan()
    whole = (each.nan_to_num() * share).sum(0) / (known * share).sum(0)
    return {"likelihood": whole, **{f"likelihood_{name}": value for name, value in values.items()}}


def _change(value: Tensor) -> Tensor:
    return torch.nn.functional.pad(value.diff(dim=2), (1, 0), value=math.nan) / STEP_SECONDS


def _bin(value: Tensor, ends: tuple[float, float]) -> Tensor:
    low, high = ends
    place = (value.nan_to_num() - low) / (high - low) * BINS
    return place.floor().clamp(0, BINS - 1).long()
