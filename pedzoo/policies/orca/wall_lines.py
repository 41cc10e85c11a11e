"""Which velocities keep a person clear of walls: at most one half-plane for each segment.

RVO2's static obstacles: section 6 of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision
avoidance" (ISRR 2009), in the form of the library, where a segment knows its corners and neighbours.

All is computed in the frame of each segment (see `Segments`), where its wall lies ahead and across. The
right corner is mirrored and computed together with the left one, in tensors (2, K, N); its line is mirrored
back at the end.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.machine import compiles
from pedzoo.maps.walls.segments import Segments
from pedzoo.policies.orca.programs import EPSILON
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.policies.orca.vectors import above, at_least, at_most, below, cross, dot, left, pick

_FAR = 1e30
"""More than any square of a speed."""

_TOUCHING = 1e-6
"""Metres: people are farther from walls than this. Padding without a wall may be anywhere."""


def wall_lines(walls: Segments, velocity: Tensor, radius: Tensor, settings: OrcaSettings) -> Tensor:
    """Return the constraints (4, K, N) of N people from the wall segments near them, nearest first.

    Those that do not count are 0; compiled loops leave them out.

    Args:
        walls: K segments of each person, nearest first.
        velocity: Velocities (2, N), m/s.
        radius: Radii of the disks (N,), metres.
        settings: Horizon and number of segments.
    """
    walls = walls.nearest(settings.max_obstacles)
    if compiles(velocity):
        from pedzoo.policies.orca.compiled_lines import compiled_lines

        lines = torch.zeros(4, *walls.along.shape)
        given = [part.numpy() for part in (*walls, velocity, radius)]
        count = compiled_lines(*given, 1 / settings.time_horizon_obst, EPSILON, lines.numpy())
        return lines[:, :count]
    right, ahead = walls.direction, walls.side * left(walls.direction)
    own_x, own_y = dot(right, velocity[:, None]), dot(ahead, velocity[:, None])
    x, y, dx, dy, counts = _lines(walls, own_x, own_y, radius, settings)
    # a mirror changes which side of a line is left
    point = (x * right).add_(y * ahead)
    lines = torch.cat((point, (dx.mul_(walls.side) * right).add_(dy * left(right))))
    return lines.mul_(_uncovered(walls, ahead, lines, counts, radius, settings))


def _uncovered(
    walls: Segments, ahead: Tensor, lines: Tensor, counts: Tensor, radius: Tensor, settings: OrcaSettings
) -> Tensor:
    """Return which lines count (K, N), 1 or 0: not those behind the line of a nearer segment."""
    scale = 1 / settings.time_horizon_obst
    margin = (radius * scale - EPSILON).clamp_min(torch.finfo(lines.dtype).tiny)
    one = (walls.line_distance * ahead).sub_(walls.along * walls.direction).mul_(scale)
    other = one + scale * walls.length * walls.direction
    x, y = torch.stack((one, other), dim=1)  # (2 corners, K, N)
    bound = cross(lines[:2], lines[2:]).add_(margin)
    for k, (dx, dy, enough, count) in enumerate(zip(*lines[2:], bound, counts, strict=True), start=1):
        behind = (x[:, k:] * (dy * count)).sub_(y[:, k:] * (dx * count)).amin(0)
        counts[k:].mul_(below(behind, enough))
    return counts


def _lines(
    walls: Segments, own_x: Tensor, own_y: Tensor, radius: Tensor, settings: OrcaSettings
) -> tuple[Tensor, ...]:
    """Return each segment's line by itself, in its frame, and whether there is one, 1 or 0; all (K, N).

    In order: x and y of a point of the line, x and y of its direction, whether it counts.
    """
    scale = 1 / settings.time_horizon_obst
    apart = walls.line_distance.clamp_min(_TOUCHING)
    corner = torch.stack((-walls.along, walls.along - walls.length))
    apart2 = apart * apart

    # A person who touches the wall moves away from its nearest point.
    beyond = corner.amax(0).clamp_min(0)
    gap2 = (beyond * beyond).add_(apart2)
    touch = at_most(gap2, radius * radius)
    away = gap2.sqrt_().reciprocal_()

    # Seen from nearly its own line, only the nearer corner of a segment counts; an inner one does not.
    only = above(corner, 0).mul_(at_most(apart, radius))
    single = only[0] + only[1]
    inner = (only - only * walls.convex).sum(0)
    # nor does a right corner that is touched where the next segment sees to it
    next_x, next_y = walls.neighbor[:, 1]
    served = touch * only[1] * (corner[1] * next_y).sub_(apart * next_x).gt_(0)
    instead = only.flip(0)
    corner = pick(instead, corner.flip(0).neg_(), corner)
    convex = pick(instead, walls.convex.flip(0), walls.convex)
    next_x, next_y = walls.neighbor.unbind()  # beyond an only corner lies the segment itself: (-1, 0)
    next_x, next_y = next_x - (next_x + 1).mul_(instead), next_y - next_y * instead

    # Legs pass corners that stick out; others are those of the segment's line.
    distance2 = (corner * corner).add_(apart2)
    leg = (distance2 - radius * radius).clamp_min_(0).sqrt_()
    share = convex / distance2
    leg_x = (corner * leg).sub_(apart * radius).mul_(share).add_(convex - 1)
    leg_y = (corner * radius).add_(apart * leg).mul_(share)
    # They do not point into the wall beyond a corner: there the neighbouring segment makes the constraint.
    foreign = (leg_x * next_y).sub_(leg_y * next_x).ge_(0).mul_(convex)
    leg_x, leg_y = leg_x.lerp_(next_x, foreign), leg_y.lerp_(next_y, foreign)

    # The border of the velocity obstacle: a cut-off segment with round ends, and two legs.
    from_x, from_y = torch.stack((own_x, -own_x)).sub_(scale * corner), own_y - scale * apart
    past = (from_x * leg_x).add_(from_y * leg_y).lt_(0)
    outside = below(from_x, 0)
    rounded = past * outside
    both_past = past[0] * past[1]
    left_round = pick(single, both_past, rounded[0])
    right_round = rounded[1] - rounded[1] * single
    on_round = left_round + right_round

    to_leg = (from_x * leg_y).sub_(from_y * leg_x).square_().add_(past, alpha=_FAR)
    nowhere = outside[0] + outside[1] + single
    to_cutoff = (from_y * from_y).add_(nowhere, alpha=_FAR)
    on_cutoff = at_least(to_leg.amin(0), to_cutoff)
    right = pick(on_round, right_round, above(to_leg[0], to_leg[1]))

    from_x, leg_x, leg_y = (pick(right, part[1], part[0]) for part in (from_x, leg_x, leg_y))
    corner, foreign = (pick(right, part[1], part[0]) for part in (corner, foreign))
    free = 1 - touch
    ignored = foreign.mul_(1 - on_cutoff).mul_(1 - on_round).mul_(free).add_(inner).add_(served)
    speed = (from_x * from_x).add_(from_y * from_y).sqrt_()
    speed = speed.clamp_min_(torch.finfo(speed.dtype).tiny).reciprocal_()
    leg_x.sub_((leg_x + 1).mul_(on_cutoff))
    leg_y.sub_(on_cutoff.mul_(leg_y))
    dx, dy = leg_x.lerp_(from_y * speed, on_round), leg_y.lerp_(speed.mul_(from_x).neg_(), on_round)
    x = corner.sub_(radius * dy).mul_(scale).mul_(free)
    y = (radius * dx).add_(apart).mul_(scale).mul_(free)
    dx, dy = dx.lerp_((apart * away).neg_(), touch), dy.lerp_(away.mul_(beyond), touch)
    right = pick(touch, above(walls.along, walls.length), right)
    turn = 1 - 2 * right
    return x.mul_(turn), y, dx, dy.mul_(turn), ignored.lt_(1).mul_(walls.valid)
