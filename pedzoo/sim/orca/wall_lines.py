"""Which velocities keep a person clear of walls: at most one half-plane for each segment.

RVO2's static obstacles: section 6 of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision
avoidance" (ISRR 2009), in the form of the library, where a segment knows its corners and neighbours.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.maps.segments import Segments
from pedzoo.sim.orca.programs import EPSILON
from pedzoo.sim.orca.settings import OrcaSettings
from pedzoo.sim.orca.vectors import cross, dot, left, pick, unit


def wall_lines(walls: Segments, position: Tensor, velocity: Tensor, settings: OrcaSettings) -> Tensor:
    """Return the constraints (4, K, N) of N people from the wall segments near them, nearest first.

    Args:
        walls: K segments of each person, nearest first.
        position: Positions (2, N), metres.
        velocity: Velocities (2, N), m/s.
        settings: Radius, horizon and how many segments are heeded.
    """
    walls = walls.nearest(settings.max_obstacles)
    to_start, to_end = walls.start - position[:, None], walls.end - position[:, None]
    lines = _lines(walls, to_start, to_end, velocity[:, None], settings)

    # A segment whose velocity obstacle lies behind the line of a nearer one adds nothing.
    scale = 1 / settings.time_horizon_obst
    margin = max(settings.radius * scale - EPSILON, torch.finfo(lines.dtype).tiny)
    to_start, to_end = scale * to_start, scale * to_end
    for k in range(lines.shape[1] - 1):
        point, direction = lines[:, k].view(2, 2, 1, -1)
        behind = (cross(corner[:, k + 1 :] - point, direction) for corner in (to_start, to_end))
        covered = torch.minimum(*behind) >= margin
        lines[:, k + 1 :] *= ~covered
    return lines


def _lines(
    walls: Segments, to_start: Tensor, to_end: Tensor, velocity: Tensor, settings: OrcaSettings
) -> Tensor:
    """Return a constraint (4, K, N) for each segment and person by themselves; zeros where there is none."""
    _, _, direction, before, after, (convex_start, convex_end), valid = walls
    radius2, along = settings.radius * settings.radius, walls.end - walls.start
    start2, end2 = dot(to_start, to_start), dot(to_end, to_end)
    share = -dot(to_start, along) / dot(along, along)
    off = -to_start - share * along
    in_line = dot(off, off) <= radius2
    left_of, right_of = share < 0, share > 1

    # Whoever touches the wall moves away from it: from a corner, or from the segment.
    touch_start, touch_end = left_of & (start2 <= radius2), right_of & (end2 <= radius2)
    touch_corner = touch_start | touch_end
    touch = touch_corner | (in_line & ~left_of & ~right_of)
    retreat = pick(touch_corner, unit(left(pick(touch_start, to_start, to_end))), -direction)
    # not from inner corners, nor where the next segment sees to it
    ignored = (touch_start & ~convex_start) | (touch_end & ~(convex_end & (cross(to_end, after) >= 0)))

    # Seen from nearly its own line, only the nearer corner of a segment counts.
    only_start, only_end = in_line & left_of, in_line & right_of
    single = only_start | only_end
    ignored = ignored | (~touch & ((only_start & ~convex_start) | (only_end & ~convex_end)))
    left_corner, right_corner = pick(only_end, to_end, to_start), pick(only_start, to_start, to_end)
    before, after = pick(only_end, direction, before), pick(only_start, direction, after)
    convex_left = (only_end & convex_end) | (~only_end & convex_start)
    convex_right = (only_start & convex_start) | (~only_start & convex_end)
    left_leg = pick(convex_left, _tangent(left_corner, settings.radius), -direction)
    right_leg = pick(convex_right, _tangent(right_corner, -settings.radius), direction)

    # Legs do not point into the wall beyond a corner: there the neighbouring segment makes the constraint.
    foreign_left = convex_left & (cross(left_leg, -before) >= 0)
    foreign_right = convex_right & (cross(right_leg, after) <= 0)
    left_leg, right_leg = pick(foreign_left, -before, left_leg), pick(foreign_right, after, right_leg)

    # The border of the velocity obstacle: a cut-off segment with round ends, and two legs.
    scale = 1 / settings.time_horizon_obst
    left_corner, right_corner = scale * left_corner, scale * right_corner
    from_left, from_right = velocity - left_corner, velocity - right_corner
    cutoff = right_corner - left_corner
    t = dot(from_left, cutoff) / dot(cutoff, cutoff).clamp_min(torch.finfo(cutoff.dtype).tiny)
    t_left, t_right = dot(from_left, left_leg), dot(from_right, right_leg)
    past_left, past_right = t_left < 0, t_right < 0
    round_left = past_left & ((single & past_right) | (~single & (t < 0)))
    round_right = ~single & (t > 1) & past_right
    on_round = round_left | round_right

    to_cutoff = _squared(from_left - t * cutoff, forbidden=(t < 0) | (t > 1) | single)
    to_left = _squared(from_left - t_left * left_leg, forbidden=past_left)
    to_right = _squared(from_right - t_right * right_leg, forbidden=past_right)
    on_cutoff = (to_cutoff <= to_left) & (to_cutoff <= to_right)
    on_left = (to_left <= to_right) & ~on_cutoff
    on_right = ~on_left & ~on_cutoff
    ignored = ignored | (~touch & ~on_round & ((on_left & foreign_left) | (on_right & foreign_right)))

    at_right = (on_round & round_right) | (~on_round & on_right)
    chosen = pick(on_cutoff, -direction, pick(on_left, left_leg, -right_leg))
    chosen = pick(on_round, -left(unit(pick(at_right, from_right, from_left))), chosen)
    point = pick(at_right, right_corner, left_corner) + settings.radius * scale * left(chosen)
    lines = torch.cat((point * ~touch, pick(touch, retreat, chosen)))
    return lines * (valid & ~ignored)


def _tangent(corner: Tensor, radius: float) -> Tensor:
    """Return the direction (2, ...) past the left (radius > 0) or right side of a disk around ``corner``."""
    distance2 = dot(corner, corner)
    leg = (distance2 - radius * radius).clamp_min(0).sqrt()
    return (corner * leg + radius * left(corner)) * (1 / distance2)


def _squared(gap: Tensor, forbidden: Tensor) -> Tensor:
    """Return the squared lengths (...), or more than any of them."""
    return dot(gap, gap) + 1e30 * forbidden
