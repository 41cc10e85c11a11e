"""How people look in pictures: where they face, how far they step, and how large they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.geometry import heading_of
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.sim.state import State

SHOULDERS = (0.13, 0.23)
"""Half axes of a person from above, along and across where it faces, metres."""

HEAD, FACE, FACE_AHEAD = 0.1, 0.07, 0.05
"""Radii of a head and of the face on it from above, and how far ahead the face lies, metres."""

SKIN, HAIR = (226, 180, 150), (66, 48, 40)
"""RGB."""

_WINDOW = 3
"""Trace points before and after one over which people's headings and speeds are means: 0.6 s in all."""

_TURNS = 0.08
"""Metres in such a time from which on people face where they walk."""

_JUMP = 1.0
"""Metres in 0.1 s that no person walks: another person took the slot."""


def shoulders(heading: float) -> NDArray[np.float64]:
    """Return the outline (24, 2) of shoulders around the origin, metres; ``heading`` in radians."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    along, across = SHOULDERS[0] * np.cos(angle), SHOULDERS[1] * np.sin(angle)
    c, s = np.cos(heading), np.sin(heading)
    return np.stack((along, across), 1) @ np.array([[c, s], [-s, c]])


class Stance(NamedTuple):
    """How agents stand, for pictures alone: bodies of physics are discs.

    Attributes:
        heading: Where they face (B, A), radians.
        walked: How far they have walked (B, A), metres: their legs step by it.
        speed: How fast they walk (B, A), m/s: their steps are as long.
        robot: Which are robots (B, A) bool, drawn otherwise.
    """

    heading: Tensor
    walked: Tensor
    speed: Tensor
    robot: Tensor

    @classmethod
    def of(cls, state: State) -> Stance:
        """Return that of a state; how far people walked is what they like to walk in that time."""
        walked = state.clock.unsqueeze(1) * state.pref_speed
        return cls(state.heading, walked, state.velocity.norm(dim=-1), state.kind == ROBOT)

    @classmethod
    def along(cls, path: Tensor, kind: Tensor) -> Stance:
        """Return those at every point of ways, with T for B.

        Args:
            path: Positions every 0.1 s (A, T, 2), metres; not finite where nobody is.
            kind: Person or robot (A,).
        """
        last = path.shape[1] - 1
        points = torch.arange(last + 1, device=path.device)
        before, after = (points - _WINDOW).clamp_min(0), (points + _WINDOW).clamp_max(last)
        moves = path[:, after] - path[:, before]
        speed = moves.norm(dim=-1).nan_to_num(0.0) / ((after - before).clamp_min(1) * TRACE_SECONDS)
        # people who stand face where they last went, and at first where they will go
        turned = moves.norm(dim=-1) > _TURNS
        latest = torch.where(turned, points, -1).cummax(1).values
        first = turned.int().argmax(1, keepdim=True)
        kept = torch.where(latest < 0, first, latest)
        heading = heading_of(moves, torch.zeros_like(speed), _TURNS).gather(1, kept)
        steps = path.diff(dim=1).norm(dim=-1).nan_to_num(0.0)
        steps = torch.where(steps < _JUMP, steps, 0.0)
        walked = torch.nn.functional.pad(steps.cumsum(1), (1, 0))
        return cls(heading.T, walked.T, speed.T, (kind == ROBOT).expand(last + 1, -1))

    def scene(self, number: int) -> Stance:
        """Return those of one scene, with B = 1."""
        return Stance(*(value[[number]] for value in self))
