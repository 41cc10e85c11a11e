"""The only place where time passes: `step` takes scenes through one decision.

The environment, the warm start, imitation and recorded crowds call it, with or without gradients, on any
device. It has no loop over scenes or agents and reads nothing back to the host. The stepping controller does
not move people: it takes the blending and the scene batch from here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import torch
from torch import Tensor

from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import TURNS_FROM, blended, heading_of, limited
from pedzoo.core.randomness import Draws
from pedzoo.core.types import AHEAD_SECONDS, TRACE_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.arrival import check_deadline, deadline, planned
from pedzoo.sim.dynamics import driven
from pedzoo.sim.physics_parts.base import Physics
from pedzoo.sim.physics_parts.compiled_step import step_compiled, step_compiles
from pedzoo.sim.scenario import PreparedScenario, Scenario
from pedzoo.sim.state import State
from pedzoo.sim.step_result import CLOCK_ROUNDING, CONTACT_COST, Events
from pedzoo.sim.waiting import WaitingUpdate, at_places, waiting_update


class Playback(Protocol):
    """Agents that come, go and are played back; see `pedzoo.sim.replay.script.Script`."""

    def playback(self, state: State, failed: Tensor, points: int, substeps: int) -> Tensor:
        """Return the paths (B, A, S, M, 2) of agents that no policy moves."""
        ...

    def update_presence(self, before: State, after: State, points: int) -> tuple[State, Tensor]:
        """Let agents come, go and be taken over; return which were taken over, too (B, A) bool."""
        ...

    def ended(self, state: State) -> Tensor:
        """Return which scenes have ended (B,) bool."""
        ...


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
    script: Playback | None = None
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
    fixed = ticks, substeps, scenario.goals, leave, False, scenario.wheels
    return Rules(guidance, *fixed, waits, script, deadline)


def _pauses(scenario: Scenario, state: State) -> Tensor:
    """Return how long people of a scenario wait where their goals are (B, A), seconds."""
    return scenario.pauses(Draws(state.key), state.drawn)


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


def step(state: State, commands: Tensor, physics: Physics, rules: Rules) -> tuple[State, Guidance, Events]:
    """Return the result of a decision.

    A scene in which the command of a controlled agent is not finite stays as it is and is truncated. Agents
    without a goal stand.

    Args:
        state: The scenes.
        commands: Velocities (B, A, 2), m/s; for wheels as `pedzoo.sim.dynamics.driven` says. Those of agents
            that no policy moves do not matter.
        physics: Moves the bodies.
        rules: Of the scenes.
    """
    if physics.compiled and step_compiles(state, commands, rules):
        return step_compiled(state, commands, physics.bank, rules)
    finite = (commands.abs().amax(-1) < torch.inf) | ~state.controlled
    failed = state.failed | ~finite.all(1)
    running = ~failed.unsqueeze(1)
    moving = state.controlled & running
    walking = moving & (state.goal_id >= 0)
    command = torch.where(walking, commands.movedim(-1, 0), 0.0).clamp(-1e6, 1e6).contiguous()
    now = state.velocity.movedim(-1, 0).contiguous()
    if rules.wheels:
        holonomic = blended(now, limited(command, state.top_speed), rules.ticks)
        velocity, heading, turn_rate = driven(state, command, limited(holonomic, state.top_speed))
    else:
        command = limited(command, state.top_speed)
        velocity = limited(blended(now, command, rules.ticks), state.top_speed)
        heading, turn_rate = state.heading, state.turn_rate
    script = rules.script
    played = None if script is None else script.playback(state, failed, rules.ticks, rules.substeps)
    motion = physics.advance(state, velocity, moving, rules.substeps, played, command.movedim(0, -1))
    hits, waits = motion.reached, None
    if rules.waits is not None:
        end = state.clock + rules.ticks * TRACE_SECONDS
        waits = waiting_update(rules.waits(state), state, hits, end)
        hits = waits.hits
    hit = hits[..., -1]
    after, taken_over = _arrived(state, hits, motion.trace, failed, rules, waits)
    turned = heading_of(after.velocity, heading, TURNS_FROM)
    if rules.wheels:
        turned = torch.where(state.drive == HOLONOMIC, turned, heading)
    if motion.heading is not None and motion.turn_rate is not None:
        theirs = ~motion.heading.isnan()
        turned = torch.where(theirs, motion.heading, turned)
        turn_rate = torch.where(theirs, motion.turn_rate, turn_rate)
    after = after._replace(heading=turned, turn_rate=turn_rate)

    guidance = rules.guidance(after)
    # an agent that has squeezed into a corner that no planned way leads out of is as far as before
    remaining_path = torch.where(guidance.distance < torch.inf, guidance.distance, after.remaining_path)
    begins, since = hit | taken_over, state.goal_since
    progress = state.remaining_path - torch.where(begins, 0.0, remaining_path)
    reached = state.reached.unsqueeze(-1) + hits
    done = reached[..., -1] >= rules.goals
    if script is None:
        given = deadline(after.clock, remaining_path.detach(), after.pref_speed, rules.deadline)
        until = torch.where(begins, given, after.deadline)
        since = torch.where(begins, after.clock.unsqueeze(1), since)
        over = done | ~state.mask
        ended, over = over.all(1), over | after.overdue
        settled = (over if waits is None else over | after.stands.isinf()).all(1) | failed
    else:
        until, ended, settled = after.deadline, script.ended(after), failed
        # an agent that has taken the slot of another one has another way
        progress = torch.where(hit | (after.person == state.person), progress, 0.0)
    terminated = ended & ~failed
    set_out = taken_over if script is not None else (hit & (after.goal_id >= 0)) | taken_over
    after = after._replace(
        remaining_path=remaining_path,
        planned=after.planned + torch.where(set_out, planned(remaining_path), 0.0),
        goal_point=guidance.goal_point,
        goal_since=since,
        deadline=until,
    )
    in_contact = (motion.agent_contact | motion.wall_contact).any(-1)
    reward = torch.where(moving, progress - CONTACT_COST * in_contact, 0.0)
    events = Events(
        motion.trace,
        motion.agent_contact,
        motion.wall_contact,
        reached,
        reward,
        terminated,
        settled & ~terminated,
    )
    return after, guidance, events


def _arrived(
    state: State, hits: Tensor, trace: Tensor, failed: Tensor, rules: Rules, waited: WaitingUpdate | None
) -> tuple[State, Tensor]:
    """Return the state at the end of a decision, and which agents set out or are taken over (B, A) bool.

    Args:
        state: At its beginning.
        hits: Which agents have reached their goal until each trace point (B, A, S) bool.
        trace: Positions every 0.1 s (B, A, S, 2), metres.
        failed: Scenes whose policy returned NaN or infinity (B,) bool.
        rules: Of the scenes.
        waited: Which people stop to wait and which move on; None where no people wait.
    """
    hit = hits[..., -1]
    clock = state.clock + rules.ticks * TRACE_SECONDS
    later = state.next_goal
    takes = hit if waited is None else hit | waited.moves_on
    renew = takes & (later >= 0) if rules.keep_goal else takes
    reached = state.reached + hit
    overdue = state.overdue | (_misses_deadline(state, hits, rules.goals) & state.controlled)
    waits = state.mask & ~state.controlled & (state.stands > 0)
    sets_out = waits & (clock.unsqueeze(1) + CLOCK_ROUNDING >= state.stands)
    mask, controlled = state.mask, state.controlled | sets_out
    if rules.leave:
        stays = (reached < rules.goals) | state.stands.isinf()
        mask, controlled = mask & stays, controlled & stays
    past = torch.cat((state.past[:, :, rules.ticks :], trace), dim=2)
    after = state._replace(
        clock=clock,
        failed=failed,
        mask=mask,
        controlled=controlled,
        person=torch.where(mask, state.person, -1),
        past=past,
        velocity=(past[:, :, -1] - past[:, :, -2]) / TRACE_SECONDS,
        goal_id=torch.where(renew, later, state.goal_id),
        drawn=state.drawn + takes,
        reached=reached,
        overdue=overdue,
    )
    if waited is not None:
        after = after._replace(stands=waited.stands)
        sets_out = sets_out | waited.moves_on
        if rules.script is None:  # recorded people have to be gone at a time of their recording
            after = after._replace(deadline=after.deadline.masked_fill(after.holds, torch.inf))
    if rules.script is None:
        return after, sets_out
    present, taken_over = rules.script.update_presence(state, after, rules.ticks)
    return present, taken_over | (sets_out & (present.person == state.person))


def _misses_deadline(state: State, hits: Tensor, goals: int) -> Tensor:
    """Return which agents are late for their goal (B, A) bool; a goal reached in time on the trace counts."""
    # a goal that was not reached counts as reached at the end, which is late, too
    before = hits.shape[2] - hits.sum(2).clamp_min(1)
    when = state.clock.unsqueeze(1) + TRACE_SECONDS * (before + 1)
    late = when > state.deadline + CLOCK_ROUNDING
    return late & (state.reached < goals)
