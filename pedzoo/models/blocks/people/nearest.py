"""The nearest others of each person, one row each, and which of them are companions."""

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.geometry import unrotate
from pedzoo.core.types import BODY_RADIUS, STEP_SECONDS
from pedzoo.models.blocks.people.crowd import REACH, share_seen

NEAREST, FEATURES = 6, 12
"""Nearest others of a person that a network sees, and numbers of each of them."""

_FAR, _SOON = REACH**2, 5.0
"""Square metres: farther agents are not there. And seconds within which two may come close."""

_STAYS, _BESIDE = 0.35, 1.3
"""Metres by which a companion's place beside a person changes in 2.8 s, and how far away it is."""

_COMPANIONS, _REACH = 3, 3.0
"""Nearest companions of a person that a network sees, and metres: farther ones count as so far away."""


class Neighbours(NamedTuple):
    """The k nearest others of B x A people, in the frame of each person's way."""

    features: Tensor  # relative place and velocity, and those of the closest approach (B, A, k, 12)
    absent: Tensor  # where there are fewer than k (B, A, k) bool
    share: Tensor  # how much each counts (B, A, k), see `share_seen`; 0 where absent
    other: Tensor  # their slots (B, A, k) long
    place: Tensor  # mean place of companions (B, A, 2), metres from the person; 0 without any
    velocity: Tensor  # their mean velocity (B, A, 2) against the person's, m/s
    company: Tensor  # how many they are (B, A, 1), at most 1 each; they need not be among the k


def nearest(
    history: Tensor, mask: Tensor, radius: Tensor, ahead: Tensor, companions: Tensor | None = None
) -> Neighbours:
    """Return the nearest others of all agents.

    The order of the agents does not matter, unless distances are equal.

    Args:
        history: Positions (B, A, T, 2), metres, 0.4 s apart.
        mask: Which agents are there (B, A) bool.
        radius: Radii of bodies (B, A), metres: those of large bodies are seen as nearer.
        ahead: Unit vectors of the ways (B, A, 2).
        companions: Which agents walk in company (B, A, A) bool; None to guess it from how they walk.
    """
    here, before = history[:, :, -1], history[:, :, 0]
    velocity = (here - history[:, :, -2]) / STEP_SECONDS
    people = mask.shape[1]
    with torch.no_grad():
        away = here.unsqueeze(1) - here.unsqueeze(2)
        absent = ~mask.unsqueeze(1) | torch.eye(people, dtype=torch.bool, device=mask.device)
        apart = away.square().sum(-1).masked_fill(absent, _FAR)
        squared, other = apart.topk(min(NEAREST, people), 2, largest=False)
        absent = squared >= _FAR

    def of_others(values: Tensor, other: Tensor = other) -> Tensor:
        return of_slots(values, other) - values.unsqueeze(2)

    place, moves = of_others(here), of_others(velocity)
    centre = (place.square().sum(-1) + 1e-6).sqrt()
    bodies = of_slots(radius, other) + radius.unsqueeze(2) - 2 * BODY_RADIUS
    distance = (centre - bodies).clamp_min(0.05)
    closing = -(place * moves).sum(-1) / moves.square().sum(-1).clamp_min(0.01)
    soon = closing.clamp(0, _SOON)
    closest = place + moves * soon.unsqueeze(-1)
    miss = ((closest.square().sum(-1) + 1e-6).sqrt() - bodies).clamp_min(0.0)
    frame = ahead.unsqueeze(2)
    turned, moving = unrotate(place, frame), unrotate(moves, frame)
    vectors = turned / centre.unsqueeze(-1), turned / 4, moving / 1.5, unrotate(closest, frame) / 2
    close = 1 / (distance + 0.3), (-distance / 1.5).exp(), (-soon / 2).exp(), (-miss / 0.5).exp()
    features = torch.cat((*vectors, torch.stack(close, -1)), -1)
    if companions is None:
        changed = ((place - of_others(before)).square().sum(-1) + 1e-6).sqrt()
        weight = (-changed / _STAYS - (centre / _BESIDE).square()).exp().masked_fill(absent, 0.0)
    else:
        with torch.no_grad():
            squared, mate = apart.masked_fill(~companions, _FAR).topk(
                min(_COMPANIONS, people), 2, largest=False
            )
        turned, moving = (unrotate(of_others(values, mate), frame) for values in (here, velocity))
        weight = share_seen(turned).masked_fill(squared >= _FAR, 0.0)
        length = (turned.square().sum(-1, keepdim=True) + 1e-6).sqrt()
        turned = turned * (_REACH / length.clamp_min(_REACH))
    weight = weight.unsqueeze(-1)
    company = weight.sum(2)
    part = weight / company.unsqueeze(2).clamp_min(0.1)
    seen = features, absent, share_seen(place).masked_fill(absent, 0.0), other
    return Neighbours(*seen, (part * turned).sum(2), (part * moving).sum(2), company)


def of_slots(values: Tensor, other: Tensor) -> Tensor:
    """Return values (B, A, ...) of the agents in slots ``other`` (B, A, k): (B, A, k, ...)."""
    scene = torch.arange(len(other), device=other.device).view(-1, 1, 1)
    return values[scene, other]
