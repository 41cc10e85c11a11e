"""The agents of a scene that they enter and leave, their state, and their goals, which keep changing.

What a caller gives wrongly raises a `UserError`: see `pedzoo.policies.controller.controller.Controller.step`.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Iterable, Mapping
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nan

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import heading_of, identity_pose, passes_goal
from pedzoo.core.types import AHEAD_SECONDS, BODY_RADIUS
from pedzoo.maps.planning.graph import format_point
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner
from pedzoo.policies.controller.arguments import (
    JUMP,
    OTHER_RADIUS,
    DiscKey,
    as_places,
    metres_of,
    number_of,
    speed_of,
)

_THERE = 0.15
"""Metres: so near to where the planner has put a goal it is reached in any case."""

_KEPT = 64
"""Goals are forgotten when there are more than this and more than 4 per agent."""


class Roster(NamedTuple):
    """N agents, in the order of their numbers: another order of their names gives the same answers.

    Never written in place: a call that fails leaves all agents as they were.

    Attributes:
        row: Which row each person's id, and each `DiscKey` of another agent, has.
        number: Numbers by which their noise is drawn (N,) long, see `number_of`.
        past: Latest positions (N, L, 2), oldest first; NaN for agents that have just come.
        pref_speed: The speed that they like (N,), m/s.
        radius: Of their bodies (N,), metres.
        group: Number of the company that they walk in (N,) long, -1 for alone.
        other: Which agents are others, moved by the caller (N,) bool.
        goal: Their goals as they were asked for (N, 2) float64; NaN where none was.
        goal_point: Where the planner has put these (N, 2), metres; NaN where none was, or they are at rest.
        goal_id: The planner's numbers of these (N,) long, -1 for none.
        goal_since: When they were given these (N,), seconds since the first call; -inf where none was.
        stands: Which people have no goal, or have reached theirs (N,) bool.
        heading: Directions of the bodies (N,), radians; NaN for agents that have just come.
        trace: Velocities of the trace steps of their last decision (N, S, 2), m/s; NaN before the first.
        told: What was answered last (N, 2) float64, m/s: new people's present velocity.
        eases: Which people set out, and have not yet walked as fast as they like (N,) bool.
    """

    row: dict[Hashable, int]
    number: Tensor
    past: Tensor
    pref_speed: Tensor
    radius: Tensor
    group: Tensor
    other: Tensor
    goal: Tensor
    goal_point: Tensor
    goal_id: Tensor
    goal_since: Tensor
    stands: Tensor
    heading: Tensor
    trace: Tensor
    told: Tensor
    eases: Tensor

    @classmethod
    def empty(cls, length: int, ticks: int) -> Roster:
        """Return an empty roster, with room for ``length`` positions and ``ticks`` trace steps."""
        return cls({}, **_newcomers(0, length, ticks))

    @property
    def ids(self) -> list[Hashable]:
        """The ids of all agents, row by row."""
        return list(self.row)

    @property
    def is_new(self) -> Tensor:
        """Which agents have no past (N,) bool."""
        return self.past[:, -1, 0].isnan()

    @property
    def walks(self) -> Tensor:
        """Which agents the policy moves (N,) bool."""
        return ~(self.stands | self.other)

    def rows(self, ids: Iterable[Any]) -> Tensor:
        """Return the rows of agents (n,) long."""
        return torch.tensor([self.row[one] for one in ids], dtype=torch.long)

    def names(self, which: Tensor) -> str:
        """Return the ids of some agents (N,) bool for a message: the first few."""
        ids = self.ids
        result = [repr(ids[i]) for i in which.nonzero()[:, 0].tolist()]
        return ", ".join(result[:5]) + (f" and {len(result) - 5} more" if len(result) > 5 else "")

    def now(self, present: Mapping[Any, Any], pref_speed: float | Mapping[Any, float]) -> Roster:
        """Return the roster of exactly the agents of ``present``; newcomers have neither past nor goal.

        Args:
            present: By id: the people, and the `DiscKey` of other agents.
            pref_speed: The speed that newcomers like, m/s: one for all, or by id (1.3 for the others).
        """
        if present.keys() == self.row.keys():
            return self
        number = {one: number_of(one) for one in present}
        ids = sorted(present, key=lambda one: (number[one], repr(one)))
        known, new = ([one for one in ids if (one in self.row) is here] for here in (True, False))
        place = {one: i for i, one in enumerate((*known, *new))}
        before = self.rows(known)
        order = torch.tensor([place[one] for one in ids], dtype=torch.long)
        added = _newcomers(len(new), self.past.shape[1], self.trace.shape[1])
        added["pref_speed"] = torch.tensor([speed_of(one, pref_speed) for one in new])
        added["other"] = torch.tensor([isinstance(one, DiscKey) for one in new], dtype=torch.bool)
        added["radius"] = torch.where(added["other"], OTHER_RADIUS, BODY_RADIUS)
        merged = {
            name: torch.cat((cast("Tensor", getattr(self, name))[before], values))[order]
            for name, values in added.items()
        }
        merged["number"] = torch.tensor([number[one] for one in ids], dtype=torch.long)
        return Roster({one: i for i, one in enumerate(ids)}, **merged)

    def check_moves(self, position: Tensor) -> None:
        """Check that agents have come to ``position`` (N, 2), metres, since the last call."""
        moved = (position - self.past[:, -1]).abs().numpy()
        if (moved > JUMP).any():
            row, column = np.unravel_index(np.nan_to_num(moved).argmax(), moved.shape)
            raise UserError(
                f"position of {self.ids[int(row)]!r}: {moved[row, column]:.0f} m from that at the call "
                "before: expected metres in one frame; leave people whom you place anew out of one call"
            )

    def with_radius(self, radius: Mapping[Any, Any]) -> Roster:
        """Return the roster with bodies of ``radius``, metres by id; other agents keep theirs."""
        if not radius:
            return self
        metres, changed = {one: metres_of(one, value) for one, value in radius.items()}, self.radius.clone()
        for key, row in self.row.items():
            if (one := key.of if isinstance(key, DiscKey) else key) in metres:
                changed[row] = metres[one]
        return self._replace(radius=changed)

    def with_groups(self, groups: Mapping[Any, Hashable]) -> Roster:
        """Return the roster with people in companies, by their names; None for alone, others keep theirs."""
        if not groups:
            return self
        group = self.group.clone()
        numbers = [-1 if name is None else number_of(name) for name in groups.values()]
        group[self.rows(groups)] = torch.tensor(numbers)
        return self._replace(group=group)

    def begun(
        self, position: Tensor, velocity: Tensor, times: NDArray[Any], new: Tensor, known: Tensor
    ) -> Roster:
        """Return the roster in which ``new`` agents (N,) have come straight to ``position`` (N, 2), metres.

        They moved at ``velocity`` (N, 2), m/s; ``times`` (L,) are those of the stored positions, seconds.
        People in the rows ``known`` (n,) set out from that velocity.
        """
        ago = torch.from_numpy(times[-1] - times).float().view(-1, 1)
        straight = position.unsqueeze(1) - velocity.unsqueeze(1) * ago
        past = torch.where(new.view(-1, 1, 1), straight, self.past)
        heading = torch.where(new, heading_of(velocity), self.heading)
        told = torch.where(new.unsqueeze(1), velocity.double(), self.told)
        eases = self.eases | (new & torch.zeros_like(new).index_fill(0, known, True) & ~self.other)
        return self._replace(past=past, heading=heading, told=told, eases=eases)

    def arrived(self, begin: Tensor, end: Tensor) -> Roster:
        """Return the roster in which people stand whose goal is within 0.3 m of their last move.

        That holds for the goal as it was asked for and for where the planner has put it, which is on their
        side of the wall. Where the one is too far from the other, people go on to the latter.
        """
        near = passes_goal(begin, end, self.goal_point)
        if not near.any():
            return self
        asked = passes_goal(begin, end, self.goal.float())
        there = passes_goal(begin, end, self.goal_point, _THERE)
        return self._replace(stands=self.stands | near & asked | there)


def _newcomers(count: int, length: int, ticks: int) -> dict[str, Tensor]:
    """Return the values (N, ...) of people who have neither past nor goal, by the fields of `Roster`."""
    no, none = torch.zeros(count, dtype=torch.bool), torch.full((count,), -1)
    unknown, exact = torch.full((count,), nan), torch.full((count, 2), nan, dtype=torch.float64)
    return {
        "number": none,
        "past": torch.full((count, length, 2), nan),
        "pref_speed": unknown,
        "radius": unknown,
        "group": none,
        "other": no,
        "goal": exact,
        "goal_point": torch.full((count, 2), nan),
        "goal_id": none,
        "goal_since": torch.full((count,), -torch.inf),
        "stands": no,
        "heading": unknown,
        "trace": torch.full((count, ticks, 2), nan),
        "told": exact,
        "eases": no,
    }


class OnlineGoals(NamedTuple):
    """The goals of a scene's agents, and a planner on one floor plan in the scene's frame.

    Attributes:
        planner: Its bank holds the floor plan alone, or nothing.
        origin: Of its frame in the caller's (2,), metres.
        said: Goals that the planner has moved and that were warned of.
    """

    planner: Planner
    origin: NDArray[np.float64]
    said: set[tuple[float, ...]]

    @property
    def map_id(self) -> Tensor:
        """The floor plan (1,) long, -1 for none."""
        grids = self.planner.bank.grids
        return torch.tensor([grids[0].map_id if grids else -1])

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
        """
        given = {one: goal for one, goal in goals.items() if goal is not None}
        rows, points = people.rows(given), as_places(given, "goal", self.origin)
        known = len(given) == len(goals) and torch.equal(people.goal[rows], points)
        if known and not people.is_new.any():
            return self, people
        idle = people.rows(one for one in goals if one not in given)
        asked, stands = people.goal.clone(), people.stands.clone()
        asked[rows] = points
        asked[idle], stands[idle] = nan, True
        has_goal = ~asked[:, 0].isnan()
        missing = ~(has_goal | stands | people.other)
        if missing.any():
            raise UserError(
                f"no goal for {people.names(missing)}: a person who is new needs one, "
                "step(people, {id: (x, y)}), or None to stand, step(people, {id: None})"
            )
        fresh = (asked != people.goal).any(1) & has_goal
        goal_id = torch.where(has_goal, people.goal_id, -1)
        goal_point = torch.where(has_goal.unsqueeze(1), people.goal_point, nan)
        people = people._replace(goal=asked, goal_id=goal_id, goal_point=goal_point, stands=stands & ~fresh)
        if not fresh.any():
            return self, people
        people = people._replace(goal_since=people.goal_since.masked_fill(fresh, now))
        planner, added = self.planner, fresh
        if planner.goals > max(_KEPT, 4 * len(fresh)):
            # each keeps the distances of all corners, and new goals keep coming
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

        Nobody is warned of who is less deep in a wall, or less far outside, than their radius. ``position``
        (N, 2), metres, is that of all agents.
        """
        new = (people.is_new & ~people.other).nonzero()[:, 0]
        if not len(new) or not self.planner.bank.grids or not len(graph := self.planner.graph(0)):
            return None
        points, radius = position[new].double().numpy(), people.radius[new].numpy()
        cells, last = graph.to_place(points), np.array(graph.shape)[::-1] - 0.5
        beyond = np.maximum(np.maximum(-0.5 - cells, cells - last), 0.0)  # whole at cell centres
        outside = np.hypot(*beyond.T) * graph.grid.resolution > radius
        flat = graph.locate(points)[0]
        wrong = outside | (graph.distance.ravel()[flat] < graph.grid.resolution - radius)
        if wrong.any():
            # at centres of cells the depth is known; what it is between them takes longer
            gap, _ = self.planner.bank.closest_wall(position[new].unsqueeze(0), self.map_id, identity_pose(1))
            wrong = outside | (gap[0].numpy() < -radius)
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
        fastest = float(people.pref_speed.max()) if len(goal_id) else 1.0
        points, goal_id, speed = (part.unsqueeze(0) for part in (position, goal_id, people.pref_speed))
        guidance = self.planner.guidance(
            points, goal_id, torch.tensor([self._row]), identity_pose(1), speed, AHEAD_SECONDS, fastest
        )
        return Guidance(*(part.squeeze(0) for part in guidance))

    @property
    def _row(self) -> int:
        return 0 if self.planner.bank.grids else -1

    def _added(self, people: Roster, asked: Tensor, which: Tensor) -> Tensor:
        """Return the planner's numbers of the goals ``asked`` (N, 2) of ``which`` people (N,) bool."""
        try:
            return self.planner.add_goals(self._row, asked[which])
        except UserError:
            for i in which.nonzero()[:, 0].tolist():  # name the agent
                try:
                    self.planner.add_goals(self._row, asked[i : i + 1])
                except UserError as error:
                    raise UserError(f"goal of {people.ids[i]!r}: {error}") from None
            raise
