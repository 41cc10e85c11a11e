"""Goals that change while a controller runs: the planner gets new ones and forgets unused ones."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import AHEAD_SECONDS
from pedzoo.maps.planning.graph import format_point
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.online import OnlinePlanner
from pedzoo.policies.controller.arguments import as_places
from pedzoo.policies.controller.roster import Roster

_KEPT = 64
"""Goals are forgotten when there are more than this and more than 4 per agent."""


class OnlineGoals(NamedTuple):
    """The goals of a scene's agents, and a planner on one floor plan in the scene's frame.

    Attributes:
        planner: Its bank holds the floor plan alone, or nothing.
        origin: Of its frame in the caller's (2,), metres.
        said: Goals that the planner has moved and that were warned of.
    """

    planner: OnlinePlanner
    origin: NDArray[np.float64]
    said: set[tuple[float, ...]]

    @property
    def map_id(self) -> int:
        """The floor plan, -1 for none."""
        grids = self.planner.bank.grids
        return grids[0].map_id if grids else -1

    def with_goals(
        self, people: Roster, position: Tensor, goals: Mapping[Any, Any], now: float
    ) -> tuple[OnlineGoals, Roster]:
        """Return the planner with the goals, and the people with theirs. A new goal ends standing.

        Of a goal that the planner moves there is a warning, once.

        Args:
            people: All agents that are here.
            position: Where they are (N, 2), metres.
            goals: Where some of the people are going, by id; None to stand.
            now: Seconds since the first call.

        Raises:
            UserError: A person has no goal, or one that is in a wall, outside the map or out of reach.
        """
        given = {one: goal for one, goal in goals.items() if goal is not None}
        rows, points = people.rows(given), as_places(given, "goal", self.origin)
        known = len(given) == len(goals) and torch.equal(people.goal[rows], points)
        if known and not people.is_new.any():
            return self, people
        idle = people.rows({one: None for one in goals if one not in given})
        asked, stands = people.goal.clone(), people.stands.clone()
        asked[rows] = points
        asked[idle], stands[idle] = torch.nan, True
        has_goal = ~asked[:, 0].isnan()
        missing = ~(has_goal | stands | people.other)
        if missing.any():
            raise UserError(
                f"no goal for {people.names(missing)}: a person who is new needs one, "
                "step(people, {id: (x, y)}), or None to stand, step(people, {id: None})"
            )
        fresh = (asked != people.goal).any(1) & has_goal
        goal_id = torch.where(has_goal, people.goal_id, -1)
        goal_point = torch.where(has_goal.unsqueeze(1), people.goal_point, torch.nan)
        people = people._replace(goal=asked, goal_id=goal_id, goal_point=goal_point, stands=stands & ~fresh)
        if not fresh.any():
            return self, people
        people = people._replace(goal_since=people.goal_since.masked_fill(fresh, now))
        planner, added = self.planner, fresh
        if planner.goals > max(_KEPT, 4 * len(fresh)):
            # the table of a goal is as large as the floor plan, and new goals keep coming
            planner, added = planner.without_goals(), has_goal
        online_goals, goal_id = self._replace(planner=planner), goal_id.clone()
        goal_id[added] = online_goals._added(people, asked, added)
        people = people._replace(goal_id=goal_id)
        guidance = online_goals.guide(people, position)
        unreached = guidance.distance.isinf() & fresh
        if unreached.any():
            raise UserError(
                f"no way leads to the goal of {people.names(unreached)}: it is in another room, without a "
                f"door between that leaves clearance {planner.clearance} m"
            )
        goal_point = torch.where(fresh.unsqueeze(1), guidance.goal_point, goal_point)
        if self.planner.bank.grids:
            self._warn_of_moved(people, goal_point, fresh)
        return online_goals, people._replace(goal_point=goal_point)

    def _warn_of_moved(self, people: Roster, goal_point: Tensor, which: Tensor) -> None:
        """Warn of the goals of some people (N,) that the planner has moved to ``goal_point`` (N, 2)."""
        graph = self.planner.graph(0)
        if len(self.said) > max(_KEPT, 4 * len(people.ids)):
            self.said.clear()
        for i in (which & ((people.goal - goal_point).abs().amax(1) > 0)).nonzero()[:, 0].tolist():
            asked, place = people.goal[i].numpy(), goal_point[i].double().numpy()
            text = graph.moved(f"goal of {people.ids[i]!r}:", asked, place, self.origin)
            if text and tuple(asked.tolist()) not in self.said:
                self.said.add(tuple(asked.tolist()))
                warnings.warn(text, stacklevel=4)  # beyond `step` and the wrapper of torch

    def misplaced(self, people: Roster, position: Tensor) -> str | None:
        """Return the warning about new people in walls or outside the floor plan; None where all is well.

        Nobody is warned of who is less deep in a wall, or less far outside, than their radius.

        Args:
            people: All agents that are here.
            position: Where they are (N, 2), metres.
        """
        new = (people.is_new & ~people.other).nonzero()[:, 0]
        if not len(new) or not self.planner.bank.grids or not len(graph := self.planner.graph(0)):
            return None
        points, radius = position[new].double().numpy(), people.radius[new].numpy()
        column, row = graph.to_place(points).T
        height, width = graph.shape
        outside = np.hypot(_beyond(column, width), _beyond(row, height)) * graph.grid.resolution > radius
        flat = graph.locate(points)[0]
        wrong = outside | (graph.distance.ravel()[flat] < graph.grid.resolution - radius)
        if not wrong.any():
            return None
        # at centres of cells the depth is known; what it is between them takes longer
        map_id = torch.tensor([self.map_id])
        room = self.planner.bank.closest_wall(position[new].unsqueeze(0), map_id, identity_pose(1))[0]
        wrong = outside | (room[0].numpy() < -radius)
        if not wrong.any():
            return None
        i = int(wrong.argmax())
        cell = graph.nearest[flat[i]]
        here, free = (format_point(place + self.origin) for place in (points[i], graph.xy[cell]))
        more = f" (and {wrong.sum() - 1} more)" if wrong.sum() > 1 else ""
        return (
            f"{people.ids[int(new[i])]!r}{more} is at {here}, {'outside' if outside[i] else 'in a wall of'} "
            f"map {graph.grid.name!r}: walks from the nearest free place, {free}; are positions in the floor "
            "plan's frame, in metres?"
        )

    def guide(self, people: Roster, position: Tensor) -> Guidance:
        """Return the carrots and desired velocities (N, 2) of agents at ``position`` (N, 2).

        Agents that stand, and others, have their position as carrot and desire no velocity.
        """
        goal_id = torch.where(people.walks, people.goal_id, -1)
        row = torch.tensor([0 if self.planner.bank.grids else -1])
        fastest = float(people.pref_speed.max()) if len(goal_id) else 1.0
        points, goal_id, speed = (part.unsqueeze(0) for part in (position, goal_id, people.pref_speed))
        guidance = self.planner.guidance(
            points, goal_id, row, identity_pose(1), speed, AHEAD_SECONDS, fastest
        )
        return Guidance(*(part.squeeze(0) for part in guidance))

    def _added(self, people: Roster, asked: Tensor, which: Tensor) -> Tensor:
        row = 0 if self.planner.bank.grids else -1
        try:
            return self.planner.add_goals(row, asked[which])
        except UserError:
            for i in which.nonzero()[:, 0].tolist():  # name the agent
                try:
                    self.planner.add_goals(row, asked[i : i + 1])
                except UserError as error:
                    raise UserError(f"goal of {people.ids[i]!r}: {error}") from None
            raise


def _beyond(place: NDArray[np.float64], cells: int) -> NDArray[np.float64]:
    """Return how many cells beyond a row of ``cells`` places are, whole at cell centres."""
    return np.maximum(np.maximum(-0.5 - place, place - (cells - 0.5)), 0.0)
