"""`kernel.step` by compiled loops: for scenes on the CPU where no gradients are asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from pedzoo.core.geometry import TURNS_FROM
from pedzoo.core.machine import compiles
from pedzoo.core.types import GOAL_RADIUS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.sim.arrival import limits
from pedzoo.sim.physics_parts.compiled import integration
from pedzoo.sim.state import State
from pedzoo.sim.step_result import CLOCK_ROUNDING, CONTACT_COST, Events

if TYPE_CHECKING:
    from pedzoo.sim.kernel import Rules


def step_compiles(state: State, commands: Tensor, rules: Rules) -> bool:
    """Return whether `step_compiled` may take a decision.

    It takes those of holonomic agents that do not wait at places, without a script or gradients.
    """
    special = rules.wheels or rules.waits is not None or rules.script is not None
    if special or not compiles(state.past, commands):
        return False
    if not torch.is_grad_enabled():
        return True
    given = commands, state.past, state.velocity, state.remaining_path
    return not any(value.requires_grad for value in given)


def step_compiled(
    state: State, commands: Tensor, bank: MapBank, rules: Rules
) -> tuple[State, Guidance, Events]:
    """`pedzoo.sim.kernel.step`, compiled; equal but for the last bit of roots and angles."""
    from pedzoo.sim.physics_parts.compiled_step_loops import move, settle

    (scenes, agents), ticks = state.mask.shape, rules.ticks
    before = state.past.contiguous()
    past, velocity = torch.empty_like(before), torch.empty_like(state.velocity)
    events = torch.empty(3, scenes, agents, ticks, dtype=torch.bool)
    flags = torch.empty(6, scenes, agents, dtype=torch.bool)
    counts = torch.empty(4, scenes, agents, dtype=torch.long)
    reached = torch.empty(scenes, agents, ticks, dtype=torch.long)
    lengths = torch.empty(5, scenes, agents)
    heading, clock = torch.empty_like(state.heading), torch.empty_like(state.clock)
    failed, ends = torch.empty_like(state.failed), torch.empty(2, scenes, dtype=torch.bool)
    happened, now, bad, marks, numbers = (value.numpy() for value in (events, clock, failed, flags, counts))
    given = (
        commands, state.failed, state.mask, state.controlled, state.goal_id, state.later_goals, state.person,
        state.drawn, state.reached, before, state.velocity, state.heading, state.top_speed, state.radius,
        state.goal_point, state.clock, state.deadline, state.stands, state.overdue,
    )  # fmt: skip
    walls = state.wall_frame, state.wall_place
    move(
        *(value.detach().numpy() for value in given), ticks, rules.goals, rules.leave, rules.keep_goal,
        CLOCK_ROUNDING, TURNS_FROM, *integration(bank, walls, rules.substeps),
        past.numpy(), happened, now, bad, marks, numbers, velocity.numpy(), heading.numpy(),
    )  # fmt: skip
    mask, controlled, overdue, *_ = flags.unbind()
    person, goal_id, drawn, count = counts.unbind()
    after = state._replace(
        clock=clock, failed=failed, mask=mask, controlled=controlled, person=person, past=past,
        velocity=velocity, heading=heading, goal_id=goal_id, drawn=drawn, reached=count, overdue=overdue,
    )  # fmt: skip
    guidance = rules.guidance(after)
    inputs = (
        guidance.distance, state.remaining_path, state.planned, state.deadline, state.goal_since,
        state.pref_speed,
    )  # fmt: skip
    settle(
        *(value.detach().numpy() for value in inputs),
        now, bad, state.mask.numpy(), happened, marks, numbers,
        rules.goals, *limits(rules.deadline), GOAL_RADIUS, CONTACT_COST,
        lengths.numpy(), ends.numpy(), state.reached.numpy(), reached.numpy(),
    )  # fmt: skip
    remaining_path, planned, deadline, goal_since, reward = lengths.unbind()
    after = after._replace(
        remaining_path=remaining_path, planned=planned, goal_point=guidance.goal_point, deadline=deadline,
        goal_since=goal_since,
    )  # fmt: skip
    agent, wall, _ = events.unbind()
    return after, guidance, Events(past[:, :, -ticks:], agent, wall, reached, reward, *ends.unbind())
