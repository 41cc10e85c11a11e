"""Which velocities keep a person clear of the others: one half-plane for each neighbour.

Section 4 of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (ISRR 2009).
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.sim.orca.settings import OrcaSettings


def agent_lines(
    position: Tensor, velocity: Tensor, mask: Tensor, rows: Tensor | None, settings: OrcaSettings
) -> Tensor:
    """Return the constraints (4, K, N) of N people from their nearest neighbours, nearest first.

    Args:
        position: Positions (B, A, 2), metres.
        velocity: Velocities (B, A, 2), m/s.
        mask: Who is there (B, A).
        rows: Which of the B * A people are asked for (N,) long; None: all.
        settings: Radius, time step, neighbours and horizon.
    """
    neighbor, near = _neighbors(position, mask, rows, settings)
    x, y = position.flatten(0, 1).T
    vx, vy = velocity.flatten(0, 1).T
    own_vx, own_vy = (vx, vy) if rows is None else (vx[rows], vy[rows])
    own_x, own_y = (x, y) if rows is None else (x[rows], y[rows])
    rel_x, rel_y = x[neighbor] - own_x, y[neighbor] - own_y
    rel_vx, rel_vy = own_vx - vx[neighbor], own_vy - vy[neighbor]

    combined = 2 * settings.radius
    distance2 = rel_x * rel_x + rel_y * rel_y
    overlap = distance2 <= combined * combined
    # Those who overlap are to be apart after one step, the others for the whole horizon.
    rate = torch.where(overlap, 1 / settings.time_step, 1 / settings.time_horizon)
    wx, wy = rel_vx - rate * rel_x, rel_vy - rate * rel_y
    w2 = wx * wx + wy * wy
    ahead = wx * rel_x + wy * rel_y
    on_circle = overlap | ((ahead < 0) & (ahead * ahead > combined * combined * w2))

    # The nearest point of the velocity obstacle's border is on its round end, ...
    w = w2.sqrt()
    inverse = 1 / w.clamp_min(torch.finfo(w.dtype).tiny)  # w = 0: no direction is better than another
    unit_x, unit_y = wx * inverse, wy * inverse
    outward = rate * combined - w
    # ... or on its left or right leg.
    side = rel_x * wy - rel_y * wx
    leg = (distance2 - combined * combined).clamp_min(0).sqrt()
    leg = torch.where(side > 0, leg, -leg)
    inverse = 1 / distance2
    leg_x = (rel_x * leg - rel_y * combined) * inverse
    leg_y = (rel_x * combined + rel_y * leg) * inverse
    along = rel_vx * leg_x + rel_vy * leg_y

    # Everybody does half of what is needed.
    change_x = torch.where(on_circle, outward * unit_x, along * leg_x - rel_vx)
    change_y = torch.where(on_circle, outward * unit_y, along * leg_y - rel_vy)
    lines = torch.stack(
        (
            own_vx + 0.5 * change_x,
            own_vy + 0.5 * change_y,
            torch.where(on_circle, unit_y, leg_x),
            torch.where(on_circle, -unit_x, leg_y),
        )
    )
    return lines if near is None else torch.where(near, lines, 0)


def _neighbors(
    position: Tensor, mask: Tensor, rows: Tensor | None, settings: OrcaSettings
) -> tuple[Tensor, Tensor | None]:
    """Return places (K, N) of the nearest others in the flattened batch, and which are near; None: all."""
    scenes, agents = mask.shape
    x, y = position.unbind(-1)
    dx, dy = x[:, None, :] - x[:, :, None], y[:, None, :] - y[:, :, None]
    distance2 = dx * dx + dy * dy
    ignored = torch.eye(agents, dtype=torch.bool, device=mask.device) | ~mask[:, None, :]
    ignored = ignored | (distance2 >= settings.neighbor_dist**2)
    distance2 = distance2.masked_fill(ignored, torch.inf).flatten(0, 1)
    first = torch.arange(scenes, device=mask.device).mul(agents).repeat_interleave(agents)
    if rows is not None:
        distance2, first = distance2[rows], first[rows]
    most = agents - 1 if settings.max_neighbors is None else min(agents - 1, settings.max_neighbors)
    distance2, order = distance2.sort(dim=1, stable=True)
    near = distance2[:, :most].T.isfinite()
    used = near.any(1).sum()
    return order[:, :most].T[:used] + first, near[:used]
