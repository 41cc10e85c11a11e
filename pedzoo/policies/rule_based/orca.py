"""Baseline: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009), walls or not.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance": section 4 for agents, 5 for the
linear programs, 6 for walls. Order of steps and tolerance are those of the library RVO2, so that the answers
are RVO2's. Walls and programs are in compiled loops, one person after the other, on the CPU and in single
precision. A person's program ends where it is solved; a batched one would go on until the last person's is.
At 64 scenes of 5 people a step takes .42 of the time that it takes without loops.

Constraints of N people are ``lines`` (4, L, N): x and y of a point of the line and of its unit direction.
Velocities to its left are permitted. Rows of L are in order of importance, walls before people. A line of
direction (0, 0) constrains nothing: it pads people with fewer constraints.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, ids_of, is_person_sized, maps_of
from pedzoo.core.compiled import compiled, jit
from pedzoo.core.errors import check_range, unknown
from pedzoo.core.types import TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.bank import FASTEST
from pedzoo.maps.segments import Segments
from pedzoo.policies.neighbours import nearest, separation_push
from pedzoo.policies.policy import Policy, deterministic, drawn_vectors

_0, _1, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_TINY = np.finfo(np.float32).tiny

FAR = 1e30
"""More than any square of a speed, and farther along a line than anything."""

TOUCHING = 1e-6
"""Metres: people are farther from walls than this. Padding without a wall may be anywhere."""

EPSILON = 1e-5
"""RVO2's: lines whose directions have a smaller cross product count as parallel."""

_FAR, _TOUCHING, _EPSILON = np.float32(FAR), np.float32(TOUCHING), np.float32(EPSILON)

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
        """Take missing values from the preset, and raise a `UserError` for values out of range."""
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

    They are RVO2's, but two people at the same place with the same velocity ignore each other (0 / 0 there).

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

    ``velocity`` (2, N) is in m/s, the ``radius`` (N,) of the disks in metres. Those that count come first, 0
    after them.
    """
    walls, scale = walls.nearest(settings.max_obstacles), 1 / settings.time_horizon_obst
    lines = torch.zeros(4, *walls.along.shape)
    used = compiled_lines(*_arrays(*walls, velocity, radius), scale, EPSILON, lines.numpy())
    return lines[:, :used].to(velocity)


def solve(lines: Tensor, walls: int, preferred: Tensor, max_speed: Tensor) -> Tensor:
    """Return the velocities (2, N): permitted ones, or where there are none, those violating lines least.

    The first ``walls`` of the ``lines`` (4, L, N) are never relaxed. Preferred velocities (2, N) and top
    speeds (N,) are in m/s.
    """
    result = torch.empty(preferred.shape)
    given, preferences, speeds = _arrays(lines, preferred, max_speed)
    compiled_solve(given, walls, preferences, speeds, result.numpy())
    return result.to(preferred)


def _arrays(*tensors: Tensor) -> list[Any]:
    return [part.detach().to("cpu", torch.float32).numpy() for part in tensors]


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
            asked = position.flatten(0, 1), map_id, pose, reach, self.settings.max_obstacles
            farthest = self.settings.time_horizon_obst * FASTEST
            walls = maps_of(tensordict).segments_near(*asked, farthest)
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
