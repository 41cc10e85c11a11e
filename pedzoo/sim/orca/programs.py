"""The linear programs of ORCA for many people at once: the permitted velocity nearest to the preferred one.

Section 5 of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (ISRR 2009), with
the order of steps and the tolerance of their library RVO2, so that the answers are RVO2's.

Constraints of N people are ``lines`` (4, L, N): x and y of a point of the line, x and y of its unit
direction; velocities to its left are permitted. Rows of L are in order of importance, walls before people. A
line of direction (0, 0) constrains nothing, so people with fewer constraints are padded with zeros.

The incremental programs visit one line after the other and act only where the line is violated. Here
everybody goes straight to their own next violated line: a few rounds in place of L, with the same answer.
Who is done leaves the batch.
"""

from __future__ import annotations

import torch
from torch import Tensor

EPSILON = 1e-5
"""RVO2's: lines whose directions have a smaller cross product count as parallel."""


def solve(lines: Tensor, walls: int, preferred: Tensor, max_speed: Tensor) -> Tensor:
    """Return the velocities (2, N): permitted ones, or where there are none, those .

    Args:
        lines: Constraints (4, L, N) as above.
        walls: How many of the L come from walls; these are never relaxed.
        preferred: Preferred velocities (2, N), m/s.
        max_speed: Top speeds (N,), m/s.
    """
    speed = (preferred[0] * preferred[0] + preferred[1] * preferred[1]).sqrt()
    start = torch.where(speed > max_speed, preferred * (1 / speed) * max_speed, preferred)
    result, failed = nearest(lines, start, preferred, max_speed, towards=False)
    rows = (failed < lines.shape[1]).nonzero()[:, 0]
    if len(rows):
        packed = _of(lines, rows), result[:, rows], failed[rows], max_speed[rows]
        result[:, rows] = least_violating(*packed, walls)
    return result


def nearest(
    lines: Tensor, start: Tensor, optimum: Tensor, max_speed: Tensor, towards: bool
) -> tuple[Tensor, Tensor]:
    """Solve the two-dimensional program: the permitted velocity in the disk of ``max_speed`` that is best.

    Args:
        lines: Constraints (4, L, N).
        start: The best velocities (2, N) of the disk without constraints.
        optimum: Where to be near, or the direction to be far in (2, N).
        max_speed: Top speeds (N,).
        towards: ``optimum`` is a unit direction.

    Returns:
        The velocities (2, N), and the first line (N,) that could not be obeyed together with those before
        it, L where all could. The velocity then obeys the ones before.
    """
    count = lines.shape[1]
    result, failed = start.clone(), torch.full_like(max_speed, count, dtype=torch.long)
    number = torch.arange(count, device=lines.device)[:, None]
    rows = torch.arange(lines.shape[2], device=lines.device)
    last, own = rows.new_full((), -1), start
    while count:
        wrong = (violation(lines, own) > 0) & (number > last)
        line = _first(wrong)
        still = (line < count).nonzero()[:, 0]
        if not len(still):
            break
        rows, line, lines = rows[still], line[still], _of(lines, still)
        optimum, max_speed = optimum[:, still], max_speed[still]
        own, feasible = best_on_line(lines, line, optimum, max_speed, towards)
        failed[rows] = torch.where(feasible, count, line)
        own = torch.where(feasible, own, result[:, rows])
        result[:, rows] = own
        last = torch.where(feasible, line, count)
    return result, failed


def best_on_line(
    lines: Tensor, line: Tensor, optimum: Tensor, max_speed: Tensor, towards: bool
) -> tuple[Tensor, Tensor]:
    """Solve the one-dimensional program: the best velocity on a line that obeys all lines before it.

    Args:
        lines: Constraints (4, L, N).
        line: Number of everybody's line (N,) long.
        optimum: As for `nearest` (2, N).
        max_speed: Top speeds (N,).
        towards: As for `nearest`.

    Returns:
        The velocities (2, N), and where there is one (N,) bool.
    """
    x, y, dx, dy = lines.gather(1, line.expand(4, 1, -1))[:, 0]
    along = x * dx + y * dy
    inside = along * along + max_speed * max_speed - (x * x + y * y)
    half = inside.clamp_min(0).sqrt()

    px, py, qx, qy = lines
    before = torch.arange(lines.shape[1], device=lines.device)[:, None] < line
    across = (dx * qy - dy * qx) * before
    ahead = (qx * (y - py) - qy * (x - px)) * before
    cut = ahead / across
    high = torch.where(across > EPSILON, cut, torch.inf).amin(0).minimum(half - along)
    low = torch.where(across < -EPSILON, cut, -torch.inf).amax(0).maximum(-along - half)
    excluded = ((across.abs() <= EPSILON) & (ahead < 0)).any(0)
    feasible = (inside >= 0) & (low <= high) & ~excluded

    if towards:
        t = torch.where(optimum[0] * dx + optimum[1] * dy > 0, high, low)
    else:
        t = (dx * (optimum[0] - x) + dy * (optimum[1] - y)).minimum(high).maximum(low)
    return torch.stack((x + t * dx, y + t * dy)), feasible


def least_violating(lines: Tensor, result: Tensor, first: Tensor, max_speed: Tensor, walls: int) -> Tensor:
    """Solve the three-dimensional program: the velocities (2, N) whose worst violation is least.

    Args:
        lines: Constraints (4, L, N); the first ``walls`` of them are obeyed in any case.
        result: Velocities (2, N) that obey all lines before ``first``.
        first: The line (N,) long at which the two-dimensional program failed.
        max_speed: Top speeds (N,).
        walls: How many of the L come from walls.
    """
    count = lines.shape[1]
    number = torch.arange(count, device=lines.device)[:, None]
    answer, rows = result.clone(), torch.arange(lines.shape[2], device=lines.device)
    own, worst, last = result, torch.zeros_like(max_speed), first - 1
    while True:
        wrong = (violation(lines, own) > worst) & (number > last)
        line = _first(wrong)
        still = (line < count).nonzero()[:, 0]
        if not len(still):
            return answer
        rows, last, lines, own = rows[still], line[still], _of(lines, still), own[:, still]
        max_speed = max_speed[still]
        chosen = lines.gather(1, last.expand(4, 1, -1))
        inward = torch.stack((-chosen[3, 0], chosen[2, 0]))
        projected = _equally_violated(lines, chosen, (number < last) | (number < walls), walls)
        moved, failed = nearest(projected, inward * max_speed, inward, max_speed, towards=True)
        # it fails by rounding only: the current velocity is feasible by construction
        own = torch.where(failed == count, moved, own)
        worst = violation(chosen, own)[0]
        answer[:, rows] = own


def _equally_violated(lines: Tensor, chosen: Tensor, before: Tensor, walls: int) -> Tensor:
    """Return walls as they are, and for others ``before`` where they are violated as much as ``chosen``."""
    px, py, qx, qy = lines[:, walls:]
    x, y, dx, dy = chosen
    across = dx * qy - dy * qx
    parallel = across.abs() <= EPSILON
    t = (qx * (y - py) - qy * (x - px)) / torch.where(parallel, 1, across)
    point_x = torch.where(parallel, 0.5 * (x + px), x + t * dx)
    point_y = torch.where(parallel, 0.5 * (y + py), y + t * dy)
    turn_x, turn_y = qx - dx, qy - dy
    length = (turn_x * turn_x + turn_y * turn_y).sqrt()
    # parallel lines of the same direction constrain nothing more, and neither does padding (0, 0)
    keep = before[walls:] & ~(parallel & (dx * qx + dy * qy > -0.5))
    scale = torch.where(keep, 1 / length, 0)
    people = torch.stack((point_x, point_y, turn_x * scale, turn_y * scale))
    return torch.cat((lines[:, :walls], people), dim=1)


def violation(lines: Tensor, velocity: Tensor) -> Tensor:
    """Return how far velocities (2, N) are on the wrong side of ``lines`` (4, L, N): (L, N), m/s."""
    px, py, dx, dy = lines
    return dx * (py - velocity[1]) - dy * (px - velocity[0])


def _of(lines: Tensor, rows: Tensor) -> Tensor:
    """Return the constraints (4, L, M) of some people (M,)."""
    # selecting from a matrix is several times faster than from three dimensions
    return lines.flatten(0, 1).index_select(1, rows).unflatten(0, lines.shape[:2])


def _first(wrong: Tensor) -> Tensor:
    """Return the number (N,) of the first true row of (L, N), L where there is none."""
    count = len(wrong)
    # floats, because their minimum is much faster than that of whole numbers
    before_end = torch.arange(-count, 0, device=wrong.device, dtype=torch.float32)[:, None]
    return (before_end * wrong).amin(0).long() + count
