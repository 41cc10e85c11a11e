"""The agents of a scene that they enter and leave, their state, and their goals, which keep changing."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import heading_of, identity_pose, passes_goal
from pedzoo.core.types import AHEAD_SECONDS, BODY_RADIUS, GOAL_RADIUS
from pedzoo.maps.planning.graph import format_point
from pedzoo.maps.planning.guidance import Guidance
from pedzoo.maps.planning.planner import Planner
from pedzoo.policies.controller.arguments import (
    JUMP,
    OTHER_RADIUS,
    Array,
    DiscKey,
    as_places,
    metres_of,
    number_of,
    speed_of,
)
from pedzoo.policies.controller.ease import set_out

_THERE = 0.15
"""Metres: so near to where the planner has put a goal it is reached in any case."""

_KEPT = 64
"""Goals are forgotten when there are more than this and more than 4 per agent."""

_BEGIN: dict[str, tuple[str, Any]] = {
    "number": ("i8", -1),  # by which their noise is drawn, see `number_of`
    "pref_speed": ("f4", np.nan),  # the speed that they like, m/s
    "radius": ("f4", np.nan),  # of their bodies, metres
    "group": ("i8", -1),  # number of the company that they walk in, -1 for alone
    "other": ("?", False),  # whether they are others, moved by the caller
    "goal": ("2f8", np.nan),  # as it was asked for; NaN where none was
    "goal_point": ("2f4", np.nan),  # where the planner has put it, metres; NaN without one, or at rest
    "goal_id": ("i8", -1),  # the planner's number of it, -1 for none
    "goal_since": ("f4", -np.inf),  # when it was given, seconds since the first call
    "stands": ("?", False),  # whether a person has no goal, or has reached it
    "heading": ("f4", np.nan),  # of the body, radians
    "told": ("2f8", np.nan),  # what was answered last, m/s: new people's present velocity
    "eases": ("?", False),  # whether they set out, and have not yet walked as fast as they like
}
"""What is known of an agent: the fields of a state, and their values for newcomers."""


class Roster(NamedTuple):
    """N agents, in the order of their numbers: another order of their names gives the same answers.

    Attributes:
        row: Which row each person's id, and each `DiscKey` of another agent, has.
        state: Of each (N,): the fields above, and ``trace`` (S, 2) f4: velocities of the trace steps of the
            last decision, m/s, NaN before the first.
        past: Latest positions (N, L, 2), oldest first, metres; NaN for agents that have just come.
    """

    row: dict[Hashable, int]
    state: Array
    past: Array

    @classmethod
    def empty(cls, length: int, ticks: int) -> Roster:
        """Return an empty roster, with room for ``length`` positions and ``ticks`` trace steps."""
        fields = [(name, kind) for name, (kind, _) in _BEGIN.items()]
        kinds = np.dtype([*fields, ("trace", "f4", (ticks, 2))], align=True)
        return cls({}, np.empty(0, kinds), np.empty((0, length, 2), np.float32))

    @property
    def is_new(self) -> Array:
        """Which agents have no past (N,) bool."""
        return np.isnan(self.past[:, -1, 0])

    @property
    def walks(self) -> Array:
        """Which agents the policy moves (N,) bool."""
        return ~(self.state["stands"] | self.state["other"])

    def rows(self, ids: Iterable[Any]) -> list[int]:
        """Return the rows of agents."""
        return [self.row[one] for one in ids]

    def names(self, which: Array) -> str:
        """Return the ids of some agents (N,) bool for a message: the first few."""
        result = [repr(one) for one, i in self.row.items() if which[i]]
        return ", ".join(result[:5]) + (f" and {len(result) - 5} more" if len(result) > 5 else "")

    def now(self, present: Mapping[Any, Any], pref_speed: float | Mapping[Any, float]) -> Roster:
        """Return a roster to be written, of exactly the agents of ``present``.

        Newcomers have neither past nor goal. They like the speed that ``pref_speed`` has for them, m/s.
        """
        if present.keys() == self.row.keys():
            return Roster(self.row, self.state.copy(), self.past)
        number = {one: number_of(one) for one in present}
        ids = sorted(present, key=lambda one: (number[one], repr(one)))
        state = np.empty(len(ids), self.state.dtype)
        past = np.full((len(ids), *self.past.shape[1:]), np.nan, np.float32)
        for name, (_, begin) in _BEGIN.items():
            state[name] = begin
        state["trace"] = np.nan
        state["number"] = [number[one] for one in ids]
        known = [i for i, one in enumerate(ids) if one in self.row]
        before = self.rows(ids[i] for i in known)
        state[known], past[known] = self.state[before], self.past[before]
        for i, one in enumerate(ids):
            if one not in self.row:
                other = isinstance(one, DiscKey)
                state["pref_speed"][i], state["other"][i] = speed_of(one, pref_speed), other
                state["radius"][i] = OTHER_RADIUS if other else BODY_RADIUS
        return Roster({one: i for i, one in enumerate(ids)}, state, past)

    def resize(self, radius: Mapping[Any, Any]) -> None:
        """Write the ``radius`` of bodies, metres by id; other agents keep theirs."""
        metres = {one: metres_of(one, value) for one, value in radius.items()}
        for key, row in self.row.items() if metres else ():
            if (one := key.of if isinstance(key, DiscKey) else key) in metres:
                self.state["radius"][row] = metres[one]

    def check_moves(self, position: Array) -> None:
        """Check that agents have come to ``position`` (N, 2), metres, since the last call."""
        moved = np.abs(position - self.past[:, -1])
        if (moved > JUMP).any():
            row, column = np.unravel_index(np.nan_to_num(moved).argmax(), moved.shape)
            raise UserError(
                f"position of {list(self.row)[int(row)]!r}: {moved[row, column]:.0f} m from that at the call "
                "before: expected metres in one frame; leave people whom you place anew out of one call"
            )

    def begin(self, position: Array, velocity: Array, times: Array, new: Array, known: list[int]) -> None:
        """Let ``new`` agents (N,) have come straight to ``position`` (N, 2), metres, at ``velocity``, m/s.

        ``times`` (L,) are those of the stored positions, seconds. Rows ``known`` set out from their velocity.
        """
        state, ago = self.state, (times[-1] - times).astype(np.float32)[:, None]
        self.past[new] = (position[:, None] - velocity[:, None] * ago)[new]
        state["heading"][new] = heading_of(torch.from_numpy(velocity)).numpy()[new]
        state["told"][new] = velocity[new]
        state["eases"][known] |= (new & ~state["other"])[known]

    def arrive(self, begin: Array, end: Array) -> None:
        """Let people stand whose goal is within 0.3 m of their last move.

        That holds for the goal as it was asked for and for where the planner has put it, which is on their
        side of the wall. Where the one is too far from the other, people go on to the latter.
        """
        state = self.state
        away = np.abs(state["goal_point"] - end).max(1) - np.abs(end - begin).max(1)
        if not (away < 2 * GOAL_RADIUS).any():  # which is quick to see
            return
        move = torch.from_numpy(begin), torch.from_numpy(end)
        point, goal = (torch.from_numpy(state[name]) for name in ("goal_point", "goal"))
        near = passes_goal(*move, point) & passes_goal(*move, goal.float())
        state["stands"] |= (near | passes_goal(*move, point, _THERE)).numpy()


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
    def row(self) -> int:
        """The floor plan's row in the bank, -1 for none."""
        return 0 if self.planner.bank.grids else -1

    @property
    def map_id(self) -> Tensor:
        """The floor plan (1,) long, -1 for none."""
        return torch.tensor([grid.map_id for grid in self.planner.bank.grids] or [-1])

    def with_goals(
        self, people: Roster, position: Array, goals: Mapping[Any, Any], now: float, dt: float
    ) -> OnlineGoals:
        """Return the planner with the goals, and write the people's. A new goal ends standing.

        Of a goal that the planner moves there is a warning, once.

        Args:
            people: All agents that are here.
            position: Where they are (N, 2), metres.
            goals: Where some of the people are going, by id; None to stand.
            now: Seconds since the first call.
            dt: Seconds between two calls.
        """
        state = people.state
        given = {one: goal for one, goal in goals.items() if goal is not None}
        rows, points = people.rows(given), as_places(given, "goal", self.origin)
        known = len(given) == len(goals) and (state["goal"][rows] == points).all()
        if known and not people.is_new.any():
            return self
        before, idle = state.copy(), people.rows(one for one in goals if one not in given)
        state["goal"][rows], state["goal"][idle], state["stands"][idle] = points, np.nan, True
        has_goal = ~np.isnan(state["goal"][:, 0])
        missing = ~(has_goal | state["stands"] | state["other"])
        if missing.any():
            raise UserError(
                f"no goal for {people.names(missing)}: a person who is new needs one, "
                "step(people, {id: (x, y)}), or None to stand, step(people, {id: None})"
            )
        fresh = (state["goal"] != before["goal"]).any(1) & has_goal
        state["goal_id"][~has_goal], state["goal_point"][~has_goal] = -1, np.nan
        state["stands"] &= ~fresh
        result = self._located(people, position, fresh, has_goal) if fresh.any() else self
        state["goal_since"][fresh] = now
        people.arrive(position, position)
        set_out(state, before, position, dt)
        return result

    def _located(self, people: Roster, position: Array, fresh: Array, has_goal: Array) -> OnlineGoals:
        """Return the planner with ``fresh`` goals (N,), and write where it has put them."""
        state, planner, added = people.state, self.planner, fresh
        if planner.goals > max(_KEPT, 4 * len(fresh)):
            # each keeps the distances of all corners, and new goals keep coming
            planner, added = planner.without_goals(), has_goal
        result = self._replace(planner=planner)
        try:
            state["goal_id"][added] = planner.add_goals(self.row, state["goal"][added]).numpy()
        except UserError:
            for one in (one for one, i in people.row.items() if added[i]):  # name the agent
                try:
                    planner.add_goals(self.row, state["goal"][people.rows([one])])
                except UserError as error:
                    raise UserError(f"goal of {one!r}: {error}") from None
            raise
        guidance = result.guide(people, position)
        unreached = guidance.distance.isinf().numpy() & fresh
        if unreached.any():
            raise UserError(
                f"no way leads to the goal of {people.names(unreached)}: it is in another room, without a "
                f"door between that leaves clearance {planner.clearance} m"
            )
        state["goal_point"][fresh] = guidance.goal_point.numpy()[fresh]
        if len(self.said) > max(_KEPT, 4 * len(fresh)):
            self.said.clear()
        moved = fresh & (np.abs(state["goal"] - state["goal_point"]).max(1) > 0)
        for one, i in people.row.items() if planner.bank.grids else ():
            if moved[i] and (asked := tuple(state["goal"][i].tolist())) not in self.said:
                place = state["goal_point"][i].astype(np.float64)
                text = planner.graph(0).moved(f"goal of {one!r}:", state["goal"][i], place, self.origin)
                if text:
                    self.said.add(asked)
                    warnings.warn(text, stacklevel=4)  # in the caller of `step`
        return result

    def misplaced(self, people: Roster, position: Array) -> str | None:
        """Return the warning about new people in walls or outside the floor plan; None where all is well.

        Nobody is warned of who is less deep in a wall, or less far outside, than their radius. ``position``
        (N, 2), metres, is that of all agents.
        """
        new = (people.is_new & ~people.state["other"]).nonzero()[0]
        if not len(new) or not self.planner.bank.grids or not len(graph := self.planner.graph(0)):
            return None
        points, radius = position[new].astype(np.float64), people.state["radius"][new]
        cells, last = graph.to_place(points), np.array(graph.shape)[::-1] - 0.5
        beyond = np.maximum(np.maximum(-0.5 - cells, cells - last), 0.0)  # whole at cell centres
        outside = np.hypot(*beyond.T) * graph.grid.resolution > radius
        here = torch.from_numpy(position[new]).unsqueeze(0)
        gap, _ = self.planner.bank.closest_wall(here, self.map_id, identity_pose(1))
        wrong = outside | (gap[0].numpy() < -radius)
        if not wrong.any():
            return None
        i = int(wrong.argmax())
        free = graph.xy[graph.nearest[graph.locate(points[i : i + 1])[0][0]]]
        more = f" (and {wrong.sum() - 1} more)" if wrong.sum() > 1 else ""
        here, free = (format_point(place + self.origin) for place in (points[i], free))
        return (
            f"{list(people.row)[int(new[i])]!r}{more} is at {here}, "
            f"{'outside' if outside[i] else 'in a wall of'} map {graph.grid.name!r}: walks from the nearest "
            f"free place, {free}; are positions in the floor plan's frame, in metres?"
        )

    def guide(self, people: Roster, position: Array) -> Guidance:
        """Return the short-term goals and desired velocities (N, 2) of agents at ``position`` (N, 2).

        Agents that stand, and others, have their position as goal and desire no velocity.
        """
        goal_id, speed = np.where(people.walks, people.state["goal_id"], -1), people.state["pref_speed"]
        points, goal, liked = (torch.from_numpy(part).unsqueeze(0) for part in (position, goal_id, speed))
        row, fastest = torch.tensor([self.row]), float(speed.max(initial=1.0))
        pose = identity_pose(1)
        guidance = self.planner.guidance(points, goal, row, pose, liked, AHEAD_SECONDS, fastest)
        return Guidance(*(part.squeeze(0) for part in guidance))
