"""The social force model for batches of scenes: each person's new velocity."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.types import BODY_RADIUS
from pedzoo.policies.nearest_agents import Neighbors, nearest
from pedzoo.policies.social_force.forces import (
    CLOSEST,
    closer,
    direction,
    driving_force,
    length,
    off_line,
    repulsion,
    smooth_weight,
    view_weight,
)
from pedzoo.policies.social_force.settings import SocialForceSettings

LONGEST_STEP = 0.1
"""Seconds: longer decisions are integrated in equal parts. Near walls the forces change within 0.2 s."""


def social_force_velocity(
    position: Tensor,
    velocity: Tensor,
    desired_velocity: Tensor,
    pref_speed: Tensor,
    mask: Tensor,
    settings: SocialForceSettings,
    seconds: float,
    identity: Tensor,
    walls: Callable[[Tensor, Tensor | None], Tensor] | None = None,
    fluctuation: Tensor | None = None,
    radius: Tensor | None = None,
) -> Tensor:
    """Return the velocities (B, A, 2) that the forces lead to after ``seconds``, m/s; 0 for absent people.

    Differentiable with respect to positions, velocities, desired velocities and speeds. ``velocity`` is the
    one walked (eq. 10 keeps another, not cut off at the top speed).

    Args:
        position: Positions (B, A, 2), metres.
        velocity: Current velocities (B, A, 2), m/s.
        desired_velocity: Only the direction counts (B, A, 2); 0: to stand still.
        pref_speed: Preferred speeds (B, A), m/s.
        mask: Which people are present (B, A) bool: they act on the others and get a velocity.
        settings: The model's parameters.
        seconds: For which the velocities are held.
        identity: A number of its own for each person (B, A) long: people at the same place are pushed apart
            in a direction drawn by both.
        walls: Gives the walls' forces (2, N) on people at places (2, N), ``rows`` (N,) of all B * A; None:
            no walls.
        fluctuation: A further acceleration (B, A, 2), m/s^2.
        radius: Radii of the bodies (B, A), metres, None for `BODY_RADIUS`. Forces are those between people
            of that radius, at the distance less what both are wider.
    """
    wider = torch.zeros_like(pref_speed) if radius is None else radius - BODY_RADIUS
    rows = None if mask.all() else mask.flatten().nonzero()[:, 0]
    if rows is not None:  # placeholders of absent people
        position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
    others = nearest(position, mask, settings.neighbor_dist, settings.max_neighbors, rows)
    place, speed = (part.flatten(0, 1).T.contiguous() for part in (position, velocity))
    heading = direction(_of(desired_velocity.flatten(0, 1).T, rows))
    liked = _of(pref_speed.flatten()[None], rows)
    top_speed, desired = liked * settings.top_speed_ratio, liked * heading
    parts = max(1, math.ceil(seconds / LONGEST_STEP - 1e-6))
    for part in range(parts):
        own_place, own_speed = _of(place, rows), _of(speed, rows)
        force = driving_force(own_speed, desired, settings.tau)
        if len(others.index):
            force = force + _people(
                place, speed, heading, others, rows, identity.flatten(), wider.flatten(), settings
            )
        if walls is not None:
            force = force + walls(own_place, rows)
        if fluctuation is not None:
            force = force + _of(fluctuation.flatten(0, 1).T, rows)
        own_speed = own_speed + force * (seconds / parts)
        own_speed = own_speed * (top_speed / length(own_speed, 1e-6)).clamp_max(1)
        speed = own_speed if rows is None else speed.index_copy(1, rows, own_speed)
        if part + 1 < parts:
            place = place + speed * (seconds / parts)
    speed = speed.T.reshape(position.shape)
    return speed if rows is None else torch.where(mask[..., None], speed, 0)


def _of(values: Tensor, rows: Tensor | None) -> Tensor:
    return values if rows is None else values.index_select(1, rows)


def _people(
    place: Tensor,
    speed: Tensor,
    heading: Tensor,
    others: Neighbors,
    rows: Tensor | None,
    identity: Tensor,
    wider: Tensor,
    settings: SocialForceSettings,
) -> Tensor:
    """Return the sum of the others' forces (2, N)."""
    index, near = others
    theirs = torch.cat((place, speed * settings.step_time))
    theirs = theirs.index_select(1, index.flatten()).view(4, *index.shape)
    offset = _of(place, rows).unsqueeze(1) - theirs[:2]
    together = (offset == 0).all(0)
    together = together if near is None else together & near
    if bool(together.any()):
        offset = offset + _apart(together, index, rows, identity, offset.dtype)
    offset = off_line(offset, heading)
    more = wider.index_select(0, index.flatten()).view(index.shape) + _of(wider[None], rows)
    offset = closer(offset, more)
    force, away = repulsion(offset, theirs[2:], settings.strength, settings.sigma)
    if settings.anisotropy == "view":
        force = force * view_weight(away, heading, settings.view_angle, settings.out_of_view)
    elif settings.anisotropy == "smooth":
        force = force * smooth_weight(offset, heading, settings.behind)
    if near is not None:
        force = force * near
    # one after the other: a sum's rounding would depend on how many people there are in other scenes
    return (force * away).cumsum(1)[:, -1]


def _apart(
    together: Tensor, index: Tensor, rows: Tensor | None, identity: Tensor, dtype: torch.dtype
) -> Tensor:
    """Return offsets (2, K, N) for people at the same place: `CLOSEST` long, opposite for both of a pair."""
    other, own = together.nonzero(as_tuple=True)
    theirs = identity[index[other, own]]
    mine = identity[own if rows is None else rows[own]]
    key = randomness.join(torch.minimum(mine, theirs), "apart", torch.maximum(mine, theirs))
    angle = 2 * math.pi * randomness.uniform(key)
    way = CLOSEST * torch.stack((angle.cos(), angle.sin())) * torch.where(mine < theirs, 1, -1)
    offset = torch.zeros(2, *together.shape, dtype=dtype, device=together.device)
    offset[:, other, own] = way.to(dtype)
    return offset
