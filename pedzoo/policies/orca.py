"""ORCA for batches of scenes: half-planes of neighbours and walls, and the nearest permitted velocity.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (ISRR 2009): section 4 for
agents, 5 for the linear programs, 6 for walls. Order of steps and tolerance are those of the library RVO2, so
that the answers are RVO2's.

Coordinates come first, (2, ...), and conditions are shares, 1 and 0. On a CPU floating point is computed in
vectors of 8, truth values (also `torch.where`) one by one.

Constraints of N people are ``lines`` (4, L, N): x and y of a point of the line and of its unit direction.
Velocities to its left are permitted. Rows of L are in order of importance, walls before people. A line of
direction (0, 0) constrains nothing: it pads people with fewer constraints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from pedzoo.core.batch import is_person_sized
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.machine import compiles
from pedzoo.core.types import TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.segments import Segments
from pedzoo.policies import orca_numba
from pedzoo.policies.neighbours import nearest
from pedzoo.policies.orca_numba import EPSILON, FAR, TOUCHING

OF_PRESET: Any = None  # the value of the preset


@dataclass(frozen=True)
class OrcaSettings:
    """Settings of ORCA; its parameters are in RVO2's meaning and mostly with its names.

    Attributes:
        radius: Of the disk of every person that ORCA moves, metres; bodies and planners have their own.
        walls: Whether walls are avoided. iGibson's ORCA never sees them.
        dt: Seconds between decisions, in which people who already overlap are to be apart again.
        jitter: Standard deviation of noise on the preferred velocity, m/s.
        preset: ``pedzoo``, or ``igibson`` for the constants of iGibson's social navigation, see `PRESETS`.
        neighbor_dist: Metres between centres beyond which others are ignored.
        max_neighbors: Nearest others that are avoided; the preset ``igibson`` avoids all.
        time_horizon: Seconds for which velocities are safe with respect to others.
        time_horizon_obst: Seconds for which they are safe with respect to walls.
        max_obstacles: Nearest wall segments that are avoided (RVO2: all of them).
        top_speed_ratio: Top speed, divided by the preferred one; iGibson's people have no other.
    """

    radius: float = OF_PRESET
    walls: bool = True
    dt: float = TRACE_SECONDS
    jitter: float = 0.02
    preset: Literal["pedzoo", "igibson"] = "pedzoo"
    neighbor_dist: float = 5.0
    max_neighbors: int | None = OF_PRESET
    time_horizon: float = 2.0
    time_horizon_obst: float = 2.0
    max_obstacles: int = 16
    top_speed_ratio: float = OF_PRESET

    def __post_init__(self) -> None:
        """Take missing values from the preset, and check all.

        Raises:
            UserError: No such preset, a length or time that is not positive, or a count that is negative.
        """
        if self.preset not in PRESETS:
            raise unknown("ORCA preset", self.preset, PRESETS)
        for name, value in PRESETS[self.preset].items():
            if getattr(self, name) is OF_PRESET:
                object.__setattr__(self, name, value)
        if self.jitter < 0 or self.top_speed_ratio <= 0:
            raise UserError(
                f"orca: jitter {self.jitter}, top_speed_ratio {self.top_speed_ratio}: expected >= 0, > 0"
            )
        for name in ("max_neighbors", "max_obstacles"):
            if (count := getattr(self, name)) is not None and count < 0:
                raise UserError(f"orca: {name} {count} must be 0 or more")
        for name in ("radius", "dt", "neighbor_dist", "time_horizon", "time_horizon_obst"):
            if not (math.isfinite(value := getattr(self, name)) and value > 0):
                raise UserError(f"orca: {name} {value} must be a number above 0")

    def radii(self, body: Tensor, robot: Tensor, controlled: Tensor) -> Tensor:
        """Return the radii (...) of the disks that ORCA avoids, metres.

        ``radius`` stands for persons with the usual body. Robots, and agents of another body that ORCA does
        not move, count with their own one, and wider persons with at least that.

        Args:
            body: Radii of the bodies (...), metres.
            robot: Which agents are robots (...) bool.
            controlled: Which agents ORCA moves (...) bool.
        """
        own = torch.where(controlled & ~robot, body.clamp_min(self.radius), body)
        return torch.where(robot | ~is_person_sized(body), own, self.radius)

    def wall_reach(self, max_speed: Tensor, radius: Tensor | None = None) -> Tensor:
        """Return the distance (...) within which walls matter, metres.

        Args:
            max_speed: Top speeds (...), m/s.
            radius: Radii of the disks (...), metres; None for ``radius`` of the settings.
        """
        return self.time_horizon_obst * max_speed + (self.radius if radius is None else radius)


PRESETS: dict[str, dict[str, Any]] = {
    "pedzoo": {"radius": 0.2, "max_neighbors": 10, "top_speed_ratio": TOP_SPEED_RATIO},
    # iGibson 2.0's social navigation, where all people in the scene are neighbours
    "igibson": {"radius": 0.5, "max_neighbors": None, "top_speed_ratio": 1.0},
}
"""Settings of the presets."""


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the scalar products (...)."""
    return (a[0] * b[0]).add_(a[1] * b[1])


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross products (...): positive where ``b`` is to the left of ``a``."""
    return (a[0] * b[1]).sub_(a[1] * b[0])


def left(a: Tensor) -> Tensor:
    """Return the vectors (2, ...) a quarter turn to the left."""
    return torch.stack((-a[1], a[0]))


def above(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` > ``b``, else 0; no gradient flows, as in the next three."""
    return torch.gt(a, b, out=a.new_empty(0))


def at_least(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` >= ``b``."""
    return torch.ge(a, b, out=a.new_empty(0))


def below(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` < ``b``."""
    return torch.lt(a, b, out=a.new_empty(0))


def at_most(a: Tensor, b: Tensor | float) -> Tensor:
    """Return the share 1 where ``a`` <= ``b``."""
    return torch.le(a, b, out=a.new_empty(0))


def pick(share: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return ``a`` where the share is 1, ``b`` where it is 0; both finite."""
    return torch.lerp(b, a, share)


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
    with torch.inference_mode():  # not to track hundreds of short operations at all saves a sixth
        radius = max_speed.new_full(mask.shape, settings.radius) if radius is None else radius
        radius = radius.to(position)
        asked = mask if passive is None else mask & ~passive
        rows = None if asked.all() else asked.flatten().nonzero()[:, 0]
        if rows is not None:  # placeholders of absent people
            position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
        share = torch.full_like(radius, 0.5)
        share = share if passive is None else torch.where(passive, 1.0, share)
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
        if rows is not None:
            chosen = velocity.flatten(0, 1).index_copy(0, rows, chosen)
    return chosen.reshape(position.shape).clone()  # a tensor as any other again


def agent_lines(
    position: Tensor,
    velocity: Tensor,
    radius: Tensor,
    share: Tensor,
    mask: Tensor,
    rows: Tensor | None,
    settings: OrcaSettings,
) -> Tensor:
    """Return the constraints (4, K, N) of N people from their nearest neighbours, nearest first.

    Args:
        position: Positions (B, A, 2), metres; numbers for absent people, too.
        velocity: Velocities (B, A, 2), m/s; likewise.
        radius: Radii of the disks (B, A), metres; likewise.
        share: How much of avoiding each of them is left to the others (B, A), 0.5 or 1; likewise.
        mask: Which people are present (B, A).
        rows: Which of the B * A people are asked for (N,) long; None: all.
        settings: Time step, neighbours and horizon.
    """
    neighbor, near = nearest(position, mask, settings.neighbor_dist, settings.max_neighbors, rows)
    moving = (position.flatten(0, 1).T, velocity.flatten(0, 1).T)
    agents = torch.cat((*moving, radius.flatten()[None], share.flatten()[None]))
    own = agents if rows is None else agents.index_select(1, rows)
    theirs = agents.index_select(1, neighbor.flatten()).view(6, *neighbor.shape)
    relative = theirs[:4].sub_(own[:4, None])
    place, current = relative[:2], -relative[2:]

    combined = theirs[4].add_(own[4])
    combined2 = combined * combined
    distance2 = dot(place, place)
    overlap = at_most(distance2, combined2)
    # Overlapping people are to be apart after one step, the others for the whole horizon.
    rate = (overlap * (1 / settings.dt)).add_((1 - overlap).mul_(1 / settings.time_horizon))
    w = current - rate * place
    w2, ahead = dot(w, w), dot(w, place)
    # the projection is on the round end where w points away from its centre by more than the legs' angle
    on_circle = (ahead * ahead.abs()).lt_(-combined2 * w2).maximum(overlap)

    # The nearest point of the velocity obstacle's border is on its round end, ...
    length = w2.sqrt()
    tiny = torch.finfo(length.dtype).tiny
    outward = w * length.clamp_min(tiny).reciprocal_()  # w = 0: no direction is better than another
    to_circle = (rate * combined).sub_(length) * outward
    # ... or on its left or right leg.
    leg = (distance2 - combined2).clamp_min_(0).sqrt_()
    leg.mul_(cross(place, w).gt_(0).mul_(2).sub_(1))
    side = (place * leg).add_(left(combined * place)).mul_(distance2.clamp_min(tiny).reciprocal_())
    to_leg = (dot(current, side) * side).sub_(current)

    # An agent does half of what is needed, and all of it where the other one does nothing.
    to_leg.lerp_(to_circle, on_circle).mul_(theirs[5]).add_(own[2:4, None])
    lines = torch.cat((to_leg, side.lerp_(-left(outward), on_circle)))
    return lines if near is None else lines.mul_(near.to(lines.dtype))


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
        return orca_numba.wall_lines(walls, velocity, radius, settings.time_horizon_obst)
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
    apart = walls.line_distance.clamp_min(TOUCHING)
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

    to_leg = (from_x * leg_y).sub_(from_y * leg_x).square_().add_(past, alpha=FAR)
    nowhere = outside[0] + outside[1] + single
    to_cutoff = (from_y * from_y).add_(nowhere, alpha=FAR)
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


AT_ONCE = 40_000
"""Pairs of lines, of all people together, up to which computing all of them is faster than choosing."""


def solve(lines: Tensor, walls: int, preferred: Tensor, max_speed: Tensor) -> Tensor:
    """Return the velocities (2, N): permitted ones, or where there are none, those violating lines least.

    Args:
        lines: Constraints (4, L, N) as above.
        walls: How many of the L come from walls; these are never relaxed.
        preferred: Preferred velocities (2, N), m/s.
        max_speed: Top speeds (N,), m/s.
    """
    if compiles(lines, preferred, max_speed):
        return orca_numba.solve(lines, walls, preferred, max_speed)
    speed = (preferred[0] * preferred[0]).add_(preferred[1] * preferred[1]).sqrt_()
    slower = preferred * (1 / speed.clamp_min(torch.finfo(speed.dtype).tiny)) * max_speed
    start = pick(above(speed, max_speed), slower, preferred)
    result, failed = nearest_permitted(lines, start, preferred, max_speed, towards=False)
    rows = (failed < lines.shape[1]).nonzero()[:, 0]
    if len(rows):
        failed = failed.index_select(0, rows)
        packed = _of(lines, rows), _of(result, rows), failed, max_speed.index_select(0, rows)
        result.index_copy_(1, rows, least_violating(*packed, walls))
    return result


def nearest_permitted(
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
    if lines.shape[1] ** 2 * lines.shape[2] <= AT_ONCE:
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
        if lines.shape[1] ** 2 * lines.shape[2] <= AT_ONCE:
            own, line = _at_once(lines, own, line - 1, optimum, max_speed, towards)
            return result.index_copy_(1, rows, own), failed.index_copy_(0, rows, line)
        chosen = lines.gather(1, line.long().expand(4, 1, -1))[:, 0]
        values, feasible = _best_on(chosen, lines, above(line, number), optimum, max_speed, towards)
        own = pick(feasible, values, own)
        end = torch.full_like(line, count)
        last = pick(feasible, line, end)  # people who are stuck have no further lines
        result.index_copy_(1, rows, own)
        failed.index_copy_(0, rows, pick(feasible, end, line).long())


def _at_once(
    lines: Tensor, start: Tensor, last: Tensor | None, optimum: Tensor, max_speed: Tensor, towards: bool
) -> tuple[Tensor, Tensor]:
    """Like `nearest_permitted`, from ``start`` (2, N), which obeys a person's lines up to ``last``."""
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
        optimum: As for `nearest_permitted` (2, N).
        max_speed: Top speeds (N,).
        towards: As for `nearest_permitted`.

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
    high = cut.add(at_most(across, EPSILON), alpha=FAR).amin(0).minimum(half - along)
    low = cut.sub_(across.ge_(-EPSILON), alpha=FAR).amax(0).maximum(half.neg_().sub_(along))
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
        moved, failed = nearest_permitted(projected, inward * max_speed, inward, max_speed, towards=True)
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
