"""What comes of a decision: where bodies go, and what they touch."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Contacts(NamedTuple):
    """Who touches whom at each trace point.

    Attributes:
        agent: Whether another person is touched at trace point s (B, A, S) bool.
        wall: Whether a wall is touched (B, A, S) bool.
    """

    agent: Tensor
    wall: Tensor


class Motion(NamedTuple):
    """What comes of a decision of S trace points.

    Attributes:
        trace: Positions every 0.1 s (B, A, S, 2), metres.
        agent_contact: Another agent is touched in that 0.1 s (B, A, S) bool.
        wall_contact: A wall is (B, A, S) bool.
        reached: The agent that walks has come within 0.3 m of its goal until then (B, A, S) bool.
    """

    trace: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
