"""Which of two people goes first: the one who is ahead where both want to go.

People who press towards one place so have an order, by their distance from it, and the first of them is held
up by none of the others: no arch of people holds itself. Of two who wait and are equally far, as where two
groups meet, a number drawn for each decides.
"""

import torch
from torch import Tensor

LEAST_ASKED = 0.05
"""Metres: a shorter step that is asked for has less of a direction."""

AHEAD = 0.2
"""Metres ahead of another from which on precedence is full."""

TIE = 0.05
"""The same for two who wait; it is also the lead of the one with the higher rank."""

LEAD_SECONDS = 0.2
"""A person who comes forward faster than another counts as ahead by so many seconds of the difference.

So a person who stepped back for another goes on to make way, until that one is through.
"""

SPREAD = 0.04
"""Metres beyond what bodies need that people who wait keep, if they can: a crowd that has it can give way."""

LEAST_SHARE = 0.05
"""Share of a correction that a person with full precedence makes."""


@torch.no_grad()
def precedence(
    step: Tensor, away: Tensor, wait: Tensor, rank: Tensor | None, velocity: Tensor | None = None
) -> Tensor:
    """Return how clearly the first of two goes before the second (B, A, A): 1, or -1 for behind, 0: neither.

    Args:
        step: Where people want to go (B, A, 2), metres.
        away: From each to each other's place (2, B, A, A): mine less theirs, metres.
        wait: Which pairs wait, both of them (B, A, A) bool.
        rank: Numbers of the people (B, A); None for equal ones.
        velocity: Of the people (B, A, 2), m/s; None: not heeded.
    """
    step = step.movedim(-1, 0)
    toward = step / step.norm(dim=0).clamp_min(LEAST_ASKED)
    ahead = 0.5 * (away * (toward.unsqueeze(3) + toward.unsqueeze(2))).sum(0)
    if velocity is not None:
        forward = LEAD_SECONDS * (toward * velocity.movedim(-1, 0)).sum(0)
        ahead = ahead + forward.unsqueeze(2) - forward.unsqueeze(1)
    tie = 0.0 if rank is None else TIE * (rank.unsqueeze(2) - rank.unsqueeze(1)).sign()
    return torch.where(wait, (ahead + tie) / TIE, ahead / AHEAD).clamp(-1, 1)


@torch.no_grad()
def passing(step: Tensor, away: Tensor) -> Tensor:
    """Return how near the step of one leads to the place of the other (B, A, A), metres; see `precedence`.

    Infinite where it leads away.
    """
    step = step.movedim(-1, 0).unsqueeze(3)
    part = (-(away * step).sum(0) / step.square().sum(0).clamp_min(1e-9)).clamp_max(1)
    return torch.where(part > 0, (away + part * step).norm(dim=0), torch.inf)
