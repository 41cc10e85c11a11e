"""Which velocities keep a person clear of the others: one half-plane for each neighbour.

Section 4 of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (ISRR 2009).
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.policies.nearest_agents import nearest
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.policies.orca.vectors import at_most, cross, dot, left, right


def agent_lines(
    position: Tensor,
    velocity: Tensor,
    radius: Tensor,
    share: Tensor,
    mask: Tensor,
    rows: Tensor | None,
    settings: OrcaSettings,
) -> Tensor:
    """Return the constraints (4, K, N) of N people from their nearest neighbours, nearest first.

    Args:
        position: Positions (B, A, 2), metres; numbers for absent people, too.
        velocity: Velocities (B, A, 2), m/s; likewise.
        radius: Radii of the disks (B, A), metres; likewise.
        share: How much of avoiding each of them is left to the others (B, A), 0.5 or 1; likewise.
        mask: Which people are present (B, A).
        rows: Which of the B * A people are asked for (N,) long; None: all.
        settings: Time step, neighbours and horizon.
    """
    neighbor, near = nearest(position, mask, settings.neighbor_dist, settings.max_neighbors, rows)
    moving = (position.flatten(0, 1).T, velocity.flatten(0, 1).T)
    agents = torch.cat((*moving, radius.flatten()[None], share.flatten()[None]))
    own = agents if rows is None else agents.index_select(1, rows)
    theirs = agents.index_select(1, neighbor.flatten()).view(6, *neighbor.shape)
    relative = theirs[:4].sub_(own[:4, None])
    place, current = relative[:2], -relative[2:]

    combined = theirs[4].add_(own[4])
    combined2 = combined * combined
    distance2 = dot(place, place)
    overlap = at_most(distance2, combined2)
    # Overlapping people are to be apart after one step, the others for the whole horizon.
    rate = (overlap * (1 / settings.dt)).add_((1 - overlap).mul_(1 / settings.time_horizon))
    w = current - rate * place
    w2, ahead = dot(w, w), dot(w, place)
    # the projection is on the round end where w points away from its centre by more than the legs' angle
    on_circle = (ahead * ahead.abs()).lt_(-combined2 * w2).maximum(overlap)

    # The nearest point of the velocity obstacle's border is on its round end, ...
    length = w2.sqrt()
    tiny = torch.finfo(length.dtype).tiny
    outward = w * length.clamp_min(tiny).reciprocal_()  # w = 0: no direction is better than another
    to_circle = (rate * combined).sub_(length) * outward
    # ... or on its left or right leg.
    leg = (distance2 - combined2).clamp_min_(0).sqrt_()
    leg.mul_(cross(place, w).gt_(0).mul_(2).sub_(1))
    side = (place * leg).add_(left(combined * place)).mul_(distance2.clamp_min(tiny).reciprocal_())
    to_leg = (dot(current, side) * side).sub_(current)

    # An agent does half of what is needed, and all of it where the other one does nothing.
    to_leg.lerp_(to_circle, on_circle).mul_(theirs[5]).add_(own[2:4, None])
    lines = torch.cat((to_leg, side.lerp_(right(outward), on_circle)))
    return lines if near is None else lines.mul_(near.to(lines.dtype))
