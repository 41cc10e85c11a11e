"""The result of a decision: paths of bodies, their contacts, and distances."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

CONTACT_COST = 1.0
"""Metres of progress that a decision with a contact costs in the reward."""

CLOCK_ROUNDING = 1e-3
"""Seconds: clocks are sums of decisions."""


class Contacts(NamedTuple):
    """Contacts at each trace point.

    Attributes:
        agent: Whether another agent is touched at trace point s (B, A, S) bool.
        wall: Whether a wall is touched (B, A, S) bool.
    """

    agent: Tensor
    wall: Tensor


class Distances(NamedTuple):
    """How near others and walls are to each person; absent people have the reach and no normals.

    Attributes:
        agent: Least distance between centres (B, A), metres; the reach where none is nearer.
        wall: Signed distance from the centre to the nearest wall (B, A), metres, at most the reach.
        agent_normal: Unit vectors (B, A, 2) away from the nearest person, 0 where none is within reach.
        wall_normal: Unit vectors (B, A, 2) away from the nearest wall, 0 where none is within reach.
    """

    agent: Tensor
    wall: Tensor
    agent_normal: Tensor
    wall_normal: Tensor


class MotionInput(NamedTuple):
    """Motion of agents on the common path in a decision of S trace points.

    Attributes:
        velocity: In each 0.1 s (2, S, B, A), m/s, limits respected already.
        moving: Which agents it moves (B, A) bool; others are played back, or stay where they are.
        substeps: M, sub-steps of every 0.1 s.
        played: Paths of those who are played back (B, A, S, M, 2); None for none.
        wanted: Which agents may reach their goals (B, A) bool.
        command: What policies want (B, A, 2), as the agent's drive has it; None for nothing.
        owned: How agents move that the backend owns, whose paths are among those played back; None for none.
    """

    velocity: Tensor
    moving: Tensor
    substeps: int
    played: Tensor | None
    wanted: Tensor
    command: Tensor | None = None
    owned: OwnedMotion | None = None


class Motion(NamedTuple):
    """The result of a decision of S trace points.

    Attributes:
        trace: Positions every 0.1 s (B, A, S, 2), metres.
        agent_contact: Another agent is touched in that 0.1 s (B, A, S) bool.
        wall_contact: A wall is (B, A, S) bool.
        reached: The agent that walks has come within 0.3 m of its goal until then (B, A, S) bool.
        heading: Where bodies that the physics backend owns face at the end (B, A), radians, NaN for other
            agents; None where it owns none.
        turn_rate: How fast these bodies turn at the end (B, A), rad/s; None where it owns none.
    """

    trace: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    heading: Tensor | None = None
    turn_rate: Tensor | None = None


class OwnedMotion(NamedTuple):
    """How bodies that a physics backend owns move in a decision.

    Attributes:
        path: Positions at all sub-steps (B, A, S, M, 2), metres.
        heading: Where they face at the end (B, A), radians.
        turn_rate: How fast they turn at the end (B, A), rad/s.
    """

    path: Tensor
    heading: Tensor
    turn_rate: Tensor


class Events(NamedTuple):
    """The events of one decision of S trace points.

    Attributes:
        trace: Positions every 0.1 s (B, A, S, 2), metres.
        agent_contact: A body was touched in that 0.1 s (B, A, S) bool.
        wall_contact: A wall was (B, A, S) bool.
        reached: Goals reached until then (B, A, S) long.
        reward: Metres of path that got shorter, less `CONTACT_COST` for a contact (B, A).
        terminated: All agents have reached all goals (B,) bool.
        truncated: No other agent can in time, or the policy failed (B,) bool.
    """

    trace: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
