"""ORCA for batches of scenes: each person's new velocity."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.maps.walls.segments import Segments
from pedzoo.policies.orca.agent_lines import agent_lines
from pedzoo.policies.orca.programs import solve
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.policies.orca.wall_lines import wall_lines

# glibc then keeps up to 62 MB of freed memory: page faults were half of the time of 1024 scenes
torch.empty(31 << 20, dtype=torch.uint8)


@torch.no_grad()
def orca_velocity(
    position: Tensor,
    velocity: Tensor,
    pref_velocity: Tensor,
    max_speed: Tensor,
    mask: Tensor,
    settings: OrcaSettings,
    walls: Segments | None = None,
    passive: Tensor | None = None,
    radius: Tensor | None = None,
) -> Tensor:
    """Return the velocities (B, A, 2) that ORCA chooses, m/s; 0 for absent people. No gradient flows.

    They are RVO2's, except where that library divides 0 by 0: two people at the same place with the same
    velocity ignore each other.

    Args:
        position: Positions (B, A, 2), metres.
        velocity: Current velocities (B, A, 2), m/s.
        pref_velocity: Velocities that people would have if they were alone (B, A, 2), m/s.
        max_speed: Top speeds (B, A), m/s.
        mask: Which agents are there (B, A) bool.
        settings: ORCA's parameters.
        walls: The wall segments near each of the B * A people, within `OrcaSettings.wall_reach` of their top
            speeds; None: walls are not seen.
        passive: Which agents avoid no other (B, A) bool: their velocity is returned as it is. The others do
            all of avoiding them, and half of avoiding each other. None for none.
        radius: Radii of the disks (B, A), metres; None for that of the settings.
    """
    # A scene of few people takes hundreds of short operations: not to track them at all saves a sixth.
    with torch.inference_mode():
        if radius is None:
            radius = max_speed.new_full(mask.shape, settings.radius)
        state = position, velocity, pref_velocity, max_speed, radius.to(position)
        chosen = _velocity(*state, mask, settings, walls, passive)
    return chosen.clone()  # a tensor as any other again


def _velocity(
    position: Tensor,
    velocity: Tensor,
    pref_velocity: Tensor,
    max_speed: Tensor,
    radius: Tensor,
    mask: Tensor,
    settings: OrcaSettings,
    walls: Segments | None,
    passive: Tensor | None,
) -> Tensor:
    """Return the velocities of `orca_velocity`; arguments likewise."""
    asked = mask if passive is None else mask & ~passive
    rows = None if asked.all() else asked.flatten().nonzero()[:, 0]
    if rows is not None:  # placeholders of absent people
        position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
    share = torch.full_like(radius, 0.5)
    if passive is not None:
        share = torch.where(passive, 1.0, share)
    lines = agent_lines(position, velocity, radius, share, mask, rows, settings)
    state = position, velocity, pref_velocity, max_speed[..., None], radius[..., None]
    people = torch.cat([part.flatten(0, 1).T for part in state])
    people = people if rows is None else people.index_select(1, rows)
    obstacles = 0
    if walls is not None:
        walls = walls if rows is None else walls.select(rows)
        beside_walls = wall_lines(walls, people[2:4], people[7], settings)
        obstacles, lines = beside_walls.shape[1], torch.cat((beside_walls, lines), dim=1)
    chosen = solve(lines, obstacles, people[4:6], people[6]).T
    if rows is None:
        return chosen.view(position.shape)
    result = velocity.flatten(0, 1).clone()
    result[rows] = chosen
    return result.view(position.shape)
