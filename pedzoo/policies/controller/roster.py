"""The agents of a scene that they enter and leave, and their state."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import heading_of, passes_goal
from pedzoo.core.types import BODY_RADIUS
from pedzoo.policies.controller.arguments import (
    JUMP,
    OTHER_RADIUS,
    DiscKey,
    metres_of,
    number_of,
    speed_of,
)

_THERE = 0.15
"""Metres: so near to where the planner has put a goal it is reached in any case."""


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

    def rows(self, ids: Mapping[Any, Any]) -> Tensor:
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

        Raises:
            UserError: A preferred speed is not above 0.
        """
        if present.keys() == self.row.keys():
            return self
        number = {one: number_of(one) for one in present}
        ids = sorted(present, key=lambda one: (number[one], repr(one)))
        known = [i for i, one in enumerate(ids) if one in self.row]
        new = [i for i, one in enumerate(ids) if one not in self.row]
        before = torch.tensor([self.row[ids[i]] for i in known], dtype=torch.long)
        order = torch.tensor(known + new, dtype=torch.long).argsort()

        added = _newcomers(len(new), self.past.shape[1], self.trace.shape[1])
        added["pref_speed"] = torch.tensor([speed_of(ids[i], pref_speed) for i in new])
        added["other"] = torch.tensor([isinstance(ids[i], DiscKey) for i in new], dtype=torch.bool)
        added["radius"] = torch.where(added["other"], OTHER_RADIUS, BODY_RADIUS)
        merged = {
            name: torch.cat((cast("Tensor", getattr(self, name))[before], values))[order]
            for name, values in added.items()
        }
        merged["number"] = torch.tensor([number[one] for one in ids], dtype=torch.long)
        return Roster({one: i for i, one in enumerate(ids)}, **merged)

    def check_moves(self, position: Tensor) -> None:
        """Check that agents have come to ``position`` (N, 2), metres, since the last call.

        Raises:
            UserError: One was more than a kilometre away.
        """
        moved = (position - self.past[:, -1]).abs().numpy()
        if (moved > JUMP).any():
            row, column = np.unravel_index(np.nan_to_num(moved).argmax(), moved.shape)
            raise UserError(
                f"position of {self.ids[int(row)]!r}: {moved[row, column]:.0f} m from that at the call "
                "before: expected metres in one frame; leave people whom you place anew out of one call"
            )

    def with_radius(self, radius: Mapping[Any, Any]) -> Roster:
        """Return the roster with bodies of ``radius``, metres by id; other agents keep theirs.

        Raises:
            UserError: A radius is not above 0.
        """
        if not radius:
            return self
        metres = {one: metres_of(one, value) for one, value in radius.items()}
        rows = [(row, key.of if isinstance(key, DiscKey) else key) for key, row in self.row.items()]
        changed = self.radius.clone()
        for row, one in rows:
            if one in metres:
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

    def begun(self, position: Tensor, velocity: Tensor, ago: Tensor, new: Tensor, known: Tensor) -> Roster:
        """Return the roster in which ``new`` agents (N,) have come straight to ``position`` (N, 2), metres.

        They moved at ``velocity`` (N, 2), m/s; stored positions are ``ago`` (L,), seconds before now. People
        in the rows ``known`` (n,) set out from that velocity.
        """
        straight = position.unsqueeze(1) - velocity.unsqueeze(1) * ago.view(-1, 1)
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
        asked, there = (
            passes_goal(begin, end, self.goal.float()),
            passes_goal(begin, end, self.goal_point, _THERE),
        )
        return self._replace(stands=self.stands | near & asked | there)


def _newcomers(count: int, length: int, ticks: int) -> dict[str, Tensor]:
    """Return the values (N, ...) of people who have neither past nor goal, by the fields of `Roster`."""

    def nothing(*shape: int, exact: bool = False) -> Tensor:
        return torch.full((count, *shape), torch.nan, dtype=torch.float64 if exact else torch.float32)

    def number(value: int) -> Tensor:
        return torch.full((count,), value, dtype=torch.long)

    no = torch.zeros(count, dtype=torch.bool)
    return {
        "number": number(0),
        "past": nothing(length, 2),
        "pref_speed": nothing(),
        "radius": nothing(),
        "group": number(-1),
        "other": no,
        "goal": nothing(2, exact=True),
        "goal_point": nothing(2),
        "goal_id": number(-1),
        "goal_since": torch.full((count,), -torch.inf),
        "stands": no,
        "heading": nothing(),
        "trace": nothing(ticks, 2),
        "told": nothing(2, exact=True),
        "eases": no,
    }
