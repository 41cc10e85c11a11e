"""Baseline: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009), walls or not.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance": section 4 for agents, 5 for the
linear programs, 6 for walls. Order of steps and tolerance are those of the library RVO2, so that the answers
are RVO2's. Walls and programs are in loops (`_orca_loops`), on the CPU and in single precision.

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
from pedzoo.core.types import TOP_SPEED_RATIO, TRACE_SECONDS
from pedzoo.maps.bank import FASTEST
from pedzoo.maps.segments import Segments
from pedzoo.policies.neighbours import nearest, separation_push
from pedzoo.policies.policy import Policy, deterministic, drawn_vectors
from pedzoo.policies.rule_based._orca_loops import EPSILON, compiled_lines, compiled_solve

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
