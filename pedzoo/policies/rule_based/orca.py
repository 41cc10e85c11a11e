"""Baseline: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009), walls or not.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance": section 4 for agents, 5 for the
linear programs, 6 for walls. Order of steps and tolerance are those of the library RVO2, so that the answers
are RVO2's. Compiled loops (`_orca_loops`) answer for walls and programs, torch on other devices and in other
precisions.

Constraints of N people are ``lines`` (4, L, N): x and y of a point of the line and of its unit direction.
Velocities to its left are permitted. Rows of L are in order of importance, walls before people. A line of
direction (0, 0) constrains nothing: it pads people with fewer constraints.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, ids_of, is_person_sized, maps_of
from pedzoo.core.errors import check_range, unknown
from pedzoo.core.machine import compiles
from pedzoo.core.types import TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.bank import FASTEST, WallSegments
from pedzoo.maps.segments import Segments
from pedzoo.policies.neighbours import nearest, separation_push
from pedzoo.policies.policy import Policy, deterministic, drawn_vectors
from pedzoo.policies.rule_based._orca_loops import EPSILON, FAR, TOUCHING, compiled_lines, compiled_solve

OF_PRESET: Any = None  # the value of the preset

OFF_SPOT = 0.05
"""Of the way by which people leave the spot of others: so far off it they are seen."""


def take_preset(settings: Any, what: str, presets: Mapping[str, Mapping[str, Any]]) -> None:
    """Give settings that are missing, `OF_PRESET`, the values of their preset; a `UserError` names others."""
    if settings.preset not in presets:
        raise unknown(what, settings.preset, presets)
    for name, value in presets[settings.preset].items():
        if getattr(settings, name) is OF_PRESET:
            object.__setattr__(settings, name, value)


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
            UserError: There is no such preset, or a value is out of its range.
        """
        take_preset(self, "ORCA preset", PRESETS)
        lengths = "radius dt neighbor_dist time_horizon time_horizon_obst top_speed_ratio"
        check_range(self, "orca", lengths, "a number above 0", above=True)
        check_range(self, "orca", "jitter max_neighbors max_obstacles", "0 or more")

    def radii(self, body: Tensor, robot: Tensor, controlled: Tensor) -> Tensor:
        """Return the radii (...) of the disks that ORCA avoids, metres, for those of the bodies.

        ``radius`` stands for persons with the usual body. Robots, and agents of another body that ORCA does
        not move, not ``controlled``, count with their own one, and wider persons with at least that.
        """
        own = torch.where(controlled & ~robot, body.clamp_min(self.radius), body)
        return torch.where(robot | ~is_person_sized(body), own, self.radius)

    def wall_reach(self, max_speed: Tensor, radius: Tensor | None = None) -> Tensor:
        """Return within what distance (...) walls matter to disks of a top speed, m/s, and radius, metres."""
        return self.time_horizon_obst * max_speed + (self.radius if radius is None else radius)


PRESETS: dict[str, dict[str, Any]] = {
    "pedzoo": {"radius": 0.2, "max_neighbors": 10, "top_speed_ratio": TOP_SPEED_RATIO},
    # iGibson 2.0's social navigation, where all people in the scene are neighbours
    "igibson": {"radius": 0.5, "max_neighbors": None, "top_speed_ratio": 1.0},
}
"""Settings of the presets."""


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the scalar products (...) of vectors (2, ...)."""
    return (a[0] * b[0]).add_(a[1] * b[1])


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross products (...): positive where ``b`` is to the left of ``a``."""
    return (a[0] * b[1]).sub_(a[1] * b[0])


def left(a: Tensor) -> Tensor:
    """Return the vectors (2, ...) a quarter turn to the left."""
    return torch.stack((-a[1], a[0]))


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

    ``rows`` (N,) long are theirs of the B * A people, None for all. ``share`` (B, A), 0.5 or 1, is how much
    of avoiding each is left to the others. All else is as of `orca_velocity`, with numbers for absent people.
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
    overlap = torch.le(distance2, combined2, out=distance2.new_empty(0))  # shares: fast on a CPU
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

    ``velocity`` (2, N) is in m/s, the ``radius`` (N,) of the disks in metres. Constraints that do not count
    are 0; compiled loops leave them out.
    """
    walls, scale = walls.nearest(settings.max_obstacles), 1 / settings.time_horizon_obst
    if compiles(velocity):
        lines = torch.zeros(4, *walls.along.shape)
        given = [part.numpy() for part in (*walls, velocity, radius)]
        return lines[:, : compiled_lines(*given, scale, EPSILON, lines.numpy())]
    right, ahead = walls.direction, walls.side * left(walls.direction)
    own_x, own_y = dot(right, velocity[:, None]), dot(ahead, velocity[:, None])
    x, y, dx, dy, counts = _lines(walls, own_x, own_y, radius, scale)
    # a mirror changes which side of a line is left
    lines = torch.cat((x * right + y * ahead, dx * walls.side * right + dy * left(right)))
    # walls behind the line of a nearer segment do not count
    one = (walls.line_distance * ahead - walls.along * right) * scale
    corners = torch.stack((one, one + scale * walls.length * right), dim=1)
    bound = cross(lines[:2], lines[2:]) + (radius * scale - EPSILON).clamp_min(_tiny(radius))
    for k in range(1, len(counts)):
        behind = cross(corners[:, :, k:], lines[2:, k - 1, None, None]).amin(0)
        counts[k:] &= (behind < bound[k - 1]) | ~counts[k - 1]
    return lines * counts


def _corner(
    corner: Tensor,
    convex: Tensor,
    beyond: tuple[Tensor, Tensor],
    own_x: Tensor,
    from_y: Tensor,
    apart: Tensor,
    radius: Tensor,
    scale: float,
) -> tuple[Tensor, ...]:
    """Return one corner's part of the velocity obstacle, as if it were the left one; see the loops."""
    distance2 = corner.square() + apart.square()
    leg = (distance2 - radius.square()).clamp_min(0).sqrt()
    leg_x = torch.where(convex, (corner * leg - apart * radius) / distance2, -1.0)
    leg_y = torch.where(convex, (corner * radius + apart * leg) / distance2, 0.0)
    foreign = convex & (leg_x * beyond[1] - leg_y * beyond[0] >= 0)
    leg_x, leg_y = torch.where(foreign, beyond[0], leg_x), torch.where(foreign, beyond[1], leg_y)
    from_x = own_x - scale * corner
    past = from_x * leg_x + from_y * leg_y < 0
    across = (from_x * leg_y - from_y * leg_x).square() + FAR * past
    return corner, leg_x, leg_y, foreign, from_x, past, across


def _lines(walls: Segments, own_x: Tensor, own_y: Tensor, radius: Tensor, scale: float) -> tuple[Tensor, ...]:
    """Return each segment's line in its frame, and whether it counts (x, y, dx, dy, counts), all (K, N)."""
    where = torch.where
    apart = walls.line_distance.clamp_min(TOUCHING)
    before, after = -walls.along, walls.along - walls.length
    beyond = before.maximum(after).clamp_min(0)
    gap2 = beyond.square() + apart.square()
    touch, away = gap2 <= radius.square(), gap2.rsqrt()
    only_left, only_right = (before > 0) & (apart <= radius), (after > 0) & (apart <= radius)
    single, convex, (next_x, next_y) = only_left | only_right, walls.convex > 0, walls.neighbor
    ignored = (only_left & ~convex[0]) | (only_right & ~convex[1])
    ignored = ignored | (touch & only_right & (after * next_y[1] - apart * next_x[1] > 0))
    from_y = own_y - scale * apart
    rest = from_y, apart, radius, scale
    way = where(only_right, -1.0, next_x[0]), where(only_right, 0.0, next_y[0])
    one = where(only_right, -after, before), where(only_right, convex[1], convex[0])
    one = _corner(*one, way, own_x, *rest)
    way = where(only_left, -1.0, next_x[1]), where(only_left, 0.0, next_y[1])
    other = where(only_left, -before, after), where(only_left, convex[0], convex[1])
    other = _corner(*other, way, -own_x, *rest)

    outside, other_outside = one[4] < 0, other[4] < 0
    left_round = one[5] & where(single, other[5], outside)
    right_round = other[5] & other_outside & ~single
    on_round = left_round | right_round
    nowhere = outside.to(own_x) + other_outside.to(own_x) + single.to(own_x)
    on_cutoff = one[6].minimum(other[6]) >= from_y.square() + FAR * nowhere
    mirrored = where(on_round, right_round, one[6] > other[6])
    corner, dx, dy, foreign, from_x = (where(mirrored, b, a) for a, b in zip(one[:5], other[:5], strict=True))
    ignored = ignored | (foreign & ~(on_cutoff | on_round | touch))
    speed = torch.hypot(from_x, from_y).clamp_min(_tiny(from_x))
    dx = where(on_round, from_y / speed, where(on_cutoff, -1.0, dx))
    dy = where(on_round, -from_x / speed, where(on_cutoff, 0.0, dy))
    x = where(touch, 0.0, (corner - radius * dy) * scale)
    y = where(touch, 0.0, (radius * dx + apart) * scale)
    dx, dy = where(touch, -apart * away, dx), where(touch, beyond * away, dy)
    turn = 1 - 2 * where(touch, walls.along > walls.length, mirrored).to(x)
    return x * turn, y, dx, dy * turn, (walls.valid > 0) & ~ignored


def solve(lines: Tensor, walls: int, preferred: Tensor, max_speed: Tensor) -> Tensor:
    """Return the velocities (2, N): permitted ones, or where there are none, those violating lines least.

    The first ``walls`` of the ``lines`` (4, L, N) are never relaxed. Preferred velocities (2, N) and top
    speeds (N,) are in m/s.
    """
    if compiles(lines, preferred, max_speed):
        result = torch.empty(preferred.shape)
        arrays = [part.contiguous().numpy() for part in (preferred, max_speed)]
        compiled_solve(lines.numpy(), walls, *arrays, result.numpy())
        return result
    speed = preferred.norm(dim=0).clamp_min(_tiny(preferred))
    start = preferred * (max_speed / speed).clamp_max(1)
    result, failed = nearest_permitted(lines, start, preferred, max_speed, towards=False)
    rows = (failed < lines.shape[1]).nonzero()[:, 0]
    if len(rows):
        result[:, rows] = _least_violating(
            lines[..., rows], result[:, rows], failed[rows], max_speed[rows], walls
        )
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
    result, failed = start.clone(), torch.full_like(max_speed, count, dtype=torch.long)
    number, rows = (torch.arange(size, device=lines.device) for size in lines.shape[1:])
    number, own, last = number[:, None], start, torch.full_like(failed, -1)
    while count:
        line = _first((violation(lines, own) > 0) & (number > last), number)
        going = (line < count).nonzero()[:, 0]
        if not len(going):
            break
        rows, line, max_speed = rows[going], line[going], max_speed[going]
        lines, own, optimum = (_of(part, going) for part in (lines, own, optimum))
        chosen = lines.gather(1, line.expand(4, 1, -1))[:, 0]
        values, feasible = _best_on(chosen, lines, number < line, optimum, max_speed, towards)
        own = torch.where(feasible, values, own)
        last = torch.where(feasible, line, count)  # people who are stuck have no further lines
        result.index_copy_(1, rows, own)
        failed.index_copy_(0, rows, torch.where(feasible, count, line))
    return result, failed


def _best_on(
    chosen: Tensor, lines: Tensor, before: Tensor, optimum: Tensor, max_speed: Tensor, towards: bool
) -> tuple[Tensor, Tensor]:
    """Return the best velocities (2, N) on lines ``chosen`` (4, N), and where there are any (N,) bool.

    They obey all ``lines`` (4, L, N) that come ``before`` (L, N) bool.
    """
    x, y, dx, dy = chosen
    along = x * dx + y * dy
    inside = along.square() + max_speed.square() - (x.square() + y.square())
    half = inside.clamp_min(0).sqrt()
    px, py, qx, qy = lines
    across = dx * qy - dy * qx
    ahead = (y - py) * qx - (x - px) * qy
    parallel = across.abs() <= EPSILON
    cut = ahead / torch.where(parallel, 1.0, across)
    high = torch.where(before & (across > EPSILON), cut, FAR).amin(0).minimum(half - along)
    low = torch.where(before & (across < -EPSILON), cut, -FAR).amax(0).maximum(-half - along)
    blocked = (before & parallel & (ahead < 0)).any(0)
    if towards:
        t = torch.where(optimum[0] * dx + optimum[1] * dy > 0, high, low)
    else:
        t = ((optimum[0] - x) * dx + (optimum[1] - y) * dy).minimum(high).maximum(low)
    return torch.stack((x + t * dx, y + t * dy)), (inside >= 0) & (low <= high) & ~blocked


def _least_violating(lines: Tensor, result: Tensor, line: Tensor, max_speed: Tensor, walls: int) -> Tensor:
    """Solve the three-dimensional program: the velocities (2, N) whose worst violation is least.

    ``result`` (2, N) obeys all lines before ``line`` (N,) long, at which the two-dimensional program failed.
    The first ``walls`` lines are obeyed in any case.
    """
    count, own, answer = lines.shape[1], result, result.clone()
    number, rows = (torch.arange(size, device=lines.device) for size in lines.shape[1:])
    number = number[:, None]
    while True:
        chosen = lines.gather(1, line.expand(4, 1, -1))
        inward = torch.stack((-chosen[3, 0], chosen[2, 0]))
        projected = _equally_violated(lines[:, walls:], chosen, number[walls:] < line)
        projected = torch.cat((lines[:, :walls], projected), dim=1)
        moved, failed = nearest_permitted(projected, inward * max_speed, inward, max_speed, towards=True)
        # it fails by rounding only: the current velocity is feasible by construction
        own = torch.where(failed == count, moved, own)
        answer.index_copy_(1, rows, own)
        line = _first((violation(lines, own) > violation(chosen, own)) & (number > line), number)
        going = (line < count).nonzero()[:, 0]
        if not len(going):
            return answer
        rows, line, max_speed = rows[going], line[going], max_speed[going]
        lines, own = _of(lines, going), _of(own, going)


def _equally_violated(people: Tensor, chosen: Tensor, before: Tensor) -> Tensor:
    """Return where lines (4, L, N) that come ``before`` (L, N) are violated as much as ``chosen``; else 0."""
    px, py, qx, qy = people
    x, y, dx, dy = chosen
    across = dx * qy - dy * qx
    parallel = across.abs() <= EPSILON
    t = ((y - py) * qx - (x - px) * qy) / torch.where(parallel, 1.0, across)
    crossing = torch.stack((x + t * dx, y + t * dy))
    point = torch.where(parallel, (chosen[:2] + people[:2]) / 2, crossing)
    turn = people[2:] - chosen[2:]
    # parallel lines of the same direction constrain nothing more, and neither does padding (0, 0)
    counts = before & ~(parallel & (dx * qx + dy * qy > -0.5))
    return torch.cat((point, turn / turn.norm(dim=0).clamp_min(_tiny(turn)) * counts))


def violation(lines: Tensor, velocity: Tensor) -> Tensor:
    """Return how far velocities (2, ..., N) are on the wrong side of ``lines`` (4, ..., N): (..., N), m/s."""
    px, py, dx, dy = lines
    x, y = velocity
    return (py - y) * dx - (px - x) * dy


def _of(values: Tensor, rows: Tensor) -> Tensor:
    """Return the values of some people (..., M); from a matrix several times faster than from three dims."""
    return values.flatten(0, -2).index_select(1, rows).view(*values.shape[:-1], -1)


def _first(wrong: Tensor, number: Tensor) -> Tensor:
    """Return the least ``number`` (L, 1) of lines that are ``wrong`` (L, N) bool; L where there is none."""
    return torch.where(wrong, number, len(number)).amin(0)


def _tiny(like: Tensor) -> float:
    return torch.finfo(like.dtype).tiny


class Orca(Policy):
    """Agents take half of the avoidance, and all of it for agents that this policy does not move.

    The preferred velocity is the planner's desired one. Robots, and other bodies that the policy does not
    move, count with their own radius.

    Mirror-image people with the same preferred velocity stop for ever. A small ``jitter`` of the preferred
    velocity, usual with RVO2, frees most of them. Deterministic policies draw it once for each person.
    """

    def __init__(self, settings: OrcaSettings = OrcaSettings()) -> None:
        """Take the settings."""
        super().__init__(settings.dt)
        self.settings = settings

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the velocities of all agents."""
        agents: Any = tensordict["agents"]
        mask = agents["mask"]
        position = agents["history"][:, :, -1] + OFF_SPOT * separation_push(tensordict)
        scenes, slots = mask.shape
        top_speed = agents["pref_speed"][..., 0] * self.settings.top_speed_ratio
        wanted = agents["desired_velocity"]
        if self.settings.jitter:
            scene, step = tensordict["scene_key"], (tensordict["time"] / TRACE_SECONDS).round().long()
            if deterministic():  # what is drawn for people once, whatever the scene
                scene, step = torch.zeros_like(scene), torch.zeros_like(step)
            key = randomness.join(scene, "orca", step, ids_of(tensordict))
            wanted = wanted + self.settings.jitter * drawn_vectors(tensordict, key)
        walls = None
        body, controlled = agents["radius"][..., 0], agents["controlled"]
        radius = self.settings.radii(body, agents["kind"] == ROBOT, controlled)
        if self.settings.walls:
            map_id = tensordict["map_id"].expand(scenes, slots).flatten()
            pose = tensordict["scene_pose"].repeat_interleave(slots, 0)
            reach = self.settings.wall_reach(top_speed, radius).flatten()
            farthest = self.settings.time_horizon_obst * FASTEST
            segments = WallSegments(maps_of(tensordict), self.settings.max_obstacles, farthest)
            walls = segments.near(position.flatten(0, 1), map_id, pose, reach)
        velocity = orca_velocity(
            position,
            agents["velocity"],
            wanted,
            top_speed,
            mask,
            self.settings,
            walls,
            passive=mask & ~controlled,
            radius=radius,
        )
        tensordict["agents", "action"] = velocity
        return tensordict
