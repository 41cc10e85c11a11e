"""The linear programs of ORCA for many people at once: the permitted velocity nearest to the preferred one.

Section 5 of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (ISRR 2009), with
the order of steps and the tolerance of their library RVO2, so that the answers are RVO2's.

Constraints of N people are ``lines`` (4, L, N): x and y of a point of the line, x and y of its unit
direction; velocities to its left are permitted. Rows of L are in order of importance, walls before people. A
line of direction (0, 0) constrains nothing: it pads people with fewer constraints.

RVO2's incremental program visits one line after the other. Where the velocity found so far violates a line,
the best velocity on that line that obeys all earlier lines takes its place. This one does not depend on the
velocity so far: it is computed for all lines at once, and each person's sequence of lines is looked up. In
large crowds people first go to their next violated line together, until few are left.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.machine import compiles
from pedzoo.policies.orca.vectors import above, at_least, at_most, pick

EPSILON = 1e-5
"""RVO2's: lines whose directions have a smaller cross product count as parallel."""

AT_ONCE = 40_000
"""Pairs of lines, of all people together, up to which computing all of them is faster than choosing."""

_FAR = 1e30
"""Farther along a line than anything."""


def solve(lines: Tensor, walls: int, preferred: Tensor, max_speed: Tensor) -> Tensor:
    """Return the velocities (2, N): permitted ones, or where there are none, those violating lines least.

    Args:
        lines: Constraints (4, L, N) as above.
        walls: How many of the L come from walls; these are never relaxed.
        preferred: Preferred velocities (2, N), m/s.
        max_speed: Top speeds (N,), m/s.
    """
    if compiles(lines, preferred, max_speed):
        from pedzoo.policies.orca.compiled_programs import compiled_solve

        result = torch.empty_like(preferred)
        compiled_solve(lines.numpy(), walls, preferred.numpy(), max_speed.numpy(), result.numpy())
        return result
    speed = (preferred[0] * preferred[0]).add_(preferred[1] * preferred[1]).sqrt_()
    slower = preferred * (1 / speed.clamp_min(torch.finfo(speed.dtype).tiny)) * max_speed
    start = pick(above(speed, max_speed), slower, preferred)
    result, failed = nearest(lines, start, preferred, max_speed, towards=False)
    rows = (failed < lines.shape[1]).nonzero()[:, 0]
    if len(rows):
        failed = failed.index_select(0, rows)
        packed = _of(lines, rows), _of(result, rows), failed, max_speed.index_select(0, rows)
        result.index_copy_(1, rows, least_violating(*packed, walls))
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
        The velocities (2, N), and the first line (N,) long that could not be obeyed together with those
        before it, L where all could. The velocity then obeys the ones before.
    """
    count = lines.shape[1]
    if not count:
        return start.clone(), torch.zeros_like(max_speed, dtype=torch.long)
    if _few(lines):
        return _at_once(lines, start, None, optimum, max_speed, towards)
    result, failed = start.clone(), torch.full_like(max_speed, count, dtype=torch.long)
    number = torch.arange(count, device=lines.device, dtype=lines.dtype)[:, None]
    rows, own, last = torch.arange(lines.shape[2], device=lines.device), start, None
    while True:
        wrong = violation(lines, own).gt_(0)
        line = _first(wrong if last is None else wrong.mul_(above(number, last)))
        still = (line < count).nonzero()[:, 0]
        if not len(still):
            return result, failed
        rows, line, max_speed = (part.index_select(0, still) for part in (rows, line, max_speed))
        lines, own, optimum = (_of(part, still) for part in (lines, own, optimum))
        if _few(lines):
            own, line = _at_once(lines, own, line - 1, optimum, max_speed, towards)
            return result.index_copy_(1, rows, own), failed.index_copy_(0, rows, line)
        chosen = lines.gather(1, line.long().expand(4, 1, -1))[:, 0]
        values, feasible = _best_on(chosen, lines, above(line, number), optimum, max_speed, towards)
        own = pick(feasible, values, own)
        end = torch.full_like(line, count)
        last = pick(feasible, line, end)  # people who are stuck have no further lines
        result.index_copy_(1, rows, own)
        failed.index_copy_(0, rows, pick(feasible, end, line).long())


def _few(lines: Tensor) -> bool:
    """Return whether looking at everything at once is faster."""
    return lines.shape[1] * lines.shape[1] * lines.shape[2] <= AT_ONCE


def _at_once(
    lines: Tensor, start: Tensor, last: Tensor | None, optimum: Tensor, max_speed: Tensor, towards: bool
) -> tuple[Tensor, Tensor]:
    """Like `nearest`, from velocities ``start`` (2, N) that obey a person's lines up to ``last``."""
    count = lines.shape[1]
    number = torch.arange(-1, count, device=lines.device, dtype=lines.dtype)[:, None]
    one, other = number[1:], number.T[..., None]  # of pairs (one, other, person)
    values, feasible = _best_on(
        lines, lines[:, :, None], above(other[:, 1:], one[..., None]), optimum, max_speed, towards
    )
    # from `start`, -1, and from the best velocity on each line: which line is the next that is violated?
    places = torch.cat((start[:, None], values), dim=1)
    wrong = violation(lines[:, :, None], places[:, None]).gt_(0).mul_(above(one[..., None], other))
    if last is not None:
        wrong[:, 0] *= above(one, last)
    line = _first(wrong)
    # People who can obey it stand on that line then, others stay; a step of two steps, of four, ...
    able = torch.cat((feasible, feasible.new_zeros(1, feasible.shape[1])))
    following = line.long()
    able = able.gather(0, following)
    after = pick(able, line, number.expand_as(line)).long() + 1
    for _ in range(count.bit_length()):
        after = after.gather(0, after)
    end = after[:1]
    return places.gather(1, end.expand(2, 1, -1))[:, 0], following.gather(0, end)[0]


def _best_on(
    chosen: Tensor, lines: Tensor, before: Tensor, optimum: Tensor, max_speed: Tensor, towards: bool
) -> tuple[Tensor, Tensor]:
    """Solve the one-dimensional program: the best velocity on a line that obeys all lines before it.

    Args:
        chosen: Lines (4, ..., N) to be on.
        lines: Constraints (4, L, ..., N).
        before: Which of the L come before the chosen line (L, ..., N), 1 or 0.
        optimum: As for `nearest` (2, N).
        max_speed: Top speeds (N,).
        towards: As for `nearest`.

    Returns:
        The velocities (2, ..., N), and where there is one (..., N), 1 or 0.
    """
    x, y, dx, dy = chosen
    along = (x * dx).add_(y * dy)
    inside = (along * along).add_(max_speed * max_speed).sub_((x * x).add_(y * y))
    half = inside.clamp_min(0).sqrt_()

    px, py, qx, qy = lines
    across = (dx * qy).sub_(dy * qx).mul_(before)
    ahead = (y - py).mul_(qx).sub_((x - px).mul_(qy)).mul_(before)
    parallel = across.abs().le_(EPSILON)
    cut = ahead / (across + parallel)
    high = cut.add(at_most(across, EPSILON), alpha=_FAR).amin(0).minimum(half - along)
    low = cut.sub_(across.ge_(-EPSILON), alpha=_FAR).amax(0).maximum(half.neg_().sub_(along))
    behind = parallel.mul_(ahead).amin(0)
    feasible = inside.ge_(0).mul_(at_least(high, low)).mul_(behind.ge_(0))

    if towards:
        t = pick(above(optimum[0] * dx + optimum[1] * dy, 0), high, low)
    else:
        t = (optimum[0] - x).mul_(dx).add_((optimum[1] - y).mul_(dy)).minimum(high).maximum(low)
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
    number = torch.arange(count, device=lines.device, dtype=lines.dtype)[:, None]
    always = above(torch.full_like(number, walls), number)
    answer, rows = result.clone(), torch.arange(lines.shape[2], device=lines.device)
    line, own = first.to(lines.dtype), result
    while True:
        chosen = lines.gather(1, line.long().expand(4, 1, -1))
        inward = torch.stack((-chosen[3, 0], chosen[2, 0]))
        projected = _equally_violated(lines, chosen, above(line, number).maximum(always), walls)
        moved, failed = nearest(projected, inward * max_speed, inward, max_speed, towards=True)
        # it fails by rounding only: the current velocity is feasible by construction
        own = torch.where(failed == count, moved, own)
        answer.index_copy_(1, rows, own)
        wrong = violation(lines, own).gt_(violation(chosen, own))
        following = _first(wrong.mul_(above(number, line)))
        still = (following < count).nonzero()[:, 0]
        if not len(still):
            return answer
        rows, line, max_speed = (part.index_select(0, still) for part in (rows, following, max_speed))
        lines, own = _of(lines, still), _of(own, still)


def _equally_violated(lines: Tensor, chosen: Tensor, before: Tensor, walls: int) -> Tensor:
    """Return walls as they are, and for others ``before`` where they are violated as much as ``chosen``."""
    people = lines[:, walls:]
    px, py, qx, qy = people
    x, y, dx, dy = chosen
    across = (dx * qy).sub_(dy * qx)
    parallel = across.abs().le_(EPSILON)
    t = (y - py).mul_(qx).sub_((x - px).mul_(qy)).div_(across + parallel)
    crossing = torch.stack((x + t * dx, y + t * dy))
    point = crossing.lerp_((chosen[:2] + people[:2]).mul_(0.5), parallel)
    turn = people[2:] - chosen[2:]
    length = (turn[0] * turn[0]).add_(turn[1] * turn[1]).sqrt_().clamp_min_(torch.finfo(turn.dtype).tiny)
    # parallel lines of the same direction constrain nothing more, and neither does padding (0, 0)
    same = (dx * qx).add_(dy * qy).gt_(-0.5).mul_(parallel)
    before = before[walls:]
    direction = turn.mul_((before - before * same).div_(length))
    return torch.cat((lines[:, :walls], torch.cat((point, direction))), dim=1)


def violation(lines: Tensor, velocity: Tensor) -> Tensor:
    """Return how far velocities (2, ..., N) are on the wrong side of ``lines`` (4, ..., N): (..., N), m/s."""
    px, py, dx, dy = lines
    x, y = velocity
    return (py - y).mul_(dx).sub_((px - x).mul_(dy))


def _of(values: Tensor, rows: Tensor) -> Tensor:
    """Return the values of some people (..., M) from those of all (..., N)."""
    # selecting from a matrix is several times faster than from three dimensions
    return values.flatten(0, -2).index_select(1, rows).view(*values.shape[:-1], -1)


def _first(wrong: Tensor) -> Tensor:
    """Return the number of the first 1 (..., N), a float, of shares (L, ..., N); L where there is none."""
    count = len(wrong)
    before_end = torch.arange(-count, 0, device=wrong.device, dtype=wrong.dtype)
    return (before_end.view(-1, *[1] * (wrong.ndim - 1)) * wrong).amin(0) + count
