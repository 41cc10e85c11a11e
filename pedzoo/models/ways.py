"""The ways of people who come and go: their goals are given to the planner, and forgotten with time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from pedzoo.errors import UserError
from pedzoo.geometry import identity_pose
from pedzoo.maps.guidance import Guidance
from pedzoo.maps.planner import Planner
from pedzoo.models.roster import Roster, as_points
from pedzoo.types import AHEAD_SECONDS

_KEPT = 64
"""Goals that nobody has any more are forgotten when there are more than this in all, and 4 per person."""


class Ways(NamedTuple):
    """A planner on one floor plan, whose frame is the scene's.

    Attributes:
        planner: Its bank holds the floor plan alone, or nothing.
    """

    planner: Planner

    @property
    def map_id(self) -> int:
        """The floor plan, -1 for none."""
        grids = self.planner.bank.grids
        return grids[0].map_id if grids else -1

    def with_goals(self, people: Roster, position: Tensor, goals: Mapping[Any, Any]) -> tuple[Ways, Roster]:
        """Return the ways, and the people with their goals.

        Args:
            people: Everybody who is here.
            position: Where they are (N, 2), metres.
            goals: Where some of them are going, by id.

        Raises:
            UserError: Somebody has no goal, or one that is in a wall, outside the map or out of reach.
        """
        asked = people.goal.clone()
        asked[people.rows(goals)] = as_points(goals, "goal")
        missing = asked[:, 0].isnan()
        if missing.any():
            raise UserError(
                f"no goal for {people.names(missing)}: whoever is new needs one, "
                "step(positions, {id: (x, y)})"
            )
        fresh = (asked != people.goal).any(1)
        if not fresh.any():
            return self, people
        planner, added = self.planner, fresh
        if planner.goals > max(_KEPT, 4 * len(fresh)):
            # what is kept of a goal is as large as the floor plan, and people keep coming with others
            planner, added = Planner(planner.bank, planner.clearance), torch.ones_like(fresh)
        ways, goal_id = Ways(planner), people.goal_id.clone()
        goal_id[added] = ways._added(people, asked, added)
        people = people._replace(goal=asked, goal_id=goal_id)
        unreached = ways.guide(people, position).distance.isinf() & fresh
        if unreached.any():
            raise UserError(
                f"no way leads to the goal of {people.names(unreached)}: it is in another room, without a "
                f"door between that leaves clearance {planner.clearance} m"
            )
        return ways, people

    def guide(self, people: Roster, position: Tensor) -> Guidance:
        """Return the carrots and desired velocities (N, 2) of people at ``position`` (N, 2)."""
        map_id = torch.full_like(people.goal_id, self.map_id)
        pose = identity_pose(len(map_id))
        return self.planner.guide(position, people.goal_id, map_id, pose, people.pref_speed, AHEAD_SECONDS)

    def _added(self, people: Roster, asked: Tensor, which: Tensor) -> Tensor:
        row = 0 if self.planner.bank.grids else -1
        try:
            return self.planner.add_goals(row, asked[which])
        except UserError:
            for i in which.nonzero()[:, 0].tolist():  # whose is it?
                try:
                    self.planner.add_goals(row, asked[i : i + 1])
                except UserError as error:
                    raise UserError(f"goal of {people.ids[i]!r}: {error}") from None
            raise
