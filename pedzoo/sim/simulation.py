"""One decision of everybody: people walk, a world says what they touch, goals are noticed."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.geometry import heading_of, limit_speed
from pedzoo.maps.guidance import Guidance
from pedzoo.maps.local_walls import LocalWalls
from pedzoo.sim.arrival import arrived, deadline, planned, renewed
from pedzoo.sim.dynamics import walk
from pedzoo.sim.scenario import Scenario
from pedzoo.sim.state import TURNS_FROM, State
from pedzoo.sim.worlds.base import People, World
from pedzoo.types import AHEAD_SECONDS, TOP_SPEED_RATIO, TRACE_SECONDS

CONTACT_COST = 1.0
"""Metres of progress that a decision with a contact costs in the reward."""


_ROUNDING = 1e-3
"""Seconds: clocks are sums of decisions."""


class Outcome(NamedTuple):
    """What happened in one decision of S trace points.

    Attributes:
        trace: Positions every 0.1 s (B, A, S, 2), metres.
        agent_contact: A body was touched in that 0.1 s (B, A, S) bool.
        wall_contact: A wall was (B, A, S) bool.
        reached: Goals reached until then (B, A, S) long.
        reward: (B, A).
        terminated: Everybody has reached all goals (B,) bool.
        truncated: Nobody else can in time, or the policy failed (B,) bool.
    """

    trace: Tensor
    agent_contact: Tensor
    wall_contact: Tensor
    reached: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor


class Simulation:
    """The rules of the scenes: states in, states out, nothing kept in between."""

    def __init__(
        self, scenario: Scenario, world: World, trace_points: int, substeps: int, body_radius: float
    ) -> None:
        """Take the parts.

        Args:
            scenario: A prepared scenario.
            world: Answers what is touched.
            trace_points: S, trace points of 0.1 s in one decision.
            substeps: M, sub-steps of every 0.1 s.
            body_radius: Of a person, metres.
        """
        self.scenario, self.world = scenario, world
        self.trace_points, self.substeps, self.body_radius = trace_points, substeps, body_radius

    def guide(self, state: State) -> Guidance:
        """Return what the planner says to everybody, (B, A, ...)."""
        agents = state.mask.shape[1]
        guidance = self.scenario.planner.guide(
            state.position.flatten(0, 1),
            torch.where(state.mask, state.goal_id, -1).flatten(),
            state.map_id.repeat_interleave(agents),
            state.pose.repeat_interleave(agents, 0),
            state.pref_speed.flatten(),
            AHEAD_SECONDS,
        )
        return Guidance(*(value.unflatten(0, state.mask.shape) for value in guidance))

    def step(self, state: State, action: Tensor) -> tuple[State, Guidance, Outcome]:
        """Return what comes of velocities (B, A, 2), m/s; those of people whom no policy moves do not matter.

        A scene in which somebody's action is not finite stays as it is and is truncated.
        """
        broken = state.failed | (~action.isfinite().all(-1) & state.controlled).any(1)
        moving = state.controlled & ~broken.unsqueeze(1)
        velocity = torch.where(moving.unsqueeze(-1), action, 0.0)
        velocity = limit_speed(velocity, TOP_SPEED_RATIO * state.pref_speed)
        walls = self.scenario.bank.walls_of_people(state.map_id, state.pose, state.mask.shape[1])
        path = self._path(state, velocity, walls)
        script = self.scenario.script
        if script is not None:
            path = script.played(state, path, broken)
        people = People(state.position, state.mask, state.map_id.unsqueeze(1), state.pose)
        contacts = self.world.contacts(path.detach(), people, walls)
        trace = path[:, :, :, -1]

        hits = arrived(path.detach(), state.goal_point, state.controlled & (state.goal_id >= 0))
        hit = hits[..., -1]
        goal_id, drawn = renewed(self.scenario, state.key, state.goal_id, state.drawn, hit)
        reached = state.reached.unsqueeze(-1) + hits
        finished = reached[..., -1] >= self.scenario.goals
        clock = state.clock + self.trace_points * TRACE_SECONDS
        late = state.late | (self._overdue(state, clock, hits) & state.controlled)
        stood = state.mask & ~state.controlled & (state.stands > 0)
        sets_out = stood & (clock.unsqueeze(1) + _ROUNDING >= state.stands)
        leaving = finished if self.scenario.finished == "leave" else torch.zeros_like(finished)
        there = state.mask & ~leaving
        moved = torch.cat((state.past[:, :, self.trace_points :], trace), dim=2)
        after = state._replace(
            clock=clock,
            failed=state.failed | broken,
            mask=there,
            controlled=(state.controlled | sets_out) & ~leaving,
            person=torch.where(there, state.person, -1),
            past=moved,
            velocity=(moved[:, :, -1] - moved[:, :, -2]) / TRACE_SECONDS,
            goal_id=goal_id,
            drawn=drawn,
            reached=reached[..., -1],
            late=late,
        )
        set_out = (hit & (goal_id >= 0)) | sets_out
        if script is not None:
            after, set_out = script.cue(state, after, self.trace_points)
        after = after._replace(heading=heading_of(after.velocity, after.heading, TURNS_FROM))
        guidance = self.guide(after)
        # whoever has squeezed into a corner that no planned way leads out of is as far as before
        way = torch.where(guidance.distance.isfinite(), guidance.distance, after.way)
        progress = state.way - torch.where(hit, 0.0, way)
        until = deadline(clock, way.detach(), state.pref_speed).where(hit | sets_out, after.deadline)
        terminated = (finished | ~state.mask).all(1) & ~broken
        settled = (finished | late | ~state.mask).all(1) | after.failed
        if script is not None:
            terminated, settled, until = script.over(after) & ~broken, after.failed, after.deadline
            # whoever has taken the slot of somebody whose time was up has another way
            progress = torch.where(hit | (after.person == state.person), progress, 0.0)
        way_of_all = after.planned
        if bool(set_out.any()):
            way_of_all = way_of_all + torch.where(set_out, planned(way), 0.0)
        after = after._replace(way=way, planned=way_of_all, goal_point=guidance.goal_point, deadline=until)
        touched = (contacts.agent | contacts.wall).any(-1)
        reward = torch.where(moving, progress - CONTACT_COST * touched, 0.0)
        outcome = Outcome(
            trace, contacts.agent, contacts.wall, reached, reward, terminated, settled & ~terminated
        )
        return after, guidance, outcome

    def _overdue(self, state: State, clock: Tensor, hits: Tensor) -> Tensor:
        """Return whose time for the goal is up (B, A) bool; a goal reached in time on the trace counts."""
        when = TRACE_SECONDS * torch.arange(1, self.trace_points + 1, device=clock.device)
        when = state.clock[:, None, None] + when
        in_time = (hits & (when <= state.deadline.unsqueeze(-1) + _ROUNDING)).any(-1)
        had_all = state.reached >= self.scenario.goals
        return (clock.unsqueeze(1) > state.deadline + _ROUNDING) & ~in_time & ~had_all

    def _path(self, state: State, velocity: Tensor, walls: LocalWalls | None) -> Tensor:
        """Return everybody's sub-steps (B, A, S, M, 2)."""
        path = walk(
            state.position,
            velocity,
            self.trace_points * TRACE_SECONDS,
            self.trace_points * self.substeps,
            walls,
            self.body_radius,
        )
        return path.unflatten(2, (self.trace_points, self.substeps))
