"""How alike the walks of two crowds are: distances of distributions through which gradients flow.

The features are those by which the suite ``replay`` judges a crowd (`pedzoo.metrics.realism.features`), of
every step of 0.4 s, and so is the distance: Wasserstein-1, in units of how much recorded people differ.
"""

from typing import NamedTuple, cast

import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core.batch import agents_of, goals_of
from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.contacts import HORIZON, collision_seconds
from pedzoo.metrics.realism.features import LINE
from pedzoo.metrics.smoothness import STANDS
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

_GRAZING = 1e-3
"""m^4/s^2: below, when two people touch changes too fast for a gradient."""


class _Others(NamedTuple):
    """The others that matter to the M people of scored steps.

    Attributes:
        nearest: The nearest other, number of the place (M,) long.
        first: The other that they touch first if all keep their velocities (M,) long.
        seconds: When that is (M,), at most 10 s.
        company: Which people are not alone (M,) bool.
    """

    nearest: Tensor
    first: Tensor
    seconds: Tensor
    company: Tensor


def features(walk: Unrolled, batch: TensorDict) -> dict[str, Tensor]:
    """Return the values (M,) of every feature, of all steps in which a person ``walked`` and has it.

    Defined as in `pedzoo.metrics.realism.features.features`; lines begin where the windows' observed part
    ends. A time to a collision has a gradient where it is above 0 and below 10 s.
    """
    agents = agents_of(batch)
    steps, people = walk.walked.shape[2], walk.walked.shape[1]
    begin, end = agents["history"][:, :, -1], goals_of(batch, "walking on")[0]
    # all that is there at once stands together: (B, N, A)
    xy, walked = walk.xy.transpose(1, 2), walk.walked.transpose(1, 2)
    velocity = torch.cat((begin.unsqueeze(1), xy), 1).diff(dim=1) / STEP_SECONDS
    earlier = torch.cat((agents["velocity"].unsqueeze(1), velocity[:, :-1]), 1)
    radius = cast("Tensor", agents["radius"])[..., 0].unsqueeze(1).expand(walked.shape)
    own = walked.flatten().nonzero()[:, 0]
    others = _others(xy.detach(), velocity.detach(), walk.present.transpose(1, 2), radius, own)
    xy, velocity, earlier = (values.reshape(-1, 2) for values in (xy, velocity, earlier))
    now, before = velocity[own], earlier[own]
    some = others.company.nonzero()[:, 0]
    near = xy[others.nearest[some]] - xy[own[some]]
    meets = (others.company & (others.seconds > 0) & (others.seconds < HORIZON)).nonzero()[:, 0]
    me, them = own[meets], others.first[meets]
    bodies = radius.flatten()
    meeting = xy[them] - xy[me], velocity[them] - velocity[me], bodies[them] + bodies[me]
    soon = others.seconds.index_put((meets,), _touch(*meeting))
    person = own // (steps * people) * people + own % people
    return {
        "speed": _length(now),
        "acceleration": _length(now - before) / STEP_SECONDS,
        "heading_rate": turns(before, now) / STEP_SECONDS,
        "nearest_distance": _length(near),
        "time_to_collision": soon[some],
        "lateral_deviation": _aside(xy[own], *(of.reshape(-1, 2)[person] for of in (begin, end))),
    }


def wasserstein(first: Tensor, second: Tensor) -> Tensor:
    """Return the Wasserstein-1 distance of two sets of values (M,) and (L,); 0 if one is empty.

    The mean distance of the two sorted, each value repeated until both are equally many: the area between the
    two inverse distribution functions (Villani, "Optimal Transport", 2009, 2.18).
    """
    m, n = len(first), len(second)
    if not m or not n:
        return first.sum() * 0 + second.sum() * 0
    first, second = first.sort().values, second.sort().values
    if m == n:
        return (first - second).abs().mean()
    # in units of 1 / (m n): where either distribution function has a step
    ends = torch.cat((torch.arange(1, m + 1) * n, torch.arange(1, n) * m)).to(first.device).sort().values
    widths = ends.diff(prepend=ends.new_zeros(1))
    begins = ends - widths
    gap = first[begins // n] - second[begins // m]
    return (gap.abs() * widths).sum() / (m * n)


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


def _others(xy: Tensor, velocity: Tensor, present: Tensor, radius: Tensor, own: Tensor) -> _Others:
    """Return the others that matter to people; no gradient flows through this choice.

    Positions and velocities are (B, N, A, 2); ``own`` (M,) are the numbers in (B, N, A) of those asked about.
    """
    people = present.shape[2]
    moment, slot = own // people, own % people
    columns = [value.flatten(0, 1)[moment] for value in (*xy.unbind(-1), *velocity.unbind(-1))]
    x, y, vx, vy = (value - value.gather(1, slot.unsqueeze(1)) for value in columns)
    absent = ~present.flatten(0, 1)[moment].scatter(1, slot.unsqueeze(1), False)
    apart, nearest = x.square().addcmul_(y, y).masked_fill_(absent, torch.inf).min(1)
    bodies = radius.flatten(0, 1)[moment]
    reach = bodies + bodies.gather(1, slot.unsqueeze(1))
    when = collision_seconds(x, y, vx, vy, reach).masked_fill_(absent, HORIZON)
    seconds, first = when.min(1)
    base = moment * people
    return _Others(base + nearest, base + first, seconds, apart.isfinite())


def _touch(away: Tensor, velocity: Tensor, reach: Tensor) -> Tensor:
    """Return when pairs (L,) that will touch do so, ``away`` from each other with a relative ``velocity``."""
    closing = -(away * velocity).sum(-1)
    gap = away.square().sum(-1) - reach.square()
    under = closing.square() - velocity.square().sum(-1) * gap
    return gap / (under.clamp_min(_GRAZING).sqrt() + closing)


def turns(before: Tensor, now: Tensor) -> Tensor:
    """Return by how much headings turn, radians, of velocities (M, 2) that both have one."""
    walks = (before.detach().norm(dim=1) > STANDS) & (now.detach().norm(dim=1) > STANDS)
    before, now = before[walks], now[walks]
    across = before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]
    return torch.atan2(across.abs(), (before * now).sum(1))


def _aside(xy: Tensor, begin: Tensor, end: Tensor) -> Tensor:
    """Return how far to the left of their lines people (M, 2) with a line are, metres."""
    line = end - begin
    length = line.norm(dim=1)
    has = length >= LINE
    along, offset = line[has] / length[has].unsqueeze(1), (xy - begin)[has]
    return along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]


def _length(vectors: Tensor) -> Tensor:
    """Return the lengths (M,) of vectors (M, 2), with a gradient of at most 1 everywhere."""
    return vectors.square().sum(1).clamp_min(1e-12).sqrt()
