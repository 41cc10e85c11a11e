"""Noise that changes smoothly with time, each number at a pace of its own, by counter: nothing is kept.

A number of period p is drawn anew every p seconds, and turns from one draw into the next; its variance is 1.
One of a negative period is the second difference of numbers of every step, as white noise of places is.
"""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.types import STEP_SECONDS

_EVERY_STEP = 1.5 * STEP_SECONDS
"""Seconds: numbers of shorter periods are drawn at every step, and do not turn."""


def drawn_walks(
    now: Any,
    step: Callable[[Any, Tensor], Tensor],
    periods: tuple[float, ...],
    samples: int,
    steps: int,
    generator: torch.Generator | None,
) -> Tensor:
    """Return random futures (B, K, A, T, 2), metres per step: in each sample all people walk together.

    ``now`` is a NamedTuple of tensors (B, A, ...) with ``mask`` and ``after(step)``. ``step`` returns the
    next step (B, A, 2), metres, of one, for noise (B, A, Z).
    """
    scenes = len(now.mask)
    now = type(now)(*(value.repeat(samples, *[1] * (value.dim() - 1)) for value in now))
    key = torch.randint(2**62, (len(now.mask), 1), generator=generator).to(now.mask.device)
    agent = torch.arange(now.mask.shape[1], device=key.device).expand(now.mask.shape)
    path = []
    for number in range(steps):
        time = torch.full((len(key), 1), number * STEP_SECONDS, device=key.device)
        drawn = step(now, timed_noise(key, agent, time, periods))
        path.append(torch.where(now.mask.unsqueeze(-1), drawn, 0.0))
        now = now.after(path[-1])
    return torch.stack(path, 3).transpose(2, 3).unflatten(0, (samples, scenes)).transpose(0, 1)


def timed_noise(key: Tensor, agent: Tensor, time: Tensor, periods: tuple[float, ...]) -> Tensor:
    """Return normal noise (B, A, Z) of agents.

    Args:
        key: Of the scenes (B, 1) long.
        agent: Numbers of the agents (B, A) long.
        time: Seconds since the scenes began (B, 1).
        periods: Of each number (Z,), seconds; ``math.inf`` for one that lasts for the whole scene, and a
            negative one for second differences, divided by their standard deviation.
    """
    period = torch.tensor(periods, device=agent.device)
    lasts, short = period.isinf(), period < _EVERY_STEP
    dims = torch.arange(len(periods), device=agent.device)
    own = randomness.join(key, "timed noise", agent).unsqueeze(-1)
    own = randomness.join(own, dims)
    # agents do not all change at the same time
    place = time.unsqueeze(-1) / torch.where(lasts, 1.0, period) + randomness.uniform(own)
    step = (time / STEP_SECONDS).round().unsqueeze(-1).expand_as(place)
    place = torch.where(lasts, 0.0, torch.where(short, step, place))
    draw = place.floor()
    number = draw.long()
    turned = (place - draw) * (math.pi / 2)
    now, then = (randomness.normal(randomness.join(own, number + more)) for more in (0, 1))
    smooth = turned.cos() * now + turned.sin() * then
    if min(periods) >= 0:
        return smooth
    earlier, before = (randomness.normal(randomness.join(own, number - less)) for less in (1, 2))
    return torch.where(period < 0, (now - 2 * earlier + before) / math.sqrt(6), smooth)
