"""The place where time passes: `step` takes scenes through one decision.

The environment, the warm start, imitation and recorded crowds call it, with or without gradients, on any
device. It has no loop over scenes or agents and reads nothing back to the host. Two rooms move agents without
it: `pedzoo.sim.crowdnav`, and the training of crowds in `pedzoo.train.crowds.crowd_walk`. The stepping
controller moves nobody: it takes the blending and the scene batch from here.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pedzoo.core.bodies import HOLONOMIC
from pedzoo.core.geometry import TURNS_FROM, blended, heading_of, limited
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.dynamics import driven
from pedzoo.sim.physics._base import Physics
from pedzoo.sim.scenario import Rules, deadline, planned
from pedzoo.sim.state import CLOCK_ROUNDING, CONTACT_COST, Decision, Events, Motion, MotionInput, State


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
    decision = physics.decide(state, commands, rules) or _decided(state, commands, physics, rules)
    after, motion, moving, hits, sets_out = decision
    failed, hit, script = after.failed, hits[..., -1], rules.script
    guidance = rules.guidance(after)
    # the last path length is kept where the planner finds no path
    remaining_path = torch.where(guidance.distance < torch.inf, guidance.distance, after.remaining_path)
    begins, since = hit | sets_out, state.goal_since
    progress = state.remaining_path - torch.where(begins, 0.0, remaining_path)
    reached = state.reached.unsqueeze(-1) + hits
    if script is None:
        given = deadline(after.clock, remaining_path.detach(), after.pref_speed, rules.deadline)
        until = torch.where(begins, given, after.deadline)
        since = torch.where(begins, after.clock.unsqueeze(1), since)
        done = (reached[..., -1] >= rules.goals) | ~state.mask
        ended, over = done.all(1), done | after.overdue
        settled = (over if rules.waits is None else over | after.stands.isinf()).all(1) | failed
        begins = (hit & (after.goal_id >= 0)) | sets_out
    else:
        until, ended, settled, begins = after.deadline, script.ended(after), failed, sets_out
        # an agent that has taken the slot of another one has another way
        progress = torch.where(hit | (after.person == state.person), progress, 0.0)
    terminated = ended & ~failed
    after = after._replace(
        remaining_path=remaining_path,
        planned=after.planned + torch.where(begins, planned(remaining_path), 0.0),
        goal_point=guidance.goal_point,
        goal_since=since,
        deadline=until,
    )
    in_contact = (motion.agent_contact | motion.wall_contact).any(-1)
    events = Events(
        trace=motion.trace,
        agent_contact=motion.agent_contact,
        wall_contact=motion.wall_contact,
        reached=reached,
        reward=torch.where(moving, progress - CONTACT_COST * in_contact, 0.0),
        terminated=terminated,
        truncated=settled & ~terminated,
    )
    return after, guidance, events


def _decided(state: State, commands: Tensor, physics: Physics, rules: Rules) -> Decision:
    """Return what the commands do to the scenes, before the planner is asked; arguments as of `step`."""
    finite = (commands.abs().amax(-1) < torch.inf) | ~state.controlled
    failed = state.failed | ~finite.all(1)
    moving = state.controlled & ~failed.unsqueeze(1)
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
    wanted = walking & ~state.holds
    inputs = MotionInput(command.movedim(0, -1), velocity, moving, wanted, rules.substeps, played)
    motion = physics.advance(state, inputs)
    after, hits, sets_out = _arrived(state, motion, failed, rules)
    turned = heading_of(after.velocity, heading, TURNS_FROM)
    if rules.wheels:
        turned = torch.where(state.drive == HOLONOMIC, turned, heading)
    if motion.heading is not None and motion.turn_rate is not None:
        theirs = ~motion.heading.isnan()
        turned = torch.where(theirs, motion.heading, turned)
        turn_rate = torch.where(theirs, motion.turn_rate, turn_rate)
    return Decision(after._replace(heading=turned, turn_rate=turn_rate), motion, moving, hits, sets_out)


def _arrived(state: State, motion: Motion, failed: Tensor, rules: Rules) -> tuple[State, Tensor, Tensor]:
    """Return the state at the end of a decision, goals reached until each point, and who sets out.

    Of the last two (B, A, S) and (B, A) bool, places to wait at are no goals, and who is taken over sets out.
    """
    clock, hits, moves_on = state.clock + rules.ticks * TRACE_SECONDS, motion.reached, None
    if rules.waits is not None:
        pause, now = rules.waits(state), clock.unsqueeze(1)
        stops, over = hits[..., -1] & (pause > 0), state.holds & (now + CLOCK_ROUNDING >= state.stands)
        ahead = torch.nn.functional.pad(state.goal_index[:, :-1], (1, 0), value=-1)
        moves_on = over | (state.controlled & pause.isinf() & (ahead > state.goal_index))
        hits = hits & ~stops.unsqueeze(-1)
        stands = torch.where(moves_on, 0.0, torch.where(stops, now + pause, state.stands))
    hit, later = hits[..., -1], state.next_goal
    takes = hit if moves_on is None else hit | moves_on
    renew = takes & (later >= 0) if rules.keep_goal else takes
    reached = state.reached + hit
    # a goal that was not reached counts as reached at the end, which is late, too
    before = hits.shape[2] - hits.sum(2).clamp_min(1)
    when = state.clock.unsqueeze(1) + TRACE_SECONDS * (before + 1)
    late = (when > state.deadline + CLOCK_ROUNDING) & (state.reached < rules.goals)
    waits = state.mask & ~state.controlled & (state.stands > 0)
    sets_out = waits & (clock.unsqueeze(1) + CLOCK_ROUNDING >= state.stands)
    mask, controlled = state.mask, state.controlled | sets_out
    if rules.leave:
        stays = (reached < rules.goals) | state.stands.isinf()
        mask, controlled = mask & stays, controlled & stays
    past = torch.cat((state.past[:, :, rules.ticks :], motion.trace), dim=2)
    after = state._replace(
        clock=clock,
        failed=failed,
        mask=mask,
        controlled=controlled,
        person=torch.where(mask, state.person, -1),
        past=past,
        velocity=(past[:, :, -1] - past[:, :, -2]) / TRACE_SECONDS,
        goal_id=torch.where(renew, later, state.goal_id),
        goal_index=state.goal_index + takes,
        reached=reached,
        overdue=state.overdue | (late & state.controlled),
    )
    if moves_on is not None:
        after, sets_out = after._replace(stands=stands), sets_out | moves_on
        if rules.script is None:  # recorded people have to be gone at a time of their recording
            after = after._replace(deadline=after.deadline.masked_fill(after.holds, torch.inf))
    if rules.script is None:
        return after, hits, sets_out
    present, taken_over = rules.script.update_presence(state, after, rules.ticks)
    return present, hits, taken_over | (sets_out & (present.person == state.person))
