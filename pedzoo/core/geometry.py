"""Small pure functions on positions, velocities and poses: batched, differentiable, on any device."""

import torch
from torch import Tensor

from pedzoo.core.types import GOAL_RADIUS

TURNS_FROM = 0.05
"""m/s: the body faces where it moves if it is faster; else it keeps its heading."""


def rotate(vectors: Tensor, direction: Tensor) -> Tensor:
    """Turn ``vectors`` (..., 2) by the angle of the unit vectors ``direction`` (..., 2)."""
    c, s = direction.unbind(-1)
    x, y = vectors.unbind(-1)
    return torch.stack((torch.addcmul(c * x, s, y, value=-1), torch.addcmul(c * y, s, x)), dim=-1)


def unrotate(vectors: Tensor, direction: Tensor) -> Tensor:
    """Turn ``vectors`` (..., 2) back by the angle of ``direction`` (..., 2): the inverse of `rotate`."""
    c, s = direction.unbind(-1)
    x, y = vectors.unbind(-1)
    return torch.stack((torch.addcmul(c * x, s, y), torch.addcmul(c * y, s, x, value=-1)), dim=-1)


def smooth_norm(vectors: Tensor) -> Tensor:
    """Return the lengths (...) of ``vectors`` (..., 2), with a finite gradient at 0."""
    return (vectors.square().sum(-1) + 1e-8).sqrt()


def limit_speed(velocity: Tensor, top_speed: Tensor) -> Tensor:
    """Return velocities (..., 2) shortened to at most ``top_speed`` (...)."""
    velocity = velocity.clamp(-1e6, 1e6)  # the square of more is infinite
    speed = velocity.square().sum(-1).clamp_min(1e-12).sqrt()
    return velocity * (top_speed / speed).clamp_max(1.0).unsqueeze(-1)


def heading_of(velocity: Tensor, before: Tensor | None = None, slowest: float = 0.0) -> Tensor:
    """Return the directions (...) of velocities (..., 2), m/s, radians from the x axis.

    It is ``before`` (...), or 0, where a velocity is not faster than ``slowest``, m/s.
    """
    moves = velocity.square().sum(-1) > slowest * slowest
    x, y = velocity.unbind(-1)
    # the angle of a zero vector has no gradient
    angle = torch.atan2(torch.where(moves, y, 0.0), torch.where(moves, x, 1.0))
    return angle if before is None else torch.where(moves, angle, before)


def direction_of(heading: Tensor) -> Tensor:
    """Return unit vectors (..., 2) of directions (...), radians from the x axis."""
    return torch.stack((heading.cos(), heading.sin()), dim=-1)


def closest_fraction(away: Tensor, move: Tensor) -> Tensor:
    """Return at which fraction (...), 0 to 1, of a straight relative move two are closest; no gradient."""
    part = -(away * move).sum(-1) / move.square().sum(-1).clamp_min(1e-9)
    return part.detach().clamp(0, 1)


def are_opposed(ahead: Tensor) -> Tensor:
    """Return which pairs with directions (..., A, 2) go opposite ways (..., A, A), within 60 degrees."""
    return (ahead.unsqueeze(-2) * ahead.unsqueeze(-3)).sum(-1) < -0.5


def identity_pose(scenes: int, device: torch.device | None = None) -> Tensor:
    """Return the scene poses (B, 4) that leave every scene where its floor plan is."""
    return torch.tensor([[0.0, 1.0, 0.0, 0.0]], device=device).expand(scenes, 4).contiguous()


def turn_to_scene(vectors: Tensor, pose: Tensor) -> Tensor:
    """Mirror, then rotate map-frame directions (B, ..., 2) into the scene of ``pose`` (B, 4)."""
    pose = _align(pose, vectors)
    mirrored = torch.stack((vectors[..., 0], vectors[..., 1] * pose[..., 1]), dim=-1)
    return rotate(mirrored, direction_of(pose[..., 0]))


def turn_to_map(vectors: Tensor, pose: Tensor) -> Tensor:
    """Turn scene directions (B, ..., 2) back into the map's frame: the inverse of `turn_to_scene`."""
    pose = _align(pose, vectors)
    turned = unrotate(vectors, direction_of(pose[..., 0]))
    return torch.stack((turned[..., 0], turned[..., 1] * pose[..., 1]), dim=-1)


def turn_matrix(pose: Tensor) -> Tensor:
    """Return the matrices (N, 2, 2) of `turn_to_map` for poses (N, 4)."""
    angle, mirror = pose[:, 0], pose[:, 1]
    c, s = angle.cos(), angle.sin()
    return torch.stack((c, s, -s * mirror, c * mirror), dim=-1).view(-1, 2, 2)


def move_to_scene(points: Tensor, pose: Tensor) -> Tensor:
    """Move map-frame positions (B, ..., 2) into the scene of ``pose`` (B, 4)."""
    return turn_to_scene(points, pose) + _align(pose, points)[..., 2:]


def move_to_map(points: Tensor, pose: Tensor) -> Tensor:
    """Move scene positions (B, ..., 2) to where they are on the floor plan: inverse of `move_to_scene`."""
    return turn_to_map(points - _align(pose, points)[..., 2:], pose)


def _align(pose: Tensor, like: Tensor) -> Tensor:
    return pose.view(pose.shape[0], *[1] * (like.dim() - 2), 4)


def blended(velocity: Tensor, command: Tensor, ticks: int) -> Tensor:
    """Return velocities (2, S, ...) of the S trace steps of a decision, blended instead of switched.

    The first step lies half-way between old and new velocity. The last one has the new velocity, from three
    steps on. The others make up for the first one: the decision ends where the command alone would lead. At
    most half of the commanded velocity is made up, so an agent that brakes does not walk backwards. Where
    half-way asks for more, the first step lies nearer to the command: a commanded stop comes at once.

    Args:
        velocity: Of the last 0.1 s (2, ...), m/s.
        command: What is wanted now (2, ...), m/s.
        ticks: S.
    """
    if ticks == 1:
        return command.unsqueeze(1)
    between = max(1, ticks - 2)
    half = 0.5 * (velocity - command)
    size = (half.square().sum(0) + 1e-12).sqrt()
    speed = (command.square().sum(0) + 1e-12).sqrt()
    half = half * (0.5 * between * speed / size).clamp_max(1.0)
    rest = [command - half / between] * between + [command] * (ticks - 1 - between)
    return torch.stack([command + half, *rest], dim=1)


def limited(velocity: Tensor, top_speed: Tensor) -> Tensor:
    """Return velocities (2, ..., B, A) shortened to top speeds (B, A)."""
    speed = velocity.square().sum(0).clamp_min(1e-12).sqrt()
    return velocity * (top_speed / speed).clamp_max(1.0)


def passes_goal(begin: Tensor, end: Tensor, goal: Tensor, radius: float = GOAL_RADIUS) -> Tensor:
    """Return which straight moves (..., 2) come within a radius of the goal (..., 2), (...,) bool; metres."""
    away, move = begin - goal, end - begin
    nearest = away + closest_fraction(away, move).unsqueeze(-1) * move
    return nearest.square().sum(-1) < radius**2
