"""ORCA's lines of walls and its programs, one person after the other: compiled for a CPU.

Every operation is that of `pedzoo.policies.rule_based.orca`, in single precision. A person's program ends
where it is solved; the batched one goes on until the last person's is. At 64 scenes of 5 people a step with
ORCA takes .42 of the time that it takes without these loops.
"""

import math

import numpy as np

from pedzoo.core.compiled import compiled, jit

_0, _1, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_TINY = np.finfo(np.float32).tiny

FAR = 1e30
"""More than any square of a speed, and farther along a line than anything."""

TOUCHING = 1e-6
"""Metres: people are farther from walls than this. Padding without a wall may be anywhere."""

EPSILON = 1e-5
"""RVO2's: lines whose directions have a smaller cross product count as parallel."""

_FAR, _TOUCHING, _EPSILON = np.float32(FAR), np.float32(TOUCHING), np.float32(EPSILON)


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


@jit
def _violation(line, k, x, y):
    """Return how far a velocity is on the wrong side of line ``k`` of (4, L), m/s."""
    return (line[1, k] - y) * line[2, k] - (line[0, k] - x) * line[3, k]


@jit
def _best_on(line, k, best_x, best_y, radius, towards):
    """Return the best velocity on line ``k`` that obeys all lines before it, and whether there is one."""
    x, y, dx, dy = line[0, k], line[1, k], line[2, k], line[3, k]
    along = x * dx + y * dy
    inside = along * along + radius * radius - (x * x + y * y)
    if inside < 0:
        return x, y, False
    half = np.sqrt(inside)
    low, high = -half - along, half - along
    for j in range(k):
        qx, qy = line[2, j], line[3, j]
        across = dx * qy - dy * qx
        ahead = (y - line[1, j]) * qx - (x - line[0, j]) * qy
        if abs(across) <= _EPSILON:
            if ahead < 0:
                return x, y, False
        elif across > 0:
            high = min(high, ahead / across)
        else:
            low = max(low, ahead / across)
        if low > high:
            return x, y, False
    if towards:
        t = high if best_x * dx + best_y * dy > 0 else low
    else:
        t = max(min((best_x - x) * dx + (best_y - y) * dy, high), low)
    return x + t * dx, y + t * dy, True


@jit
def _nearest(line, count, x, y, best_x, best_y, radius, towards):
    """Return the permitted velocity that is best, and the first of the lines that cannot be obeyed."""
    for k in range(count):
        if _violation(line, k, x, y) > 0:
            on_x, on_y, feasible = _best_on(line, k, best_x, best_y, radius, towards)
            if not feasible:
                return x, y, k
            x, y = on_x, on_y
    return x, y, count


@jit
def _least_violating(line, projected, count, first, walls, x, y, radius):
    """Return the velocity whose worst violation is least, from one that obeys all lines before ``first``."""
    worst = _0
    for k in range(first, count):
        if _violation(line, k, x, y) <= worst:
            continue
        px, py, dx, dy = line[0, k], line[1, k], line[2, k], line[3, k]
        used = min(walls, count)
        projected[:, :used] = line[:, :used]
        for j in range(walls, k):
            qx, qy = line[2, j], line[3, j]
            across = dx * qy - dy * qx
            if abs(across) <= _EPSILON:
                if dx * qx + dy * qy > -_HALF:
                    continue  # it is as far on as the other, or no line at all
                point_x, point_y = _HALF * (px + line[0, j]), _HALF * (py + line[1, j])
            else:
                t = ((py - line[1, j]) * qx - (px - line[0, j]) * qy) / across
                point_x, point_y = px + t * dx, py + t * dy
            turn_x, turn_y = qx - dx, qy - dy
            length = max(np.sqrt(turn_x * turn_x + turn_y * turn_y), _TINY)
            projected[0, used], projected[1, used] = point_x, point_y
            projected[2, used], projected[3, used] = turn_x / length, turn_y / length
            used += 1
        on_x, on_y, failed = _nearest(projected, used, -dy * radius, dx * radius, -dy, dx, radius, True)
        if failed == used:  # it fails by rounding only
            x, y = on_x, on_y
        worst = _violation(line, k, x, y)
    return x, y


@compiled("void(f4[:,:,:], i8, f4[:,:], f4[:], f4[:,:])")
def compiled_solve(lines, walls, preferred, max_speed, result):
    """Write the velocities (2, N) that `pedzoo.policies.rule_based.orca.solve` returns."""
    count = lines.shape[1]
    line, projected = np.empty((4, count), np.float32), np.empty((4, count), np.float32)
    for i in range(lines.shape[2]):
        used, walls_used = 0, 0
        for k in range(count):
            if lines[2, k, i] != 0 or lines[3, k, i] != 0:
                for part in range(4):
                    line[part, used] = lines[part, k, i]
                used += 1
                walls_used += k < walls
        want_x, want_y, radius = preferred[0, i], preferred[1, i], max_speed[i]
        x, y = want_x, want_y
        speed = np.sqrt(x * x + y * y)
        if speed > radius:
            share = _1 / max(speed, _TINY)
            x, y = x * share * radius, y * share * radius
        x, y, failed = _nearest(line, used, x, y, want_x, want_y, radius, False)
        if failed < used:
            x, y = _least_violating(line, projected, used, failed, walls_used, x, y, radius)
        result[0, i], result[1, i] = x, y
