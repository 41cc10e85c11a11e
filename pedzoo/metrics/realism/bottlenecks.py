"""How people come through an opening: how many, how fast, and one how long after the other."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.metrics.door import flow
from pedzoo.metrics.realism.crowdes import ScoredSteps

HEADWAYS = {"p5": 0.05, "p50": 0.5, "p95": 0.95}
"""Quantiles of the time between two who follow each other."""


def through(walks: ScoredSteps, opening: Tensor) -> dict[str, float]:
    """Return how people pass an opening, of several rounds the means; flow and headways of two and more.

    * ``opening_through_share``: share of the scored people who end up on the other side: an odd number of
      crossings. Without it flow says nothing, since it is of those who got out.
    * ``specific_flow_per_m_s``: as of rollouts, see `pedzoo.metrics.door.flow`.
    * ``opening_headway_p5_s``, ``_p50_s``, ``_p95_s``: quantiles of the times between two in a row.

    Args:
        walks: Scored steps; people who leave have to be seen behind the opening.
        opening: Centre x and y, unit normal x and y of its wall, clear width (5,); metres.
    """
    rounds = []
    for number in walks.round.unique().tolist():
        mine = ScoredSteps(*(value[walks.round == number] for value in walks))
        rounds.append(_through(mine.person, mine.frame, mine.xy, opening))
    names = dict.fromkeys(name for one in rounds for name in one)
    return {name: sum(one[name] for one in rounds if name in one) / len(rounds) for name in names}


def _through(person: Tensor, frame: Tensor, xy: Tensor, opening: Tensor) -> dict[str, float]:
    people, who = person.unique(return_inverse=True)
    order = torch.argsort(who * (int(frame.max()) + 1) + frame)
    who, frame, off = who[order], frame[order].double(), xy[order].double() - opening[:2]
    ahead = off @ opening[2:4].double()
    beside = off[:, 1] * opening[2] - off[:, 0] * opening[3]
    crossed = (ahead[1:] >= 0) != (ahead[:-1] >= 0)
    at = ahead[:-1] / (ahead[:-1] - ahead[1:])  # share of the step that is before the line
    between = (beside[:-1] + at * beside.diff()).abs()
    crossed &= (who[1:] == who[:-1]) & (between <= opening[4] / 2)
    count = torch.bincount(who[1:][crossed], minlength=len(people))
    last = torch.full((len(people),), -torch.inf, dtype=torch.float64)
    when = (frame[:-1] + at * frame.diff())[crossed] * STEP_SECONDS
    last.scatter_reduce_(0, who[1:][crossed], when, "amax")
    passed = last[count % 2 == 1].sort().values
    result = {"opening_through_share": len(passed) / len(people)}
    if len(passed) > 1 and passed[-1] > passed[0]:
        number, room = flow(passed.unsqueeze(0), opening.unsqueeze(0))
        result["specific_flow_per_m_s"] = float(number / room)
        for name, share in HEADWAYS.items():
            result[f"opening_headway_{name}_s"] = float(passed.diff().quantile(share))
    return result
