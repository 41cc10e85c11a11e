"""`pedzoo.policies.orca.programs.solve`, one person after the other: compiled by numba.

For single precision on the CPU. A person's program ends where it is solved; the batched one goes on until
the last person's is.
"""

from __future__ import annotations

import numpy as np

from pedzoo.core.compiled import compiled, jit

_0, _1, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_EPSILON, _TINY = np.float32(1e-5), np.finfo(np.float32).tiny


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
    """Write the velocities (2, N) that `pedzoo.policies.orca.programs.solve` returns."""
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
