"""Small pure functions on positions and poses, all batched and differentiable."""

from __future__ import annotations

import torch
from torch import Tensor


def rotate(vectors: Tensor, direction: Tensor) -> Tensor:
    """Turn ``vectors`` (..., 2) by the angle of the unit vectors ``direction`` (..., 2)."""
    c, s = direction.unbind(-1)
    x, y = vectors.unbind(-1)
    return torch.stack((c * x - s * y, s * x + c * y), dim=-1)


def unrotate(vectors: Tensor, direction: Tensor) -> Tensor:
    """Turn ``vectors`` (..., 2) back by the angle of ``direction`` (..., 2): the inverse of `rotate`."""
    c, s = direction.unbind(-1)
    x, y = vectors.unbind(-1)
    return torch.stack((c * x + s * y, c * y - s * x), dim=-1)


def limit_speed(velocity: Tensor, top_speed: Tensor) -> Tensor:
    """Return velocities (..., 2) shortened to at most ``top_speed`` (...)."""
    velocity = velocity.clamp(-1e6, 1e6)  # the square of more is infinite
    speed = velocity.square().sum(-1).clamp_min(1e-12).sqrt()
    return velocity * (top_speed / speed).clamp_max(1.0).unsqueeze(-1)


def heading_of(velocity: Tensor, before: Tensor | None = None, slowest: float = 0.0) -> Tensor:
    """Return the directions (...) of velocities (..., 2), radians from the x axis.

    Args:
        velocity: In m/s.
        before: The answer (...) where a velocity is not faster than ``slowest``; None for 0.
        slowest: In m/s.
    """
    moves = velocity.square().sum(-1) > slowest * slowest
    x, y = velocity.unbind(-1)
    # the angle of a zero vector has no gradient
    angle = torch.atan2(torch.where(moves, y, 0.0), torch.where(moves, x, 1.0))
    return angle if before is None else torch.where(moves, angle, before)


def nearest_part(away: Tensor, move: Tensor) -> Tensor:
    """Return at which part (...), 0 to 1, of a straight relative move (..., 2) two are nearest; no gradient.

    Args:
        away: Relative places at its beginning (..., 2).
        move: How these change.
    """
    part = -(away * move).sum(-1) / move.square().sum(-1).clamp_min(1e-9)
    return part.detach().clamp(0, 1)


def opposed(ahead: Tensor) -> Tensor:
    """Return which pairs of agents go opposite ways (..., A, A) bool, within 60 degrees.

    Args:
        ahead: Unit vectors in which people are going (..., A, 2); zero for nowhere.
    """
    return (ahead.unsqueeze(-2) * ahead.unsqueeze(-3)).sum(-1) < -0.5


def identity_pose(scenes: int, device: torch.device | None = None) -> Tensor:
    """Return the scene poses (B, 4) that leave every scene where its floor plan is."""
    return torch.tensor([0.0, 1.0, 0.0, 0.0], device=device).repeat(scenes, 1)


def turn_to_scene(vectors: Tensor, pose: Tensor) -> Tensor:
    """Mirror, then rotate map-frame directions (B, ..., 2) into the scene of ``pose`` (B, 4)."""
    pose = _align(pose, vectors)
    mirrored = torch.stack((vectors[..., 0], vectors[..., 1] * pose[..., 1]), dim=-1)
    return rotate(mirrored, _direction(pose))


def turn_to_map(vectors: Tensor, pose: Tensor) -> Tensor:
    """Turn scene directions (B, ..., 2) back into the map's frame: the inverse of `turn_to_scene`."""
    pose = _align(pose, vectors)
    turned = unrotate(vectors, _direction(pose))
    return torch.stack((turned[..., 0], turned[..., 1] * pose[..., 1]), dim=-1)


def move_to_scene(points: Tensor, pose: Tensor) -> Tensor:
    """Move map-frame positions (B, ..., 2) into the scene of ``pose`` (B, 4)."""
    return turn_to_scene(points, pose) + _align(pose, points)[..., 2:]


def move_to_map(points: Tensor, pose: Tensor) -> Tensor:
    """Move scene positions (B, ..., 2) to where they are on the floor plan: inverse of `move_to_scene`."""
    return turn_to_map(points - _align(pose, points)[..., 2:], pose)


def _direction(pose: Tensor) -> Tensor:
    return torch.stack((pose[..., 0].cos(), pose[..., 0].sin()), dim=-1)


def _align(pose: Tensor, like: Tensor) -> Tensor:
    return pose.view(pose.shape[0], *[1] * (like.dim() - 2), 4)
