"""The planner's answer: people's paths, and the guidance along them."""

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.maps.planning.planar import Frame
from pedzoo.maps.planning.waypoint_table import WaypointLookup

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
    points: Tensor, waypoint: Tensor, frame: Frame, length: Tensor, beyond: Tensor
) -> tuple[Tensor, Tensor]:
    """Return where agents walk (..., 2), unit vectors, and how far it is to their waypoints (...,)."""
    way = waypoint - points
    distance = way.norm(dim=-1)
    unit = way / distance.clamp_min(EPSILON)[..., None]
    # on the waypoint the path goes on along the second segment
    there = length < EPSILON
    return torch.where(there[..., None], frame.turn_to_scene(beyond), unit), distance
