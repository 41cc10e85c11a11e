"""The planner's answer: people's paths, and the guidance along them."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from pedzoo.core.geometry import move_to_scene, turn_to_scene
from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.constants import EPSILON, LED_ON, SPACING
from pedzoo.maps.walls import LocalWalls

_PARTS = 3
"""How many parts of the path beyond the waypoint are tried: all of it, a half and a quarter."""


class Guidance(NamedTuple):
    """Short-term goals and desired velocities of people, in the scene's frame, metres and seconds."""

    goal: Tensor
    """The short-term goal (P, 2): the carrot, moved out as far as recorded people get in that time."""
    desired_velocity: Tensor
    """``pref_speed`` towards the next waypoint (P, 2)."""
    waypoint: Tensor
    """The farthest point of the path in sight (P, 2); where none leads to the goal, the person's position."""
    goal_point: Tensor
    """The goal (P, 2)."""
    distance: Tensor
    """Length of the path to the goal (P,): ``inf`` where none leads to it, 0 for people without a goal."""
    carrot: Tensor
    """The point of the path ahead (P, 2), or the last one before it that is in sight."""


class Waypoints(NamedTuple):
    """Where the paths of people (*E) lead, in the map's frame; x and y are rows."""

    home: Tensor
    """Where they are (2, *E)."""
    waypoint: Tensor
    """The next waypoint (2, *E)."""
    after: Tensor
    """The one after it (2, *E)."""
    goal: Tensor
    """The goal (2, *E)."""
    onward: Tensor
    """Metres of the path from the next waypoint to the goal (*E), ``inf`` where none leads there."""
    last: Tensor
    """Whether the waypoint after the next is the goal (*E) bool."""


def guidance_along(
    points: Tensor,
    paths: Waypoints,
    pose: Tensor,
    pref_speed: Tensor,
    seconds: float,
    walls: LocalWalls | None,
    fastest: float,
) -> Guidance:
    """Return the guidance of agents (B, A) along their paths in poses (B, 4): see `Planner.guidance`."""
    home, waypoint, pose = paths.home, paths.waypoint, pose.float()
    with torch.no_grad():
        way, second = waypoint - home, paths.after - waypoint
        length, second_length = torch.hypot(*way), torch.hypot(*second)
        # beyond the goal the path goes on as it came
        beyond = torch.where(
            second_length < EPSILON,
            way / length.clamp_min(EPSILON),
            second / second_length.clamp_min(EPSILON),
        )
        ahead = pref_speed * seconds
        # a second segment that does not end at the goal is as far as the carrot goes
        rest = (ahead - length).clamp_min(0)
        rest = torch.where(paths.last, rest, rest.minimum(second_length))
        if walls is not None:
            rest = _seen_beyond(walls, home, waypoint, beyond, rest, fastest * seconds)
        places = torch.stack((waypoint, paths.goal, waypoint + beyond * rest), dim=1)
        waypoint, point, carrot = move_to_scene(places.permute(2, 1, 3, 0), pose).unbind(1)
        straight = (length >= ahead).unsqueeze(-1)
    way = waypoint - points
    distance = way.norm(dim=-1)
    unit = way / distance.clamp_min(EPSILON)[..., None]
    # on the waypoint the path goes on along the second segment
    unit = torch.where((length < EPSILON)[..., None], turn_to_scene(beyond.movedim(0, -1), pose), unit)
    carrot = torch.where(straight, points + unit * ahead.unsqueeze(-1), carrot)
    goal = _moved_out(carrot, points, unit, ahead.unsqueeze(-1))
    velocity = unit * pref_speed.unsqueeze(-1)
    return Guidance(goal, velocity, waypoint, point, distance + paths.onward, carrot)


def _moved_out(carrot: Tensor, points: Tensor, unit: Tensor, ahead: Tensor) -> Tensor:
    """Return short-term goals (*E, 2) as far ``ahead`` (*E, 1), metres, as those of recorded people are.

    A carrot nearer to agents at ``points`` (*E, 2) is moved out along the line to it. That line bends towards
    the desired direction ``unit`` (*E, 2) near the carrot, so that goals do not jump as agents pass it.
    """
    way = carrot - points
    lacking = ahead * unit.norm(dim=-1, keepdim=True) - way.norm(dim=-1, keepdim=True)
    return carrot + torch.where(lacking > 0, lacking * normalize(way + LED_ON * unit, dim=-1), 0.0)


def _seen_beyond(
    walls: LocalWalls, home: Tensor, waypoint: Tensor, beyond: Tensor, rest: Tensor, farthest: float
) -> Tensor:
    """Return how far beyond the waypoint agents see their carrot (*E): ``rest``, a half, a quarter, or not.

    It is seen if points of the straight line to it, 0.3 m apart, keep a body's radius from walls; on coarse
    floor plans up to 0.71 cells more. Places ``home`` and ``waypoint`` (2, *E) are in the map's frame, and
    ``beyond`` (2, *E) is where the path goes from the waypoint. No line is longer than ``farthest``, metres.
    """
    end = waypoint + beyond * rest
    spacing = SPACING / torch.hypot(*(end - home)).clamp_min(SPACING)
    begin, corner, end = walls.cells(torch.stack((home, waypoint, end), dim=1)).unbind(1)
    # made on the device: a list of numbers would be copied there at every step
    parts = 0.5 ** torch.arange(_PARTS, device=rest.device).view(-1, *[1] * rest.dim())
    number = torch.arange(1, math.ceil(farthest / SPACING) + 1, device=rest.device)
    share = (number.view(-1, *[1] * rest.dim()) * spacing).clamp_max(1)
    to = corner.unsqueeze(1) + parts * (end - corner).unsqueeze(1) - begin.unsqueeze(1)
    points = begin[:, None, None] + share.unsqueeze(0).unsqueeze(1) * to.unsqueeze(2)
    least = walls.least_at(points.flatten(1, 2)).unflatten(0, (_PARTS, -1)).amin(1)
    return rest * (parts * (least >= BODY_RADIUS)).amax(0)


def differentiable(made: Guidance, points: Tensor, pref_speed: Tensor, seconds: float) -> Guidance:
    """Return the guidance of compiled loops as a function of points and speeds; waypoints are constants."""
    way = made.waypoint - points
    length = way.square().sum(-1, keepdim=True).clamp_min(EPSILON**2).sqrt()
    there = length.detach() <= EPSILON
    speed, ahead = pref_speed.unsqueeze(-1), pref_speed.unsqueeze(-1) * seconds
    beyond = made.desired_velocity / speed.detach()
    unit = torch.where(there, beyond, way / length)
    carrot = torch.where(length.detach() >= ahead.detach(), points + unit * ahead, made.carrot)
    distance = made.distance + (length - length.detach())[..., 0]
    goal = _moved_out(carrot, points, unit, ahead)
    return Guidance(goal, unit * speed, made.waypoint, made.goal_point, distance, carrot)
