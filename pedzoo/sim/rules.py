"""What holds for all scenes of a simulation: `kernel.step` reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.randomness import Draws
from pedzoo.core.types import AHEAD_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.arrival import at_places, check_deadline
from pedzoo.sim.scenario import PreparedScenario, Scenario
from pedzoo.sim.script import Script
from pedzoo.sim.state import State


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
        waits: Says for how long people wait where their goals are (B, A), seconds; None where no person does.
        script: Plays recorded people back; None for none.
        deadline: Seconds for every goal; None as `pedzoo.sim.arrival.deadline` says.
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
    guidance, leave = partial(_guidance, prepared), scenario.finished == "leave"
    if script is not None:
        script = script.to(device)
    waits = None
    if scenario.waits:
        waits = partial(_pauses, scenario) if script is None else script.pauses
    return Rules(
        guidance=guidance,
        ticks=ticks,
        substeps=substeps,
        goals=scenario.goals,
        leave=leave,
        wheels=scenario.wheels,
        waits=waits,
        script=script,
        deadline=deadline,
    )


def _pauses(scenario: Scenario, state: State) -> Tensor:
    """Return how long people of a scenario wait where their goals are (B, A), seconds."""
    return scenario.pauses(Draws(state.key), state.goal_index)


def _guidance(prepared: PreparedScenario, state: State) -> Guidance:
    """Return the planner's guidance of all agents."""
    guidance = prepared.planner.guidance(
        state.position,
        torch.where(state.mask, state.goal_id, -1),
        state.row,
        state.pose,
        state.pref_speed,
        AHEAD_SECONDS,
        prepared.fastest,
    )
    return at_places(state, guidance) if prepared.scenario.waits else guidance
