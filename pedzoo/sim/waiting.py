"""People who wait: they hold a place until their time is up, or until the person before them has gone on."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.state import State
from pedzoo.sim.step_result import CLOCK_ROUNDING


class WaitingUpdate(NamedTuple):
    """Places and goals in a decision of S trace points.

    Attributes:
        hits: Which agents have reached a goal until each trace point (B, A, S) bool; places to wait at are
            none.
        moves_on: Which agents take their next goal without having reached this one (B, A) bool.
        stands: As of `State`, at the end of the decision (B, A).
    """

    hits: Tensor
    moves_on: Tensor
    stands: Tensor


def waiting_update(pause: Tensor, state: State, near: Tensor, clock: Tensor) -> WaitingUpdate:
    """Return which people stop to wait and which move on.

    Args:
        pause: How long people wait at their goals (B, A), seconds: see `Scenario.pauses`.
        state: At the beginning of the decision.
        near: Which agents have come near their goal until each trace point (B, A, S) bool.
        clock: At its end (B,), seconds.
    """
    stops = near[..., -1] & (pause > 0)
    now = clock.unsqueeze(1)
    over = state.holds & (now + CLOCK_ROUNDING >= state.stands)
    before = torch.nn.functional.pad(state.drawn[:, :-1], (1, 0), value=-1)
    called = state.controlled & pause.isinf() & (before > state.drawn)
    moves_on = over | called
    stands = torch.where(moves_on, 0.0, torch.where(stops, now + pause, state.stands))
    return WaitingUpdate(near & ~stops.unsqueeze(-1), moves_on, stands)


def at_places(state: State, guidance: Guidance) -> Guidance:
    """Return the guidance of people who wait: to their place, as fast as that takes one step."""
    holds = state.holds.unsqueeze(2)
    back = (guidance.goal_point - state.position) / STEP_SECONDS
    speed = back.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    back = back * (state.pref_speed.unsqueeze(2) / speed).clamp_max(1.0)
    return guidance._replace(
        goal=torch.where(holds, guidance.goal_point, guidance.goal),
        desired_velocity=torch.where(holds, back, guidance.desired_velocity),
    )
