"""When people reach a goal, on the 0.1 s trace and not only at decisions; deadlines; people who wait."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.types import GOAL_RADIUS, STEP_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.state import CLOCK_ROUNDING, MotionInput, State

LEAST_TIME_LIMIT = 20.0
"""Least time limit for a goal, seconds."""

TIME_RATIO = 4.0
"""Time limit for a goal, divided by the time that its path takes at the preferred speed."""


def arrived(path: Tensor, goal: Tensor, inputs: MotionInput) -> Tensor:
    """Return which agents have come within 0.3 m of their goal until each trace point (B, A, S) bool.

    Args:
        path: Sub-steps (2, S * M, B, A), metres.
        goal: Goals (B, A, 2).
        inputs: Says which agents may.
    """
    x, y = path.detach() - goal.detach().movedim(-1, 0).unsqueeze(1)
    near = (torch.addcmul(x * x, y, y) < GOAL_RADIUS**2) & inputs.wanted
    return (near.unflatten(0, (-1, inputs.substeps)).any(1).cumsum(0) > 0).permute(1, 2, 0)


def planned(way: Tensor) -> Tensor:
    """Return how far people with paths (B, A) of such lengths to their goals have to walk, metres."""
    return (way.detach() - GOAL_RADIUS).clamp_min(0)


def deadline(clock: Tensor, way: Tensor, pref_speed: Tensor, seconds: float | None = None) -> Tensor:
    """Return when a goal at the end of ``way`` (B, A) must be reached: four times the time that it takes.

    At least 20 s from ``clock`` (B,), the end of the decision in which the goal was drawn; everything in
    seconds and metres. Where ``seconds`` are given, there are so many for every goal instead.
    """
    ways, least = (TIME_RATIO, LEAST_TIME_LIMIT) if seconds is None else (0.0, seconds)
    return clock.unsqueeze(1) + torch.clamp(ways * way / pref_speed, min=least)


def check_deadline(seconds: float | None) -> None:
    """Check the seconds that people are given for every goal, None for the usual ones.

    Raises:
        UserError: They are no time.
    """
    if seconds is not None and not 0 < seconds < math.inf:
        raise UserError(f"deadline {seconds}: expected a number of seconds above 0")


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
    before = torch.nn.functional.pad(state.goal_index[:, :-1], (1, 0), value=-1)
    called = state.controlled & pause.isinf() & (before > state.goal_index)
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
