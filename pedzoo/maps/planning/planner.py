"""The planner: shortest paths through floor plans to goals, for all agents at once.

A path bends only at corners of obstacles (`CornerGraph`). A goal costs one search of the
corners, `CornerGraph.search`. The way of an agent costs a comparison of all corners, of which only the
most promising are looked at. Another way of planning is another class with `Planner`'s public methods.
"""

from __future__ import annotations

import copy
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.geometry import move_to_map
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.graph import CellGraph, CornerGraph, OpenGraph, as_points, format_point
from pedzoo.maps.planning.guidance import Guidance, Waypoints, differentiable, guidance_along

_MANY = 50
"""Goals from which on a bar shows how far their searches are."""

NO_PATH, STRAIGHT = -2, -1
"""Stand for the corner where a path bends first: none leads to the goal, and it is in sight."""


class Goal(NamedTuple):
    """A goal: row of its map, place in the map's frame in metres, and its open cell; -1 without a map."""

    row: int
    point: tuple[float, float]
    cell: int


class Ways(NamedTuple):
    """What look-ups read: arrays, or tensors on a device.

    Maps are rows 1 to R, goals rows 1 to G; row 0 is "none" of both. Open cells and corners of all maps are
    numbered one map after another.
    """

    to_cell: Any
    """Affine from a map's frame in metres to cells by rows (6), last column and last row (2), and the squared
    distance in metres beyond which people go to the nearest open cell first: (9, R + 1) float32."""
    begin: Any
    """Columns, first cell, first open cell, cells, first corner, and corners of each map (6, R + 1)."""
    metre: Any
    """Metres of a cell (R + 1,)."""
    nearest: Any
    """The open cell of its map that is nearest to every cell, int32."""
    x: Any
    """Centres of open cells (N,) float32, metres."""
    y: Any
    """The same."""
    place: Any
    """Columns and rows of open cells (2, N) int32."""
    leap: Any
    """Tables of all maps' `Sight`, int16: map r's begins at thrice its first cell."""
    corner: Any
    """Open cells that are corners (K + 1,); the last one is none."""
    bend_x: Any
    """Columns of the corners (K,)."""
    bend_y: Any
    """Their rows."""
    bends: Any
    """`CornerGraph.bends` (2, K)."""
    goal: Any
    """Row of its map, its open cell, what is added to a corner for its place in ``far`` and, on accelerators,
    to an open cell for that in ``first`` (4, G + 1)."""
    end: Any
    """Places of goals (2, G + 1) float32, metres."""
    far: Any
    """Metres from corners to goals, infinite where no path leads there."""
    onward: Any
    """The next corner on the way there, int32, -1 for the goal itself."""
    first: Any
    """Where paths from open cells bend first, int32; `AStarPlanner` has it, and accelerators."""

    def cell(self, home: Tensor, row: Tensor) -> Tensor:
        """Return the open cells of positions (2, P) on maps ``row`` (P,), -1 for none."""
        width, first, opens = self.begin[:3].index_select(1, row + 1)
        a, b, c, d, e, f, last_column, last_row, _ = self.to_cell.index_select(1, row + 1)
        x, y = home
        # half cells belong to the smaller one, as in OpenGraph.locate
        column = (a * x + b * y + (c - 0.5)).ceil().clamp_min(0).minimum(last_column).long()
        line = (d * x + e * y + (f - 0.5)).ceil().clamp_min(0).minimum(last_row).long()
        return self.nearest.index_select(0, line * width + column + first) + opens

    def lookup(self, home: Tensor, goal: Tensor, cell: Tensor, first: Tensor) -> Waypoints:
        """Return where the paths of people at ``home`` (2, P) in open cells (P,) lead to goals (P,).

        ``first`` is the corner where each path bends first (P,) long, `STRAIGHT` or `NO_PATH`.
        """
        number, _, offset, _ = self.goal.index_select(1, goal + 1)
        bends = first >= 0
        entry = torch.where(bends, offset + first, 0)
        second = torch.where(bends, self.onward.index_select(0, entry).long(), -1)
        onward = torch.where(bends, self.far.index_select(0, entry), 0.0)
        places = self.corner[torch.stack((first.clamp_min(0), second.clamp_min(0)))]
        xy = torch.stack((self.x, self.y))
        end, is_last, near = self.end.index_select(1, goal + 1), second < 0, xy.index_select(1, cell)
        waypoint, after = xy[:, places].unbind(1)
        waypoint, after = torch.where(bends, waypoint, end), torch.where(is_last, end, after)

        reach = self.to_cell[8].index_select(0, number)
        away = ((home - near).square().sum(0) > reach) & (number > 0)
        onward = torch.where(away, onward + torch.hypot(*(waypoint - near)), onward)
        is_last, after = torch.where(away, ~bends, is_last), torch.where(away, waypoint, after)
        waypoint = torch.where(away, near, waypoint)
        # without a goal or a path to it people stay
        none = goal < 0
        stay = none | (first == NO_PATH)
        onward = torch.where(first == NO_PATH, torch.inf, onward).float()
        waypoint, after = torch.where(stay, home, waypoint), torch.where(stay, home, after)
        return Waypoints(home, waypoint, after, torch.where(none, home, end), onward, is_last | stay)


class Memory(NamedTuple):
    """What compiled loops remember: corners in sight of cells, and ways that bound others on large plans."""

    start: NDArray[np.int32]
    """Where in ``seen`` an open cell's corners begin (N,), 0 for none yet."""
    seen: NDArray[np.int32]
    """The last place in use; for each cell where its corners end, and these. Begun anew when it is full."""
    square: NDArray[np.int64]
    """Numbers of a goal and a square of 16 cells (M,)."""
    cell: NDArray[np.int64]
    """The open cell there that was asked for last (M,)."""
    length: NDArray[np.float64]
    """Metres of the way from it (M,)."""
    bend: NDArray[np.int64]
    """The first corner on that (M,)."""

    @classmethod
    def empty(cls, ways: Ways) -> Memory:
        """Return the memory of a planner that was not asked yet."""
        cells, square = len(ways.x), np.full(1 << 14, -1)
        # pages of zeros take no memory until they are written
        seen = np.zeros(min(64 * cells, 1 << 22) + len(ways.corner) + 1, np.int32)
        return cls(
            np.zeros(cells, np.int32), seen, square, square.copy(), np.zeros(len(square)), square.copy()
        )


class Planner:
    """Paths to goals on the floor plans of a bank.

    Goals are registered once (`add_goals`). People outside open cells (pushed towards a wall, or outside the
    map) take the path of the nearest open cell. They go to that cell's centre first when it is farther away
    than the clearance. Memory grows with goals times corners. Devices other than the CPU also get the first
    corner of every cell before the first step, because nothing is read back there.

    Attributes:
        bank: The floor plans.
        clearance: Metres that paths keep from walls, at the centres of the cells they lead through.
        snap: Metres that a goal may be moved to the nearest open cell.
        cell: Metres to which finer cells are joined for the search.
        origin: Of the maps' frame in the caller's (2,), metres: messages name places in the caller's.
        name: What options call this kind of planner.
        compiled: Whether compiled loops are used on the CPU.
    """

    name: ClassVar[str] = "shortest"
    searched: ClassVar[type] = CornerGraph
    compiled = True

    def __init__(
        self,
        bank: MapBank,
        clearance: float = 0.25,
        snap: float = 0.5,
        cell: float = 0.0,
        origin: ArrayLike = 0.0,
    ) -> None:
        """Take the floor plans; nothing is computed before the first goal.

        Raises:
            UserError: A length is negative.
        """
        if not min(clearance, snap, cell) >= 0:
            raise UserError(
                f"planner clearance {clearance}, snap {snap}, cell {cell} must be metres, at least 0"
            )
        self.bank, self.clearance, self.snap, self.cell, self.origin = bank, clearance, snap, cell, origin
        self._corners: dict[int, CornerGraph] = {}
        self._rows: set[int] = set()  # maps that look-ups know
        self._maps: Ways | None = None
        self._forget_goals()

    def _forget_goals(self) -> None:
        self._ids: dict[tuple[int, float, float], int] = {}
        self._goals: list[Goal] = []
        self._searched: list[tuple[NDArray[np.float64], NDArray[np.int32]]] = []
        self._ways: Ways | None = None
        self._memory = None if self._maps is None else Memory.empty(self._maps)
        # for each device the arrays and their copy there
        self._copies: dict[torch.device, tuple[Ways, Ways]] = {}

    def without_goals(self) -> Planner:
        """Return a planner of the same floor plans without goals."""
        result = copy.copy(self)
        result._forget_goals()
        return result

    @property
    def goals(self) -> int:
        """How many goals there are: their ids are 0 to that, exclusive."""
        return len(self._goals)

    def graph(self, row: int) -> OpenGraph:
        """Return the open cells of the bank's map ``row``."""
        return self.corners(row).graph

    def corners(self, row: int) -> CornerGraph:
        """Return the corners of the bank's map ``row``."""
        if row not in self._corners:
            grid = self.bank.grids[row].coarser(self.cell)
            self._corners[row] = self.searched(OpenGraph(grid, self.bank.unknown, self.clearance))
        return self._corners[row]

    def add_goals(self, row: int, points: ArrayLike | Tensor) -> Tensor:
        """Return the ids (G,) of goals at map-frame ``points`` (G, 2); a known point keeps its id.

        A goal that is not in an open cell is moved to the centre of the nearest one, by ``snap`` at most.
        ``row`` is that of the map in the bank, -1 for goals without a map.

        Raises:
            UserError: A goal is not finite, in or too near a wall, or outside the map.
        """
        places = as_points(points)
        cells = [-1] * len(places)
        if row >= 0 and len(places):
            cells, places = self.graph(row).settle(places, self.snap, "goal", self.origin)
        ids = []
        for (x, y), cell in zip(places.tolist(), cells, strict=True):
            key = (row, x, y)
            if key not in self._ids:
                self._ids[key] = len(self._goals)
                self._goals.append(Goal(row, (x, y), int(cell)))
            ids.append(self._ids[key])
        return torch.tensor(ids, dtype=torch.long)

    def prepare(self) -> Ways:
        """Search the ways to all goals that have none yet, and return all; look-ups do so, too."""
        if self._ways is not None and len(self._searched) == len(self._goals):
            return self._ways
        rows = {goal.row for goal in self._goals} - {-1}
        if self._maps is None or not rows <= self._rows:
            self._rows = self._rows | rows
            self._maps = self._of_maps()
            self._memory = Memory.empty(self._maps)
        fresh = self._goals[len(self._searched) :]
        if len(fresh) >= _MANY:  # a bar has a semaphore, which workers that are killed leave behind
            from tqdm import tqdm

            fresh = tqdm(fresh, "ways to goals", delay=2.0, leave=False, disable=None)
        for goal in fresh:
            if goal.row < 0:
                self._searched.append((np.empty(0), np.empty(0, np.int32)))
                continue
            corners = self.corners(goal.row)
            place = corners.graph.to_place(np.array([goal.point]))[0]
            self._searched.append(corners.search(goal.cell, place))
        number = np.array([goal.row + 1 for goal in self._goals], dtype=np.int64)
        cells = np.array([max(goal.cell, 0) for goal in self._goals], dtype=np.int64)
        begin = self._maps.begin[:, number]
        first = np.cumsum([1, *(len(far) for far, _ in self._searched)])[:-1]  # entry 0 is of no corner
        goals = np.stack((number, cells + begin[2], first - begin[4], np.zeros_like(cells)))
        ends = np.array([(0.0, 0.0), *(goal.point for goal in self._goals)], dtype=np.float32)
        onward = [
            np.where(corner < 0, -1, corner + start).astype(np.int32)
            for (_, corner), start in zip(self._searched, begin[4], strict=True)
        ]
        ways = self._maps._replace(
            goal=np.concatenate((np.zeros((4, 1), np.int64), goals), axis=1),
            end=ends.T,
            far=np.concatenate([[np.inf], *(far for far, _ in self._searched)]),
            onward=np.concatenate([np.full(1, -1, np.int32), *onward]),
        )
        # compiled loops are compiled again for arrays with gaps
        self._ways = Ways(*(np.ascontiguousarray(part) for part in ways))
        return self._ways

    def _of_maps(self) -> Ways:
        """Return what look-ups read of the maps that have goals; others are like no map, a single cell."""
        nowhere, cells, opens, count = (np.zeros(9), (1, 0, 0, 1, 0, 0), 1.0), 1, 1, 0
        sizes = (((1,), "i4"), ((1, 2), "f8"), ((1, 2), "i4"), ((3,), "i2"), ((0,), "i8"), ((0, 2), "?"))
        columns, arrays = [nowhere], [tuple(np.zeros(size, kind) for size, kind in sizes)]
        for row in range(len(self.bank.grids)):
            if row not in self._rows:
                columns.append(nowhere)
                continue
            graph, own = self.graph(row), self.corners(row)
            reach = max(self.clearance, 1.5 * graph.grid.resolution) ** 2
            to_cell = [*graph.grid.map_to_cell().ravel(), graph.shape[1] - 1, graph.shape[0] - 1, reach]
            begin = graph.shape[1], cells, opens, graph.open.size, count, len(own.cells)
            columns.append((np.array(to_cell), begin, graph.grid.resolution))
            at = own.cells.astype(np.int64) + opens
            arrays.append((graph.nearest, graph.xy, graph.place, graph.sight.leap, at, own.bends.T))
            cells, opens, count = cells + graph.open.size, opens + len(graph), count + len(own.cells)
        to_cell, begin, metre = (np.stack(part, axis=-1) for part in zip(*columns, strict=True))
        nearest, xy, place, leap, corner, bends = (np.concatenate(part) for part in zip(*arrays, strict=True))
        (x, y), (bend_x, bend_y) = xy.T.astype(np.float32), place[corner].T.astype(np.float64)
        none = np.zeros(1, np.int64)
        return Ways(
            to_cell=to_cell.astype(np.float32),
            begin=begin,
            metre=metre,
            nearest=nearest,
            x=x,
            y=y,
            place=place.T,
            leap=leap,
            corner=np.append(corner, none),
            bend_x=bend_x,
            bend_y=bend_y,
            bends=bends.T,
            goal=none,
            end=none,
            far=none,
            onward=none,
            first=np.zeros(1, np.int32),
        )

    def _first(self, cells: NDArray[np.int64], goals: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the corners where paths from open cells (P,) to goals (P,) on their maps bend first."""
        from pedzoo.maps.planning.planner_numba import first_corners

        ways, found = self.prepare(), np.full(len(cells), NO_PATH)
        first_corners(ways, self._memory, cells, goals, found)
        return found

    def _on(self, device: torch.device) -> Ways:
        """Return all ways on a device, on an accelerator with the first corners of all cells."""
        ways = self.prepare()
        if device in self._copies and self._copies[device][0] is ways:
            return self._copies[device][1]
        everything = ways
        if device.type != "cpu" and len(ways.first) == 1:
            firsts, goal, used = [ways.first], ways.goal.copy(), 1
            for number, row in enumerate(goal.row for goal in self._goals):
                if row >= 0:
                    opens, count = int(ways.begin[2, row + 1]), len(self.graph(row))
                    firsts.append(self._first(opens + np.arange(count), np.full(count, number)))
                    goal[3, number + 1] = used - opens
                    used += count
            everything = ways._replace(first=np.concatenate(firsts).astype(np.int32), goal=goal)
        self._copies[device] = ways, Ways(*(torch.from_numpy(part).to(device) for part in everything))
        return self._copies[device][1]

    def map_rows(self, map_id: Tensor) -> Tensor:
        """Return the rows (N,) long of floor plans ``map_id`` (N,) in the bank; -1 stays -1.

        Raises:
            UserError: One is not in the bank.
        """
        return self.bank.to(map_id.device).index(map_id)

    def next_waypoints(self, points: Tensor, goal_id: Tensor, map_id: Tensor, pose: Tensor) -> Guidance:
        """Return the guidance (P, ...) of people of whom each is in a scene of their own, at 1 m/s.

        Args:
            points: Scene positions (P, 2), metres.
            goal_id: From `add_goals` (P,) long; -1 for no goal: the waypoint is the position itself.
            map_id: Floor plan of each person (P,) long, -1 for none: the path leads straight to the goal.
            pose: Scene poses (P, 4).

        Raises:
            UserError: A goal is of another map than the person.
        """
        row = self.map_rows(map_id)
        of_map = torch.tensor([-1, *(goal.row for goal in self._goals)]).to(row.device)[goal_id + 1]
        wrong = (of_map != row) & (goal_id >= 0)
        if wrong.any():
            i = int(wrong.nonzero()[0, 0])
            raise UserError(
                f"goal {int(goal_id[i])} was added for row {int(of_map[i])} of the bank, but person {i} "
                f"is on row {int(row[i])} (-1: no map)"
            )
        people = points.unsqueeze(1), goal_id.unsqueeze(1), row, pose, torch.ones_like(points[:, :1])
        return Guidance(*(part.squeeze(1) for part in self.guidance(*people, 1.0, 1.0)))

    @torch.no_grad()
    def _paths(self, points: Tensor, goal: Tensor, row: Tensor, pose: Tensor) -> Waypoints:
        """Return where agents (B, A) go, (2, B, A) each; see `guidance`."""
        there = move_to_map(points.detach().float(), pose.float()).movedim(-1, 0).flatten(1)
        goals, rows = goal.flatten(), row.unsqueeze(1).expand(goal.shape).flatten()
        ways = self._on(points.device)
        cell = ways.cell(there, rows)
        number, _, _, offset = ways.goal.index_select(1, goals + 1)
        walks = (number > 0) & (number == rows + 1)
        first = torch.where((number > 0) & ~walks, NO_PATH, STRAIGHT)
        if points.device.type == "cpu":
            first[walks] = torch.from_numpy(self._first(cell[walks].numpy(), goals[walks].numpy()))
        else:
            known = ways.first.index_select(0, torch.where(walks, offset + cell, 0)).long()
            first = torch.where(walks, known, first)
        paths = ways.lookup(there, goals, cell, first)
        return Waypoints(*(part.view(*part.shape[:-1], *goal.shape) for part in paths))

    def guidance(
        self,
        points: Tensor,
        goal_id: Tensor,
        row: Tensor,
        pose: Tensor,
        pref_speed: Tensor,
        look_ahead_seconds: float,
        fastest: float,
    ) -> Guidance:
        """Return the short-term goals and desired velocities of the agents of B scenes, (B, A, ...).

        The carrot is the point of the path that is reached in ``look_ahead_seconds`` at ``pref_speed``. Past
        the goal the last segment is prolonged, so that people walk through it instead of braking: whoever
        has no other goal is stopped there by the scene's rules. A carrot beyond the next waypoint is moved
        back until the line to it keeps a body's radius from walls. A half of what is beyond is kept, a
        quarter, or nothing. Agents without a goal, or a path to it, stay.

        The short-term goal is as far ahead as people walk in that time, as ``window_end`` goals of recordings
        are. Where the carrot is nearer, it is moved out along the line to it.

        On accelerators nothing is read back to the host. On the CPU compiled loops answer. Goals, carrots,
        velocities and distances are differentiable with respect to points and speeds; waypoints are
        constants.

        Args:
            points: Scene positions (B, A, 2), metres.
            goal_id: From `add_goals` (B, A) long, of the scenes' floor plans; -1 for no goal.
            row: Floor plan of each scene in the bank (B,) long, -1 for none.
            pose: Scene poses (B, 4).
            pref_speed: Metres per second (B, A).
            look_ahead_seconds: How far ahead goals are.
            fastest: No ``pref_speed`` is above it, m/s.
        """
        if not (self.compiled and points.device.type == "cpu"):
            paths = self._paths(points, goal_id, row, pose)
            walls = self.bank.to(row.device).walls_on_map(row).per_scene() if self.bank.grids else None
            return guidance_along(points, paths, pose, pref_speed, look_ahead_seconds, walls, fastest)
        from pedzoo.maps.planning.planner_numba import guide

        given = (points.float(), goal_id, row, pose.float(), pref_speed.float())
        goal, desired, waypoint, point, carrot = (torch.empty(*goal_id.shape, 2) for _ in range(5))
        made = Guidance(goal, desired, waypoint, point, torch.empty(goal_id.shape), carrot)
        written: list[Any] = [part.numpy() for part in made]
        guide(
            *(part.detach().contiguous().numpy() for part in given),
            look_ahead_seconds,
            self.prepare(),
            self._memory,
            self.bank.walls.map_arrays,
            Guidance(*written),
        )
        if torch.is_grad_enabled() and (points.requires_grad or pref_speed.requires_grad):
            return differentiable(made, points, pref_speed, look_ahead_seconds)
        return made

    def path(self, start: ArrayLike | Tensor, goal: ArrayLike | Tensor, row: int) -> NDArray[np.float64]:
        """Return the waypoints (W, 2) of a shortest path in the map's frame: the goal is the last.

        Start and goal (2,), metres, are moved like goals in `add_goals`. Without a map, row -1, it is
        straight.

        Raises:
            UserError: No path leads there, or an end of it is in a wall or outside the map.
        """
        ends = np.concatenate((as_points(start), as_points(goal)))
        if row < 0:
            return ends[1:]
        graph = self.graph(row)
        (first, last), moved = graph.settle(ends, self.snap, "start or goal")
        if graph.component[first] != graph.component[last]:
            raise UserError(
                f"no way from {format_point(ends[0])} to {format_point(ends[1])} on map "
                f"{graph.grid.name!r}: they are in rooms without a door between "
                f"that leaves clearance {self.clearance} m"
            )
        alone = self.without_goals()
        alone.add_goals(row, moved[1:])
        ways, chain = alone.prepare(), []
        opens = ways.begin[2, row + 1]
        corner = int(alone._first(np.array([first + opens]), np.zeros(1, np.int64))[0])
        while corner >= 0:
            chain.append(graph.xy[ways.corner[corner] - opens])
            corner = int(ways.onward[ways.goal[2, 1] + corner])
        return np.array([*chain, moved[1]])


class AStarPlanner(Planner):
    """Paths along the grid, as in the paper: up to 8.24 % longer than the shortest ones of `Planner`.

    Each goal costs a search of all cells, and each agent a look-up. Memory grows with goals times cells.
    """

    name = "astar"
    searched: ClassVar[type] = CellGraph

    def prepare(self) -> Ways:
        """See `Planner.prepare`: where paths bend first is known of all cells."""
        before, ways = self._ways, super().prepare()
        if ways is not before:
            first = np.where(ways.onward >= 0, ways.onward, np.where(np.isinf(ways.far), NO_PATH, STRAIGHT))
            _, _, opens, _, begin, _ = ways.begin[:, ways.goal[0]]
            goal = np.concatenate((ways.goal[:3], (ways.goal[2] + begin - opens)[None]))
            ways = self._ways = ways._replace(first=first.astype(np.int32), goal=goal)
        return ways


PLANNERS = {one.name: one for one in (Planner, AStarPlanner)}
"""Planners by name."""


def planner_class(name: str) -> type[Planner]:
    """Return a planner by name. Raises UserError: there is no such one."""
    if name not in PLANNERS:
        raise unknown("planner", name, PLANNERS)
    return PLANNERS[name]
