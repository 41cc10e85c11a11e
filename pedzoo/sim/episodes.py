"""How scenes begin: a layout, the warm start, the first goals."""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor

from pedzoo.draws import Draws
from pedzoo.errors import UserError, unknown
from pedzoo.geometry import heading_of, identity_pose
from pedzoo.maps.guidance import Look
from pedzoo.maps.segments import WallSegments
from pedzoo.sim import warm_start as warm
from pedzoo.sim.arrival import arrived, deadline, planned, renewed
from pedzoo.sim.scenario import Layout, Scenario
from pedzoo.sim.script import Opening
from pedzoo.sim.state import PAST_LEN, TURNS_FROM, State
from pedzoo.types import TRACE_SECONDS


class Episodes:
    """Makes the first state of any episode of a scenario, for as many at once as are asked for."""

    def __init__(
        self, scenario: Scenario, warm_start: warm.WarmStart, substeps: int, body_radius: float
    ) -> None:
        """Take a prepared scenario.

        Args:
            scenario: The scenario; `Scenario.prepare` was called.
            warm_start: Where the first observed steps come from.
            substeps: Of every 0.1 s.
            body_radius: Of a person, metres.

        Raises:
            UserError: There is no such warm start.
        """
        if warm_start not in get_args(warm.WarmStart):
            raise unknown("warm_start", warm_start, get_args(warm.WarmStart))
        self._scenario, self._warm_start = scenario, warm_start
        self._substeps, self._body_radius = substeps, body_radius
        self._walls = WallSegments(scenario.bank, most=warm.ORCA.max_obstacles)

    @torch.no_grad()
    def begin(self, draws: Draws) -> State:
        """Return the first state of the episodes of ``draws``.

        Raises:
            UserError: Somebody's goal cannot be reached.
        """
        key, layout = draws.key, self._scenario.layout(draws)
        opening = layout.opening or _everybody(layout)
        pose = identity_pose(len(key), key.device) if layout.pose is None else layout.pose
        goal, drawn = layout.goal, torch.zeros_like(layout.goal)
        if self._warm_start == "recorded" or layout.opening is not None:
            past = warm.recorded(layout)
        elif self._warm_start == "static":
            past = warm.standing(layout)
        else:
            past, goal, drawn = self._rolled(key, layout, pose)
        position = past[:, :, -1]
        look = self._look(position, goal, layout, pose)
        way = look.distance.view_as(layout.pref_speed)
        stands = torch.zeros_like(way) if layout.stand is None else layout.stand
        cut_off = ((opening.controlled | (stands > 0)) & way.isinf()).nonzero()
        if len(cut_off):
            scene, slot = cut_off[0].tolist()
            here, there = (
                tuple(round(float(value), 2) for value in where.view_as(position)[scene, slot])
                for where in (position, look.goal_point)
            )
            clearance = self._scenario.planner.clearance
            raise UserError(
                f"no way from {here} to the goal {there} keeps {clearance} m from walls: passages have to be "
                f"wider than {2 * clearance} m, or the clearance smaller (--clearance, make_env(clearance=))"
            )
        if layout.opening is not None:  # who is played back may be where no way leads from
            way = torch.where(way.isfinite(), way, 0.0)
        clock = way.new_zeros(len(key))
        velocity, until = opening.velocity, opening.deadline
        if velocity is None:
            velocity = (position - past[:, :, -2]) / TRACE_SECONDS
        goes = look.goal_point.view_as(position) - position
        radius, kind = layout.radius, layout.kind
        return State(
            key=key,
            map_id=layout.map_id,
            pose=pose,
            scene=opening.scene,
            clock=clock,
            failed=torch.zeros_like(clock, dtype=torch.bool),
            mask=layout.mask,
            controlled=opening.controlled,
            person=opening.person,
            known=opening.known,
            past=past,
            velocity=velocity,
            heading=heading_of(velocity, heading_of(goes), TURNS_FROM),
            radius=torch.full_like(way, self._body_radius) if radius is None else radius,
            kind=torch.zeros_like(goal) if kind is None else kind,
            pref_speed=layout.pref_speed,
            goal_id=goal,
            goal_point=look.goal_point.view_as(position),
            drawn=drawn,
            reached=torch.zeros_like(goal),
            deadline=deadline(clock, way, layout.pref_speed) if until is None else until,
            late=torch.zeros_like(layout.mask),
            way=way,
            planned=torch.where(opening.controlled, planned(way), 0.0),
            stands=stands,
        )

    def _rolled(self, key: Tensor, layout: Layout, pose: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the past (B, A, 29, 2), and the goals and how many were drawn (B, A) at its end."""
        drawn = torch.zeros_like(layout.goal)

        def renew(path: Tensor, goal: Tensor) -> Tensor:
            """Replace goals that are passed already: nothing counts before the episode begins."""
            nonlocal drawn
            point = self._look(path[:, :, -1], goal, layout, pose).goal_point.view_as(path[:, :, -1])
            hit = arrived(path.unsqueeze(3), point, layout.mask & (goal >= 0))[..., -1]
            fresh, drawn = renewed(self._scenario, key, goal, drawn, hit)
            return torch.where(fresh >= 0, fresh, goal)

        past, goal = warm.rolled(
            layout, pose, self._scenario.planner, self._walls, self._substeps, self._body_radius, renew
        )
        return past, goal, drawn

    def _look(self, position: Tensor, goal: Tensor, layout: Layout, pose: Tensor) -> Look:
        agents = position.shape[1]
        return self._scenario.planner.look(
            position.flatten(0, 1),
            goal.flatten(),
            layout.map_id.repeat_interleave(agents),
            pose.repeat_interleave(agents, 0),
        )


def _everybody(layout: Layout) -> Opening:
    """Return the opening of scenes without a script: all are there, seen before, and walk or stand."""
    slot = torch.arange(layout.mask.shape[1], device=layout.mask.device)
    walks = layout.mask if layout.stand is None else layout.mask & (layout.stand <= 0)
    return Opening(
        scene=torch.zeros_like(layout.map_id),
        person=torch.where(layout.mask, slot, -1),
        controlled=walks,
        known=torch.full_like(layout.goal, PAST_LEN),
    )
