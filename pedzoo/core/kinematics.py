"""Velocities and straight moves of agents: pure functions, differentiable, on any device."""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.geometry import nearest_part
from pedzoo.core.types import GOAL_RADIUS

TURNS_FROM = 0.05
"""m/s: the body faces where it moves if it is faster; else it keeps its heading."""


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


def passes(begin: Tensor, end: Tensor, goal: Tensor) -> Tensor:
    """Return which straight moves (..., 2) come within 0.3 m of the goal (..., 2), (...,) bool; metres."""
    away, move = begin - goal, end - begin
    nearest = away + nearest_part(away, move).unsqueeze(-1) * move
    return nearest.square().sum(-1) < GOAL_RADIUS**2
