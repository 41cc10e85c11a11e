"""Constants of a simulation: goals, deadlines, sub-steps. How people yield is in `pedzoo.policies`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.types import AHEAD_SECONDS, GOAL_RADIUS, STEP_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.scenario import PreparedScenario
from pedzoo.sim.script import Script
from pedzoo.sim.state import State

TIME_RATIO, LEAST_TIME_LIMIT = 4.0, 20.0
"""Time limit of a goal, divided by the time of its path at the preferred speed; the least one, seconds."""


@dataclass(frozen=True)
class Rules:
    """Constants of all scenes of a simulation.

    Attributes:
        guidance: The planner's carrots and desired velocities of all agents.
        ticks: S, trace points of 0.1 s in one decision.
        substeps: M, sub-steps of every 0.1 s.
        goals: Goals that an agent has to reach.
        leave: An agent that has reached them all leaves the scene.
        keep_goal: An agent without a later goal keeps the one that it has reached; else it has none, and
            stands.
        wheels: Some bodies have wheels or a limited acceleration; without it `State.drive` and both
            accelerations are not looked at.
        waits: Says how long people wait where their goals are (B, A), seconds; None where no person does.
        script: Plays recorded people back; None for none.
        deadline: Seconds for every goal; None as `deadline` says.
    """

    guidance: Callable[[State], Guidance]
    ticks: int
    substeps: int
    goals: int = 1
    leave: bool = True
    keep_goal: bool = False
    wheels: bool = False
    waits: Callable[[State], Tensor] | None = None
    script: Script | None = None
    deadline: float | None = None


def rules_of(
    prepared: PreparedScenario,
    ticks: int,
    substeps: int,
    device: torch.device | str = "cpu",
    deadline: float | None = None,
) -> Rules:
    """Return the rules of a scenario for decisions of S ``ticks``, for scenes on a device.

    Raises:
        UserError: A deadline that is no time, or one for people of recordings, who have their own.
    """
    scenario, script = prepared.scenario, prepared.script
    check_deadline(deadline)
    if deadline is not None and script is not None:
        raise UserError(f"deadline {deadline}: people of recordings have the time that they took there")

    script = None if script is None else script.to(device)
    waits = partial(_pauses, prepared) if script is None else script.pauses
    return Rules(
        guidance=partial(_guidance, prepared),
        ticks=ticks,
        substeps=substeps,
        goals=scenario.goals,
        leave=scenario.finished == "leave",
        wheels=scenario.wheels,
        waits=waits if scenario.waits else None,
        script=script,
        deadline=deadline,
    )


def _pauses(prepared: PreparedScenario, state: State) -> Tensor:
    return prepared.scenario.pauses(Draws(state.key), state.goal_index)


def _guidance(prepared: PreparedScenario, state: State) -> Guidance:
    """Return the planner's guidance of all agents; people who wait go back to their place in one step."""
    guidance = prepared.planner.guidance(
        state.position,
        torch.where(state.mask, state.goal_id, -1),
        state.row,
        state.pose,
        state.pref_speed,
        AHEAD_SECONDS,
        prepared.fastest,
    )
    if not prepared.scenario.waits:
        return guidance
    holds = state.holds.unsqueeze(2)
    back = (guidance.goal_point - state.position) / STEP_SECONDS
    speed = back.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    back = back * (state.pref_speed.unsqueeze(2) / speed).clamp_max(1.0)
    return guidance._replace(
        goal=torch.where(holds, guidance.goal_point, guidance.goal),
        desired_velocity=torch.where(holds, back, guidance.desired_velocity),
    )


def planned(way: Tensor) -> Tensor:
    """Return how far people with paths (B, A) of such lengths to their goals have to walk, metres."""
    return (way.detach() - GOAL_RADIUS).clamp_min(0)


def deadline(clock: Tensor, way: Tensor, pref_speed: Tensor, seconds: float | None = None) -> Tensor:
    """Return when a goal at the end of ``way`` (B, A), metres, must be reached: in four times its time.

    At least 20 s from ``clock`` (B,), the end of the decision in which the goal was drawn. Where ``seconds``
    are given, there are so many for every goal instead.
    """
    ways, least = (TIME_RATIO, LEAST_TIME_LIMIT) if seconds is None else (0.0, seconds)
    return clock.unsqueeze(1) + torch.clamp(ways * way / pref_speed, min=least)


def check_deadline(seconds: float | None) -> None:
    """Refuse seconds for every goal that are no time; None stands for the usual ones."""
    if seconds is not None and not 0 < seconds < math.inf:
        raise UserError(f"deadline {seconds}: expected a number of seconds above 0")
