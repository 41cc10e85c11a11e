"""When people reach a goal, on the 0.1 s trace and not only at decisions, and their next goals."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.types import GOAL_RADIUS
from pedzoo.sim.scenario import PreparedScenario
from pedzoo.sim.step_result import MotionInput

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


def later_goals(prepared: PreparedScenario, key: Tensor, first: Tensor) -> Tensor:
    """Return the goals (B, A, G) that follow the ``first`` (B, A), drawn ahead; -1 where there are none.

    Args:
        prepared: Draws them; ``later`` of its scenario are used in turn.
        key: Of the scenes (B,) long.
        first: Their first goals; -1 for none.
    """
    scenes, agents = first.shape
    scenario = prepared.scenario
    if not scenario.later:
        return torch.full((scenes, agents, 1), -1, device=first.device)
    scene = torch.arange(scenes, device=first.device).repeat_interleave(agents)
    slot = torch.arange(agents, device=first.device).repeat(scenes)
    draws, goal, goals = Draws(key[scene]), first.flatten(), []
    for number in range(1, scenario.later + 1):
        goal = scenario.next_goal(prepared, draws, slot, torch.full_like(slot, number), goal)
        goals.append(goal.view(scenes, agents))
    return torch.where((first >= 0).unsqueeze(2), torch.stack(goals, 2), -1)


def planned(way: Tensor) -> Tensor:
    """Return how far people with paths (B, A) of such lengths to their goals have to walk, metres."""
    return (way.detach() - GOAL_RADIUS).clamp_min(0)


def deadline(clock: Tensor, way: Tensor, pref_speed: Tensor, seconds: float | None = None) -> Tensor:
    """Return when a goal at the end of ``way`` (B, A) must be reached: four times the time that it takes.

    At least 20 s from ``clock`` (B,), the end of the decision in which the goal was drawn; everything in
    seconds and metres. Where ``seconds`` are given, there are so many for every goal instead.
    """
    ways, least = limits(seconds)
    return clock.unsqueeze(1) + torch.clamp(ways * way / pref_speed, min=least)


def check_deadline(seconds: float | None) -> None:
    """Check the seconds that people are given for every goal, None for the usual ones.

    Raises:
        UserError: They are no time.
    """
    if seconds is not None and not 0 < seconds < math.inf:
        raise UserError(f"deadline {seconds}: expected a number of seconds above 0")


def limits(seconds: float | None) -> tuple[float, float]:
    """Return how many times the way's own time people have for a goal, and how many seconds at least."""
    return (TIME_RATIO, LEAST_TIME_LIMIT) if seconds is None else (0.0, seconds)
