"""Baseline: the social force model (Helbing and Molnar, Phys. Rev. E 51, 1995), walls or not.

An acceleration in m/s^2 is called a force; equations are those of the paper, 4282 (1995). Coordinates come
first, (2, K, N) for K others of N people: on a CPU several times faster than pairs. All is differentiable.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pedzoo.core import randomness
from pedzoo.core.batch import ROBOT, agents_of, ids_of, is_person_sized, maps_of
from pedzoo.core.errors import UserError, check_range
from pedzoo.core.geometry import move_to_map, turn_to_scene
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.maps.segments import SegmentTable
from pedzoo.policies.neighbours import nearest
from pedzoo.policies.policy import Policy, deterministic, drawn_vectors
from pedzoo.policies.rule_based.orca import OF_PRESET, cross, dot, left, take_preset

NEGLIGIBLE = 0.01  # m/s^2: walls that accelerate less are left out; walking people accelerate by 1 or more
CLOSEST = 0.01  # metres: people are never closer to the centre of a potential, where its gradient is infinite
EXACT, OFF_LINE = 1e-5, 0.02  # of the distance: so little off the line ahead counts as so much off it
LONGEST_STEP = 0.1  # seconds: longer decisions are integrated in equal parts


@dataclass(frozen=True)
class SocialForceSettings:
    """Settings of the social force model; the symbols are those of the paper.

    Helbing and Molnar, "Social force model for pedestrian dynamics", Phys. Rev. E 51, 4282 (1995),
    arXiv:cond-mat/9805244. Every default but those of the last three is the paper's. The paper's
    desired speed (normally distributed, 1.34 and 0.26 m/s) is each person's ``pref_speed`` here. The
    ellipse around a person (eq. 4) lies along their velocity, which others can see; in the paper along their
    desired direction. Helbing et al. 2005 is "Self-organized pedestrian crowd dynamics: experiments,
    simulations, and design solutions", Transportation Science 39, 1-24.

    Attributes:
        tau: Relaxation time in which people take up their desired velocity, seconds (tau, eq. 2).
        walls: Whether walls are avoided.
        dt: Seconds between decisions, at most ``tau``; forces are integrated in steps of 0.1 s or less.
        preset: ``1995`` for the paper's parameters, ``indoor`` for doors, see `PRESETS`.
        strength: Of the potential around people, m^2/s^2 (V0, eq. 3).
        sigma: Its range, metres (sigma).
        step_time: Seconds that the potential's ellipses reach ahead of a walking person (Delta t, eq. 4).
        wall_strength: Of the potential of walls, m^2/s^2 (U0, eq. 5).
        wall_range: Its range, metres (R).
        view_angle: Half of the angle of sight, degrees (phi; the paper gives 2 phi = 200).
        out_of_view: Weight of people whose force comes from out of sight (c, eq. 8); of others it is 1.
        top_speed_ratio: Top speed, divided by the preferred one (eq. 11).
        neighbor_dist: Metres between centres beyond which others are ignored. From 5 m away a person who
            approaches at 1.7 m/s accelerates another by less than 0.001 m/s^2, at 2.2 m/s by 0.04 m/s^2.
        max_neighbors: Nearest others that act; None: all within ``neighbor_dist``.
        fluctuation: Standard deviation of a random acceleration, drawn for every decision, m/s^2; open in the
            paper. Without it, people who meet exactly head-on never make way.
    """

    tau: float = 0.5
    walls: bool = True
    dt: float = TRACE_SECONDS
    preset: str = "1995"
    strength: float = 2.1
    sigma: float = 0.3
    step_time: float = OF_PRESET
    wall_strength: float = OF_PRESET
    wall_range: float = OF_PRESET
    view_angle: float = 100.0
    out_of_view: float = 0.5
    top_speed_ratio: float = 1.3
    neighbor_dist: float = 5.0
    max_neighbors: int | None = None
    fluctuation: float = 0.1

    def __post_init__(self) -> None:
        """Take missing values from the preset, and raise a `UserError` for values out of range."""
        take_preset(self, "preset of social_force", PRESETS)
        kind, lengths = "social_force", "tau sigma wall_range top_speed_ratio neighbor_dist"
        check_range(self, kind, lengths, "a number above 0", above=True)
        check_range(self, kind, "strength step_time wall_strength fluctuation", "a number, 0 or more")
        check_range(self, kind, "out_of_view", "a weight from 0 to 1", most=1)
        check_range(self, kind, "view_angle", "degrees from 0 to 180", most=180)
        check_range(self, kind, "max_neighbors", "0 or more, or none")
        if self.dt > self.tau:
            raise UserError(
                f"social_force: dt {self.dt}: expected at most tau, {self.tau} s: a velocity that is held "
                "for longer than it takes to change it follows no forces"
            )

    @property
    def wall_reach(self) -> float:
        """Metres beyond which a wall accelerates a person by less than `NEGLIGIBLE`; 1.70 by default."""
        nearest = self.wall_strength / self.wall_range
        return self.wall_range * math.log(max(nearest / NEGLIGIBLE, 1.0))


PRESETS: dict[str, dict[str, Any]] = {
    "1995": {"step_time": 2.0, "wall_strength": 10.0, "wall_range": 0.2},
    "indoor": {
        # walls of Helbing et al. 2005, fitted to a bottleneck: A exp((r - d) / B) with A = 5 m/s^2, B = 0.1 m
        "wall_strength": 5 * 0.1 * math.exp(BODY_RADIUS / 0.1),
        "wall_range": 0.1,
        # one step of 0.65 m at 1.3 m/s; with 2 s people in single file push the one in front aside
        "step_time": 0.5,
    },
}
"""In the middle of a door of 0.85 m the two jambs' potential is 2.4 m^2/s^2 with the walls of 1995 and 0.06
with ``indoor``; a person at 1.3 m/s has a kinetic energy of 0.85 m^2/s^2.
"""


def length(vector: Tensor, least: float) -> Tensor:
    """Return the lengths (...) of vectors (2, ...), and ``least`` for shorter ones, with gradient zero."""
    return dot(vector, vector).clamp_min(least * least).sqrt()


def direction(vector: Tensor) -> Tensor:
    """Return the directions (2, ...) of vectors; that of a zero vector is zero."""
    return vector / length(vector, 1e-6)


def closer(offset: Tensor, by: Tensor) -> Tensor:
    """Return offsets (2, ...) that are shorter ``by`` (...) metres, but not shorter than a hundredth."""
    share = (by / length(offset, CLOSEST)).clamp_max(0.99)
    return offset * (1 - share)


def off_line(offset: Tensor, heading: Tensor) -> Tensor:
    """Return offsets from others (2, K, N); those exactly ahead of headings (2, N) are a little to the left.

    Else two who meet head-on make way to no side.
    """
    ahead = -dot(offset, heading.unsqueeze(1))
    tie = (cross(heading.unsqueeze(1).expand_as(offset), offset).abs() < EXACT * ahead).to(offset.dtype)
    return offset + tie * OFF_LINE * ahead * -left(heading).unsqueeze(1)


def repulsion(offset: Tensor, step: Tensor, strength: float, sigma: float) -> tuple[Tensor, Tensor]:
    """Return how strongly others repel (K, N), and in which direction (2, K, N) (eqs. 3 and 4).

    Lines of equal potential V0 exp(-b / sigma) around a person are ellipses with the foci p, where they are,
    and q, where their next step ends. With the distances r and s to p and q, unit vectors m and n away from
    them, and the ellipse's semi-minor axis b, 2 b = sqrt((r + s)^2 - |pq|^2), one finds b = sqrt(r s) |m +
    n| / 2: no small difference of large numbers. The gradient of b is (r + s) / (2 sqrt(r s)) long, and
    bisects the angle between m and n; between the foci it is 0. Distances to them are `CLOSEST` at least.

    Args:
        offset: From each other person to oneself (2, K, N), metres.
        step: From each other person to where their step ends (2, K, N), metres: Delta t times the velocity.
        strength: V0, m^2/s^2.
        sigma: Range, metres.
    """
    beyond = offset - step
    near, far = length(offset, CLOSEST), length(beyond, CLOSEST)
    both = offset / near + beyond / far
    size = length(both, 1e-6)
    mean = (near * far).sqrt()
    fall = (mean * size * (-0.5 / sigma)).exp()
    return fall * (near + far) / mean * (0.5 * strength / sigma), both / size


def view_weight(force: Tensor, heading: Tensor, angle: float, out_of_view: float) -> Tensor:
    """Return the weight (K, N) of forces (2, K, N): 1 from within degrees of the heading (2, N) (eq. 8)."""
    seen = -dot(force, heading.unsqueeze(1)) >= math.cos(math.radians(angle))
    return out_of_view + (1 - out_of_view) * seen.to(force.dtype)


def wall_force(offset: Tensor, weight: Tensor, strength: float, reach: float) -> Tensor:
    """Return the sum of the walls' forces on each person (2, N) (eq. 5), of points at offsets (2, M, N).

    Each counts with ``weight`` (M, N); ``strength`` is U0, m^2/s^2, and ``reach`` R, metres.
    """
    if not len(weight):
        return offset.new_zeros(2, weight.shape[1])
    distance = length(offset, 1e-6)
    force = offset * (weight * (distance * (-1 / reach)).exp() * (strength / reach) / distance)
    # one after the other: a sum's rounding would depend on how many points act on others
    return force.cumsum(1)[:, -1]


def wall_points(table: SegmentTable, place: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
    """Return the M points of walls, within the table's reach, that act on people at ``place`` (2, N), metres.

    That is the offset from each to the person (2, M, N), metres, in the frame of the floor plan, and a weight
    (M, N): 1 for minima of the distance, down to -1 for maxima, 0 for points that do not act.

    The paper lets every border act with its nearest point (eq. 5), and leaves open what one border is. Here
    every *local minimum* of the distance along the outlines acts: a straight wall once, in however many
    pieces, a convex corner once, both jambs of a doorway, both sides of a corridor. Borders do not hide each
    other.

    Where an outline bends a little towards the person there are two minima in almost the same place. One of
    them vanishes as the person walks on, in the corner between them, a local *maximum*. The maximum acts with
    the opposite sign, so that the force neither doubles nor jumps there. It counts in full while the nearest
    points of its two segments lie within 60 degrees of each other, and not at all from 90 degrees on.

    Differentiable with respect to ``place``. Without a map, row -1, there are none.
    """
    number, valid = table.nearest(place, row, place.new_full(row.shape, table.reach))
    wall = table.segments.index_select(1, number.flatten()).unflatten(1, number.shape)
    start, along, own, end, before, after, length_before = wall.split((2, 2, 7, 2, 2, 2, 1))
    length, convex = own[0], own[5]
    seen = valid > 0
    off, off_end = (torch.where(seen, place.unsqueeze(1) - corner, 0) for corner in (start, end))
    # the end of a segment is the start of the next, to the last bit: so are these of both
    t, t_end, past = dot(off, along), dot(off_end, along), dot(off, before)
    offset = off - along * t.clamp_min(0).minimum(length)
    near = seen & (dot(offset, offset) < table.reach**2)

    # A foot inside the segment; or its start, where the segment before has no foot either. A pointed end
    # may be seen from one side only: then it is the start of no segment that the person is outside of.
    foot, first = (t > 0) & (t_end < 0), (t <= 0) & (past >= 0)
    last = (t_end >= 0) & (dot(off_end, after) <= 0) & (cross(after, off_end) >= 0)
    acts = near & (foot | first | last)

    hollow = near & (convex == 0) & (t > 0) & (past < 0) & (cross(before, off) < 0)
    nearest_before = off + before * (-past).minimum(length_before[0])
    likeness = dot(*(direction(torch.where(hollow, part, 0)) for part in (offset, nearest_before)))
    weight = torch.where(hollow, -(2 * likeness).clamp(0, 1), 0)
    return torch.cat((offset, off), dim=1), torch.cat((acts.to(weight.dtype), weight))


def social_force_velocity(
    position: Tensor,
    velocity: Tensor,
    desired_velocity: Tensor,
    pref_speed: Tensor,
    mask: Tensor,
    settings: SocialForceSettings,
    seconds: float,
    identity: Tensor,
    walls: Callable[[Tensor, Tensor | None], Tensor] | None = None,
    fluctuation: Tensor | None = None,
    radius: Tensor | None = None,
) -> Tensor:
    """Return the velocities (B, A, 2) that the forces lead to after ``seconds``, m/s; 0 for absent people.

    Differentiable with respect to positions, velocities, desired velocities and speeds.

    Args:
        position: Positions (B, A, 2), metres.
        velocity: Current velocities (B, A, 2), m/s: those walked (eq. 10 keeps one not cut off).
        desired_velocity: Only the direction counts (B, A, 2); 0: to stand still.
        pref_speed: Preferred speeds (B, A), m/s.
        mask: Which people are present (B, A) bool: they act on the others and get a velocity.
        settings: The model's parameters.
        seconds: For which the velocities are held.
        identity: A number of its own for each person (B, A) long: people at the same place are pushed apart
            in a direction drawn by both.
        walls: Gives the walls' forces (2, N) on people at places (2, N), ``rows`` (N,) of all B * A; None:
            no walls.
        fluctuation: A further acceleration (B, A, 2), m/s^2.
        radius: Radii of the bodies (B, A), metres, None for `BODY_RADIUS`. Forces are those between people
            of that radius, at the distance less what both are wider.
    """
    wider = torch.zeros_like(pref_speed) if radius is None else radius - BODY_RADIUS
    rows = None if mask.all() else mask.flatten().nonzero()[:, 0]
    if rows is not None:  # placeholders of absent people
        position, velocity = (torch.where(mask[..., None], part, 0) for part in (position, velocity))
    index, near = nearest(position, mask, settings.neighbor_dist, settings.max_neighbors, rows)
    more = wider.flatten().index_select(0, index.flatten()).view(index.shape) + _of(wider.view(1, -1), rows)
    place, speed = (part.flatten(0, 1).T.contiguous() for part in (position, velocity))
    heading = direction(_of(desired_velocity.flatten(0, 1).T, rows))
    liked = _of(pref_speed.flatten()[None], rows)
    top_speed, desired = liked * settings.top_speed_ratio, liked * heading
    parts = max(1, math.ceil(seconds / LONGEST_STEP - 1e-6))
    for part in range(parts):
        own_place, own_speed = _of(place, rows), _of(speed, rows)
        force = (desired - own_speed) / settings.tau  # eq. 2
        if len(index):
            theirs = torch.cat((place, speed * settings.step_time))
            theirs = theirs.index_select(1, index.flatten()).view(4, *index.shape)
            offset = own_place.unsqueeze(1) - theirs[:2]
            together = (offset == 0).all(0)
            together = together if near is None else together & near
            if bool(together.any()):
                offset = offset + _apart(together, index, rows, identity.flatten(), offset.dtype)
            offset = closer(off_line(offset, heading), more)
            push, away = repulsion(offset, theirs[2:], settings.strength, settings.sigma)
            push = push * view_weight(away, heading, settings.view_angle, settings.out_of_view)
            # one after the other: a sum's rounding would depend on how many people other scenes have
            force = force + ((push if near is None else push * near) * away).cumsum(1)[:, -1]
        if walls is not None:
            force = force + walls(own_place, rows)
        if fluctuation is not None:
            force = force + _of(fluctuation.flatten(0, 1).T, rows)
        own_speed = own_speed + force * (seconds / parts)
        own_speed = own_speed * (top_speed / length(own_speed, 1e-6)).clamp_max(1)
        speed = own_speed if rows is None else speed.index_copy(1, rows, own_speed)
        if part + 1 < parts:
            place = place + speed * (seconds / parts)
    speed = speed.T.reshape(position.shape)
    return speed if rows is None else torch.where(mask[..., None], speed, 0)


def _of(values: Tensor, rows: Tensor | None) -> Tensor:
    return values if rows is None else values.index_select(1, rows)


def _apart(
    together: Tensor, index: Tensor, rows: Tensor | None, identity: Tensor, dtype: torch.dtype
) -> Tensor:
    """Return offsets (2, K, N) for people at the same place: `CLOSEST` long, opposite for both of a pair."""
    other, own = together.nonzero(as_tuple=True)
    theirs = identity[index[other, own]]
    mine = identity[own if rows is None else rows[own]]
    key = randomness.join(torch.minimum(mine, theirs), "apart", torch.maximum(mine, theirs))
    angle = 2 * math.pi * randomness.uniform(key)
    way = CLOSEST * torch.stack((angle.cos(), angle.sin())) * torch.where(mine < theirs, 1, -1)
    offset = torch.zeros(2, *together.shape, dtype=dtype, device=together.device)
    offset[:, other, own] = way.to(dtype)
    return offset


class SocialForce(Policy):
    """People accelerate along the planner's path, away from each other and away from walls.

    The parameters of 1995, the default, are for open places and wide corridors: at 1.3 m/s a person does not
    get through a door narrower than 1.1 m. The preset ``indoor`` has softer walls. Where forces cancel,
    people stop.
    """

    def __init__(self, settings: SocialForceSettings = SocialForceSettings()) -> None:
        """Take the settings."""
        super().__init__(settings.dt)
        self.settings = settings

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write each person's velocity."""
        agents: Any = tensordict["agents"]
        mask, ids = agents["mask"], ids_of(tensordict)
        identity = randomness.join(tensordict["scene_key"], "social_force", ids)
        fluctuation = None
        if self.settings.fluctuation and not deterministic():
            step = (tensordict["time"] / TRACE_SECONDS).round().long()
            noise = drawn_vectors(tensordict, randomness.join(identity, step))
            fluctuation = self.settings.fluctuation * noise
        # the potential of who gives way begins at the centre, that of a body that gives none at its surface
        radius = agents["radius"][..., 0]
        gives_no_way = ~agents["controlled"] & ((agents["kind"] == ROBOT) | ~is_person_sized(radius))
        radius = torch.where(gives_no_way, radius + 2 * BODY_RADIUS, radius)
        tensordict["agents", "action"] = social_force_velocity(
            agents["history"][:, :, -1],
            agents["velocity"],
            agents["desired_velocity"],
            agents["pref_speed"][..., 0],
            mask,
            self.settings,
            self.decision_dt,
            identity,
            self._walls(tensordict) if self.settings.walls else None,
            fluctuation,
            radius,
        )
        return tensordict

    def _walls(self, tensordict: TensorDictBase) -> Callable[[Tensor, Tensor | None], Tensor]:
        """Return the walls' forces (2, N): a function of places (2, N) and rows (N,) of B * A people."""
        bank, settings = maps_of(tensordict), self.settings
        radius = cast("Tensor", agents_of(tensordict)["radius"])
        poses, ids = cast("Tensor", tensordict["scene_pose"]), cast("Tensor", tensordict["map_id"])
        wider, pose = radius.flatten() - BODY_RADIUS, poses.repeat_interleave(radius.shape[1], 0)
        row = bank.index(ids.flatten()).repeat_interleave(radius.shape[1])

        def force(place: Tensor, rows: Tensor | None) -> Tensor:
            mine = [part if rows is None else part.index_select(0, rows) for part in (pose, row, wider)]
            table = bank.walls.segments(settings.wall_reach, hollows=False, dtype=place.dtype)
            offset, weight = wall_points(table, move_to_map(place.T, mine[0]).T.contiguous(), mine[1])
            total = wall_force(closer(offset, mine[2]), weight, settings.wall_strength, settings.wall_range)
            return turn_to_scene(total.T, mine[0]).T

        return force
