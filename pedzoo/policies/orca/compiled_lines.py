"""`wall_lines`, one person after the other: compiled by numba for single precision on the CPU.

Every operation is that of `wall_lines`, in its order, so that both give the same lines.
"""

from __future__ import annotations

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit

_0, _1, _2 = np.float32(0), np.float32(1), np.float32(2)
_FAR, _TOUCHING, _TINY = np.float32(1e30), np.float32(1e-6), np.finfo(np.float32).tiny


@jit
def _corner(corner, convex, next_x, next_y, own_x, from_y, apart, radius, scale):
    """Return one corner's part of the velocity obstacle, as if it were the left one."""
    # Legs pass corners that stick out; others are those of the segment's line.
    apart2 = apart * apart
    distance2 = corner * corner + apart2
    leg, share = math.sqrt(max(distance2 - radius * radius, _0)), convex / distance2
    leg_x = (corner * leg - apart * radius) * share + (convex - _1)
    leg_y = (corner * radius + apart * leg) * share
    # They do not point into the wall beyond a corner: there the neighbouring segment makes the constraint.
    foreign = convex != 0 and leg_x * next_y - leg_y * next_x >= 0
    if foreign:
        leg_x, leg_y = next_x, next_y
    # The border of the velocity obstacle: a cut-off segment with round ends, and two legs.
    from_x = own_x - scale * corner
    past = from_x * leg_x + from_y * leg_y < 0
    across = from_x * leg_y - from_y * leg_x
    return corner, leg_x, leg_y, foreign, from_x, past, across * across + (_FAR if past else _0)


@jit
def _line(along, apart, length, neighbor, convex, own_x, own_y, radius, scale):
    """Return a segment's line in its frame, and whether it counts (x, y, dx, dy, counts)."""
    apart = max(apart, _TOUCHING)
    left, right = -along, along - length

    # An agent that touches the wall moves away from its nearest point.
    beyond = max(max(left, right), _0)
    gap2 = beyond * beyond + apart * apart
    touch, away = gap2 <= radius * radius, _1 / math.sqrt(gap2)

    # Seen from nearly its own line, only the nearer corner of a segment counts; an inner one does not.
    only_left, only_right = left > 0 and apart <= radius, right > 0 and apart <= radius
    single = only_left or only_right
    ignored = (only_left and convex[0] == 0) or (only_right and convex[1] == 0)
    # nor does a right corner that is touched where the next segment sees to it
    if touch and only_right and right * neighbor[1, 1] - apart * neighbor[0, 1] > 0:
        ignored = True

    from_y = own_y - scale * apart
    rest = from_y, apart, radius, scale
    if only_right:  # beyond an only corner lies the segment itself
        one = _corner(-right, convex[1], -_1, _0, own_x, *rest)
    else:
        one = _corner(left, convex[0], neighbor[0, 0], neighbor[1, 0], own_x, *rest)
    if only_left:
        other = _corner(-left, convex[0], -_1, _0, -own_x, *rest)
    else:
        other = _corner(right, convex[1], neighbor[0, 1], neighbor[1, 1], -own_x, *rest)

    outside_left, outside_right = one[4] < 0, other[4] < 0
    left_round = one[5] and (other[5] if single else outside_left)
    right_round = other[5] and outside_right and not single
    on_round = left_round or right_round
    nowhere = np.float32(int(outside_left) + int(outside_right) + int(single))
    on_cutoff = min(one[6], other[6]) >= from_y * from_y + nowhere * _FAR
    mirrored = right_round if on_round else one[6] > other[6]
    corner, dx, dy, foreign, from_x, _, _ = other if mirrored else one
    ignored = ignored or (foreign and not (on_cutoff or on_round or touch))
    if on_cutoff:
        dx, dy = -_1, _0
    if on_round:
        speed = _1 / max(math.sqrt(from_x * from_x + from_y * from_y), _TINY)
        dx, dy = from_y * speed, -(speed * from_x)
    x, y = (corner - radius * dy) * scale, (radius * dx + apart) * scale
    if touch:
        x, y, dx, dy, mirrored = _0, _0, -(apart * away), away * beyond, along > length
    turn = -_1 if mirrored else _1
    return x * turn, y, dx, dy * turn, not ignored


@compiled(
    "i8(f4[:,:], f4[:,:], f4[:,:], f4[:,:,:], f4[:,:], f4[:,:,:,:], f4[:,:,:], f4[:,:],"
    " f4[:,:], f4[:], f4, f4, f4[:,:,:])"
)
def compiled_lines(
    along, apart, length, direction, side, neighbor, convex, valid, velocity, radius, scale, epsilon, lines
):
    """Write the lines that count of each person (4, K, N), nearest first; returns how many have the most.

    Args are those of `Segments`, the velocities, the radii, one over the horizon, and RVO2's epsilon.
    """
    most = 0
    bound = np.empty(along.shape[0], np.float32)
    for i in range(along.shape[1]):
        used, mirror = 0, side[0, i]
        margin = max(radius[i] * scale - epsilon, _TINY)
        for k in range(along.shape[0]):
            if valid[k, i] == 0:
                break
            right_x, right_y = direction[0, k, i], direction[1, k, i]
            ahead_x, ahead_y = mirror * -right_y, mirror * right_x
            # Walls behind the line of a nearer segment do not count.
            one_x = (apart[k, i] * ahead_x - along[k, i] * right_x) * scale
            one_y = (apart[k, i] * ahead_y - along[k, i] * right_y) * scale
            long = scale * length[k, i]
            other_x, other_y = one_x + long * right_x, one_y + long * right_y
            counts = True
            for j in range(used):
                one = one_x * lines[3, j, i] - one_y * lines[2, j, i]
                other = other_x * lines[3, j, i] - other_y * lines[2, j, i]
                if min(one, other) >= bound[j]:
                    counts = False
                    break
            if not counts:
                continue
            x, y, dx, dy, counts = _line(
                along[k, i], apart[k, i], length[k, i], neighbor[:, :, k, i], convex[:, k, i],
                right_x * velocity[0, i] + right_y * velocity[1, i],
                ahead_x * velocity[0, i] + ahead_y * velocity[1, i], radius[i], scale,
            )  # fmt: skip
            if counts:
                dx *= mirror
                x, y = x * right_x + y * ahead_x, x * right_y + y * ahead_y
                dx, dy = dx * right_x + dy * -right_y, dx * right_y + dy * right_x
                lines[0, used, i], lines[1, used, i], lines[2, used, i], lines[3, used, i] = x, y, dx, dy
                bound[used] = x * dy - y * dx + margin
                used += 1
        most = max(most, used)
    return most
