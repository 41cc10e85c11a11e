"""Lines of sight between open cells, compiled by numba: one line after the other, in leaps."""

import math

from pedzoo.core.compiled import compiled

ROUNDING = 1e-6
"""Cells: lines between centres miss other centres by far more, unless they meet them."""


@compiled("void(i2[:], i8, i8, i4[:,:], i4[:,:], b1[:])")
def clear_lines(leap, width, cells, origin, target, seen):
    """Write which lines (M,) from and to columns and rows of open cells (M, 2) are clear: see `Sight`."""
    for m in range(len(seen)):
        x, y = target[m, 0] - origin[m, 0], target[m, 1] - origin[m, 1]
        steep = abs(y) > abs(x)
        along, across = (y, x) if steep else (x, y)
        steps = abs(along)
        slope = across / max(steps, 1)
        # flat index = base + column * forward + floor(height) * sideways, columns counted along the line
        forward, sideways = (width, 1) if steep else (1, width)
        base = origin[m, 1] * width + origin[m, 0] + (cells if across == 0 else 0)
        if along < 0:
            base -= forward  # squares are named by their smallest corner
            forward = -forward
        column = 0
        while column < steps:
            begin = slope * column
            end = begin + slope
            low = math.floor(min(begin, end) + ROUNDING)
            high = max(math.ceil(max(begin, end) - ROUNDING) - 1, low)
            at = base + column * forward
            room = min(leap[at + low * sideways], leap[at + high * sideways])
            if room == 0:
                break
            column += room
        seen[m] = column >= steps
