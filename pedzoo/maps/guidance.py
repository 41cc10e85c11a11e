"""What the planner says: where people's ways lead, and what they are told."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Look(NamedTuple):
    """Where people's ways lead, in the scene's frame, metres."""

    waypoint: Tensor
    """The farthest point of the way in sight (P, 2); where none leads to the goal, the person's position."""
    next_waypoint: Tensor
    """The waypoint after that (P, 2): the same where the way ends."""
    goal_point: Tensor
    """The goal (P, 2)."""
    distance: Tensor
    """Length of the way to the goal (P,): ``inf`` where none leads to it, 0 for people without a goal."""


class Guidance(NamedTuple):
    """What people are told, in the scene's frame, metres and seconds."""

    goal: Tensor
    """The carrot (P, 2)."""
    desired_velocity: Tensor
    """``pref_speed`` towards the next waypoint (P, 2)."""
    waypoint: Tensor
    """As in `Look` (P, 2)."""
    goal_point: Tensor
    """As in `Look` (P, 2)."""
    distance: Tensor
    """As in `Look` (P,)."""
