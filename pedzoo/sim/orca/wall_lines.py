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


def wall_lines(walls: Segments, position: Tensor, velocity: Tensor, settings: OrcaSettings) -> Tensor:
    """Return the constraints (4, K, N) of N people from the wall segments near them, nearest first.

    Args:
        walls: K segments of each person, nearest first.
        position: Positions (2, N), metres.
        velocity: Velocities (2, N), m/s.
        settings: Radius, horizon and how many segments are heeded.
    """
    walls = walls.nearest(settings.max_obstacles)
    slot, person = walls.valid.nonzero(as_tuple=True)
    pairs = Segments(*(part[..., slot, person] for part in walls))
    lines = position.new_zeros(4, *walls.valid.shape)
    lines[:, slot, person] = _lines(pairs, position[:, person], velocity[:, person], settings)

    # A segment whose velocity obstacle lies behind the line of a nearer one adds nothing.
    scale = 1 / settings.time_horizon_obst
    margin = max(settings.radius * scale - EPSILON, torch.finfo(lines.dtype).tiny)
    corners = [scale * (corner - position[:, None]) for corner in (walls.start, walls.end)]
    for k in range(1, lines.shape[1]):
        people = (lines[2:, k] != 0).any(0).nonzero()[:, 0]
        nearer = lines[:, :k].index_select(2, people)
        start, end = (corner[:, k].index_select(1, people)[:, None] - nearer[:2] for corner in corners)
        covered = (_cross(start, nearer[2:]) >= margin) & (_cross(end, nearer[2:]) >= margin)
        lines[:, k, people[covered.any(0)]] = 0
    return lines


def _lines(walls: Segments, position: Tensor, velocity: Tensor, settings: OrcaSettings) -> Tensor:
    """Return the constraints (4, M) of pairs of a segment and a person outside; zeros where there is none."""
    start, end, direction, before, after, (convex_start, convex_end), _ = walls
    radius2 = settings.radius * settings.radius
    to_start, to_end, along = start - position, end - position, end - start
    start2, end2 = _dot(to_start, to_start), _dot(to_end, to_end)
    share = -_dot(to_start, along) / _dot(along, along)
    off = -to_start - share * along
    in_line = _dot(off, off) <= radius2
    left_of, right_of = share < 0, share > 1

    # Whoever touches the wall moves away from it: from a corner, or from the segment.
    touch_start, touch_end = left_of & (start2 <= radius2), right_of & (end2 <= radius2)
    touch = touch_start | touch_end | (in_line & ~left_of & ~right_of)
    from_corner = torch.where(touch_start, to_start, to_end)
    retreat = torch.where(touch_start | touch_end, _unit(_left(from_corner)), -direction)
    # not from inner corners, nor where the next segment sees to it
    ignored = (touch_start & ~convex_start) | (touch_end & ~(convex_end & (_cross(to_end, after) >= 0)))

    # Seen from nearly its own line, only the nearer corner of a segment counts.
    only_start, only_end = in_line & left_of, in_line & right_of
    single = only_start | only_end
    ignored = ignored | (~touch & ((only_start & ~convex_start) | (only_end & ~convex_end)))
    left_corner, right_corner = (
        torch.where(only_end, to_end, to_start),
        torch.where(only_start, to_start, to_end),
    )
    before, after = torch.where(only_end, direction, before), torch.where(only_start, direction, after)
    convex_left = torch.where(only_end, convex_end, convex_start)
    convex_right = torch.where(only_start, convex_start, convex_end)
    left2, right2 = torch.where(only_end, end2, start2), torch.where(only_start, start2, end2)
    left = torch.where(convex_left, _tangent(left_corner, left2, settings.radius), -direction)
    right = torch.where(convex_right, _tangent(right_corner, right2, -settings.radius), direction)

    # Legs do not point into the wall beyond a corner: there the neighbouring segment makes the constraint.
    foreign_left = convex_left & (_cross(left, -before) >= 0)
    foreign_right = convex_right & (_cross(right, after) <= 0)
    left, right = torch.where(foreign_left, -before, left), torch.where(foreign_right, after, right)

    # The border of the velocity obstacle: a cut-off segment with round ends, and two legs.
    scale = 1 / settings.time_horizon_obst
    left_corner, right_corner = scale * left_corner, scale * right_corner
    from_left, from_right = velocity - left_corner, velocity - right_corner
    cutoff = right_corner - left_corner
    t = torch.where(single, 0.5, _dot(from_left, cutoff) / _dot(cutoff, cutoff))
    t_left, t_right = _dot(from_left, left), _dot(from_right, right)
    round_left = torch.where(single, (t_left < 0) & (t_right < 0), (t < 0) & (t_left < 0))
    round_right = (t > 1) & (t_right < 0) & ~round_left
    on_round = round_left | round_right

    to_cutoff = _squared(from_left - t * cutoff).masked_fill((t < 0) | (t > 1) | single, torch.inf)
    to_left = _squared(from_left - t_left * left).masked_fill(t_left < 0, torch.inf)
    to_right = _squared(from_right - t_right * right).masked_fill(t_right < 0, torch.inf)
    on_cutoff = (to_cutoff <= to_left) & (to_cutoff <= to_right)
    on_left = (to_left <= to_right) & ~on_cutoff
    on_right = ~on_left & ~on_cutoff
    ignored = ignored | (~touch & ~on_round & ((on_left & foreign_left) | (on_right & foreign_right)))

    at_right = torch.where(on_round, round_right, on_right)
    corner = torch.where(at_right, right_corner, left_corner)
    chosen = torch.where(on_cutoff, -direction, torch.where(on_left, left, -right))
    chosen = torch.where(on_round, -_left(_unit(torch.where(at_right, from_right, from_left))), chosen)
    point = corner + settings.radius * scale * _left(chosen)
    lines = torch.cat((point.masked_fill(touch, 0), torch.where(touch, retreat, chosen)))
    return lines.masked_fill(ignored, 0)


def _tangent(corner: Tensor, distance2: Tensor, radius: float) -> Tensor:
    """Return the direction (2, M) past the left (radius > 0) or right side of a disk around ``corner``."""
    leg = (distance2 - radius * radius).clamp_min(0).sqrt()
    return (corner * leg + radius * _left(corner)) * (1 / distance2)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return a[0] * b[0] + a[1] * b[1]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[0] * b[1] - a[1] * b[0]


def _squared(a: Tensor) -> Tensor:
    return _dot(a, a)


def _left(a: Tensor) -> Tensor:
    return torch.stack((-a[1], a[0]))


def _unit(a: Tensor) -> Tensor:
    return a * (1 / _squared(a).sqrt().clamp_min(torch.finfo(a.dtype).tiny))
