"""The planner's answer: people's paths, and the guidance along them."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.planning.planar import ScenePose
from pedzoo.maps.planning.waypoint_table import WaypointLookup
from pedzoo.maps.walls import LocalWalls

EPSILON = 1e-6
"""Metres: an agent so near to a point is on it."""


class NextWaypoints(NamedTuple):
    """Where people's paths lead, in the scene's frame, metres."""

    waypoint: Tensor
    """The farthest point of the path in sight (P, 2); where none leads to the goal, the person's position."""
    next_waypoint: Tensor
    """The waypoint after that (P, 2): the same where the path ends."""
    goal_point: Tensor
    """The goal (P, 2)."""
    distance: Tensor
    """Length of the path to the goal (P,): ``inf`` where none leads to it, 0 for people without a goal."""


class Guidance(NamedTuple):
    """Carrots and desired velocities of people, in the scene's frame, metres and seconds."""

    goal: Tensor
    """The carrot (P, 2)."""
    desired_velocity: Tensor
    """``pref_speed`` towards the next waypoint (P, 2)."""
    waypoint: Tensor
    """As in `NextWaypoints` (P, 2)."""
    goal_point: Tensor
    """As in `NextWaypoints` (P, 2)."""
    distance: Tensor
    """As in `NextWaypoints` (P,)."""


def segments(home: Tensor, waypoints: WaypointLookup) -> tuple[Tensor, Tensor, Tensor]:
    """Return the lengths (P,) of the next two segments of people's paths, and where it goes then (2, P)."""
    way, second = waypoints.waypoint - home, waypoints.after - waypoints.waypoint
    length, second_length = torch.hypot(*way), torch.hypot(*second)
    # beyond the goal the path goes on as it came
    beyond = torch.where(
        second_length < EPSILON,
        way / length.clamp_min(EPSILON),
        second / second_length.clamp_min(EPSILON),
    )
    return length, second_length, beyond


def heading(
    points: Tensor, waypoint: Tensor, frame: ScenePose, length: Tensor, beyond: Tensor
) -> tuple[Tensor, Tensor]:
    """Return where agents walk (..., 2), unit vectors, and how far it is to their waypoints (...,)."""
    way = waypoint - points
    distance = way.norm(dim=-1)
    unit = way / distance.clamp_min(EPSILON)[..., None]
    # on the waypoint the path goes on along the second segment
    there = length < EPSILON
    return torch.where(there[..., None], frame.turn_to_scene(beyond), unit), distance


_SPACING = 0.3
"""Metres between the points looked at: with the clearance around each, no wall fits between two of them."""

_PARTS = 3
"""How many parts of the path beyond the waypoint are tried: all of it, a half and a quarter."""


def seen_beyond(
    walls: LocalWalls, home: Tensor, waypoint: Tensor, beyond: Tensor, rest: Tensor, farthest: float
) -> Tensor:
    """Return how far beyond the waypoint agents see their carrot (*E): ``rest``, a half, a quarter, or not.

    It is seen if points of the straight line to it, 0.3 m apart, keep a body's radius from walls; on coarse
    floor plans up to 0.71 cells more. Places ``home`` and ``waypoint`` (2, *E) are in the map's frame, and
    ``beyond`` (2, *E) is where the path goes from the waypoint. No line is longer than ``farthest``, metres.
    """
    end = waypoint + beyond * rest
    spacing = _SPACING / torch.hypot(*(end - home)).clamp_min(_SPACING)
    begin, corner, end = walls.cells(torch.stack((home, waypoint, end), dim=1)).unbind(1)
    # made on the device: a list of numbers would be copied there at every step
    parts = 0.5 ** torch.arange(_PARTS, device=rest.device).view(-1, *[1] * rest.dim())
    number = torch.arange(1, math.ceil(farthest / _SPACING) + 1, device=rest.device)
    share = (number.view(-1, *[1] * rest.dim()) * spacing).clamp_max(1)
    to = corner.unsqueeze(1) + parts * (end - corner).unsqueeze(1) - begin.unsqueeze(1)
    points = begin[:, None, None] + share.unsqueeze(0).unsqueeze(1) * to.unsqueeze(2)
    least = walls.least_at(points.flatten(1, 2)).unflatten(0, (_PARTS, -1)).amin(1)
    seen = least >= BODY_RADIUS
    return rest * (parts * seen).amax(0)
