"""People walk from goal to goal through a building (Table II of the paper on iGibson)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils.rnn import pad_sequence

from pedzoo.core.errors import UserError, as_integer
from pedzoo.core.geometry import identity_pose
from pedzoo.core.randomness import Draws
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, spread_points
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import load_plan
from pedzoo.sim.scenario import MIN_INITIAL_PATH, Layout, PreparedScenario, Scenario

SPACING = 0.8
"""Metres between any two starts."""

NEAREST = 2 * MIN_INITIAL_PATH
"""Minimum path length to the next goal, metres: `MIN_INITIAL_PATH` even from as far before the last one."""

MORE = 4
"""Later goals of an agent that is finished early, beside those that it has to reach; then they begin anew."""


class Goals(Scenario):
    """People reach some goals, one after the other; finished people walk on until all are.

    Starts and goals are drawn from points that are spread over the largest connected part of the floor
    plan; which points these are depends on the plan alone.
    """

    finished: Literal["leave", "continue"] = "continue"

    def __init__(
        self,
        map: str | list[str] = "flat",
        people: int | tuple[int, int] = 3,
        goals: int = 3,
        pool: int = 64,
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            map: Floor plan, or several: ``[apartment.0,apartment.1]``. A file (ROS map yaml, iGibson's
                ``floor_trav_0.png``), or what needs none: ``flat``, four rooms and a corridor, or
                ``apartment.7``, ``office.7`` and the like, drawn from a seed.
            people: How many, or the least and the largest number, ``[2,5]``.
            goals: That each person has to reach.
            pool: Places among which goals are drawn, per floor plan.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.
        """
        both = people if isinstance(people, list | tuple) else (people, people)
        fewest, most = (as_integer("people", one) for one in both)
        super().__init__(most, speed, speed_std)
        self.check(1 <= fewest <= most, f"people {people}", "[fewest,most] with 1 <= fewest <= most")
        enough = "at least 1 goal, a pool of at least 2"
        self.check(goals >= 1 and pool >= 2, f"goals {goals}, pool {pool}", enough)
        self.files = [map] if isinstance(map, str) else map
        self.fewest, self.goals, self.pool = fewest, goals, pool
        self.later = goals + MORE

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plans, each in a frame that has it near the origin: see `OccupancyGrid.home`."""
        return [load_plan(name).at_home() for name in self.files]

    def adapted(self, other: PreparedScenario) -> PreparedScenario | None:
        """Return places and paths of the same floor plans, for any number of people and of goals."""
        theirs = other.scenario
        if type(theirs) is not type(self) or (theirs.files, theirs.pool) != (self.files, self.pool):
            return None
        self._check_room(other.bank, other.tables.counts)
        return replace(other, scenario=self)

    def prepare(self, clearance: float, planner: str = Planner.name) -> PreparedScenario:
        """Spread places over the floor plans and find the ways to those that are goals."""
        prepared = super().prepare(clearance, planner)
        ways, places, goals, far = prepared.planner, [], [], []
        for row, grid in enumerate(prepared.bank.grids):
            spread = torch.from_numpy(spread_points(grid, self.unknown, clearance, SPACING, seed=0))
            places.append(spread)
            goals.append(ways.add_goals(row, spread[: self.pool]))
        counts = torch.tensor([len(spread) for spread in places])
        self._check_room(prepared.bank, counts)
        for grid, starts, ends in zip(prepared.bank.grids, places, goals, strict=True):
            pairs = len(starts) * len(ends)
            points, map_id = starts.float().repeat_interleave(len(ends), 0), torch.full((pairs,), grid.map_id)
            way = ways.next_waypoints(points, ends.repeat(len(starts)), map_id, identity_pose(pairs))
            far.append(((way.distance > NEAREST) & way.distance.isfinite()).view(len(starts), len(ends)))
            if not far[-1].any(1).all():
                raise UserError(
                    f"map {grid.name!r} has no two places with more than {NEAREST} m of way between them"
                )
        tables = _Candidates(
            map_id=torch.tensor([grid.map_id for grid in prepared.bank.grids]),
            places=pad_sequence(places, True, float("nan")),
            counts=counts,
            goals=pad_sequence(goals, True, -1),
            far=pad_sequence([pad(one, (0, self.pool - one.shape[1])) for one in far], True),
            row_of_goal=torch.cat([torch.full_like(ids, row) for row, ids in enumerate(goals)]),
            place_of_goal=torch.cat([torch.arange(len(ids)) for ids in goals]),
        )
        return replace(prepared, tables=tables)

    def _check_room(self, bank: MapBank, counts: Tensor) -> None:
        """Raise the error for too many people."""
        for grid, room in zip(bank.grids, counts.tolist(), strict=True):
            if room < self.people:
                raise UserError(
                    f"{self.people} people do not fit on map {grid.name!r}: its free space has room for "
                    f"{room} starts {SPACING} m apart"
                )

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people at places of their own, each with a goal that is some way off."""
        tables = prepared.tables.to(draws.key.device)
        row = draws.integers("map", len(tables.map_id)).to(draws.key.device)
        # each person gets another place: those with the smallest numbers of a whole row of them
        slots = tables.places.shape[1]
        absent = torch.arange(slots, device=row.device) >= tables.counts[row].unsqueeze(1)
        lottery = draws.uniform("place", slots).masked_fill(absent, 2.0)
        place = lottery.topk(self.people, largest=False).indices
        start = tables.places[row.unsqueeze(1), place]
        number = self.fewest + draws.integers("people", self.people - self.fewest + 1)
        mask = torch.arange(self.people, device=row.device) < number.unsqueeze(1)
        goal = tables.goal(row.unsqueeze(1), place, draws.uniform("goal", self.people))
        return Layout(tables.map_id[row], start.float(), mask, self.speeds(draws), goal)

    def next_goal(
        self, prepared: PreparedScenario, draws: Draws, agent: Tensor, number: Tensor, last: Tensor
    ) -> Tensor:
        """Return another goal that is some way off the last one."""
        tables = prepared.tables.to(last.device)
        row, place = tables.row_of_goal[last], tables.place_of_goal[last]
        return tables.goal(row, place, draws.uniform_at("goal", agent, number))


class _Candidates(NamedTuple):
    """Candidates of the draws, for M floor plans with at most S places, of which the first G are goals."""

    map_id: Tensor  # the floor plans (M,) long
    places: Tensor  # starts (M, S, 2), metres; NaN where there are fewer
    counts: Tensor  # how many places there are (M,) long
    goals: Tensor  # the planner's numbers of goals (M, G) long, -1 where there are fewer
    far: Tensor  # which goals are some way off each place (M, S, G) bool
    row_of_goal: Tensor  # floor plan of every goal of the planner
    place_of_goal: Tensor  # its place on that

    def to(self, device: torch.device) -> _Candidates:
        return _Candidates(*(table.to(device) for table in self))

    def goal(self, row: Tensor, place: Tensor, lot: Tensor) -> Tensor:
        """Return the goal (...) that ``lot`` (...) from 0 to 1 falls on, of those some way off places."""
        allowed = self.far[row, place]
        count = allowed.sum(-1)
        index = (lot * count).long().minimum(count - 1)
        return self.goals[row, (allowed.cumsum(-1) > index.unsqueeze(-1)).int().argmax(-1)]
