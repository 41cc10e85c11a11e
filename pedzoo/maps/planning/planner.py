"""The global planner: paths through floor plans to people's goals, looked up for all people at once."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from pedzoo.core.errors import UserError, installed
from pedzoo.maps.bank import MapBank
from pedzoo.maps.planning.compiled_guidance import guidance_compiled
from pedzoo.maps.planning.corners import CornerGraph
from pedzoo.maps.planning.fields import Fields, build_fields
from pedzoo.maps.planning.graph import OpenGraph, as_points, format_point
from pedzoo.maps.planning.guidance import Guidance, NextWaypoints, heading, seen_beyond, segments
from pedzoo.maps.planning.planar import ScenePose
from pedzoo.maps.planning.waypoint_table import Goal, WaypointLookup, WaypointTable


class Planner:
    """Paths to goals on the floor plans of a bank.

    Goals are registered once (`add_goals`). At first use every goal gets a field of next waypoints over its
    whole floor plan, so that the path from any place is two look-ups. People outside open cells (pushed
    towards a wall, or outside the map) take the path of the nearest open cell. They go to that cell's centre
    first when it is farther away than the clearance.

    Attributes:
        bank: The floor plans.
        clearance: Metres that paths keep from walls, at the centres of the cells they lead through.
        snap: Metres that a goal may be moved to the nearest open cell.
        cell: Metres to which finer cells are joined for the search.
        share: Side of squares, metres, in which all goals have the paths to one of them.
        compiled: Whether compiled loops are used on the CPU.
    """

    compiled = True
    origin: ArrayLike = 0.0
    """Of the maps' frame in the caller's (2,), metres: messages name places in the caller's."""

    def __init__(
        self,
        bank: MapBank,
        clearance: float = 0.25,
        snap: float = 0.5,
        cell: float = 0.0,
        share: float = 0.0,
    ) -> None:
        """Take the floor plans; nothing is computed before the first goal.

        Fields of hundreds of goals take minutes on 0.05 m cells. ``cell`` and ``share`` make them coarser:
        people still walk to the goal itself once it is in sight.

        Raises:
            UserError: A length is negative.
        """
        if not min(clearance, snap, cell, share) >= 0:
            raise UserError(
                f"planner clearance {clearance}, snap {snap}, cell {cell}, share {share} must be metres, at "
                "least 0"
            )
        self.bank = bank
        self.clearance = clearance
        self.snap, self.cell, self.share = snap, cell, share
        self._graphs: dict[int, OpenGraph] = {}
        self._corners: dict[int, CornerGraph] = {}
        self._ids: dict[tuple[int, float, float], int] = {}
        self._goals: list[Goal] = []
        self._rows: set[int] = set()  # maps that the table has
        self._with_fields = 0  # goals that it has
        self._table: WaypointTable | None = None
        # for each device the table on the CPU and its copy
        self._copies: dict[torch.device, tuple[WaypointTable, WaypointTable]] = {}

    @property
    def goals(self) -> int:
        """How many goals there are: their ids are 0 to that, exclusive."""
        return len(self._goals)

    def graph(self, row: int) -> OpenGraph:
        """Return the open cells of the bank's map ``row``."""
        if row not in self._graphs:
            self._graphs[row] = OpenGraph(
                self.bank.grids[row].coarser(self.cell), self.bank.unknown, self.clearance
            )
        return self._graphs[row]

    def corners(self, row: int) -> CornerGraph:
        """Return the graph that `path` searches on the bank's map ``row``."""
        if row not in self._corners:
            self._corners[row] = CornerGraph(self.graph(row))
        return self._corners[row]

    def add_goals(self, row: int, points: ArrayLike | Tensor) -> Tensor:
        """Return the ids (G,) of goals at map-frame ``points`` (G, 2); a known point keeps its id.

        A goal that is not in an open cell is moved to the centre of the nearest one, by ``snap`` at most.
        ``row`` is that of the map in the bank, -1 for goals without a map.

        Raises:
            UserError: A goal is not finite, in or too near a wall, or outside the map.
        """
        places = as_points(points)
        ids = []
        cells = [-1] * len(places)
        if row >= 0 and len(places):
            cells, places = self.graph(row).settle(places, self.snap, "goal", self.origin)
        for (x, y), cell in zip(places.tolist(), cells, strict=True):
            key = (row, x, y)
            if key not in self._ids:
                self._ids[key] = len(self._goals)
                self._goals.append(Goal(row, (x, y), int(cell)))
            ids.append(self._ids[key])
        return torch.tensor(ids, dtype=torch.long)

    def prepare(self) -> WaypointTable:
        """Build the fields of all goals that have none yet, and return them; look-ups do so, too.

        Add all known goals before the first look-up: building them together is faster, and each build
        copies the table.
        """
        table, done = self._table, self._with_fields
        if table is not None and done == len(self._goals):
            return table
        fresh = self._goals[done:]
        rows = {goal.row for goal in fresh}
        if table is None or not rows <= self._rows:
            self._rows |= rows
            maps = [self.graph(r) if r in self._rows else None for r in range(len(self.bank.grids))]
            table = (
                table.with_maps(maps, self.clearance) if table else WaypointTable.build(maps, self.clearance)
            )
        if fresh:
            table = table.with_goals(fresh, *self._build(fresh))
        self._table, self._with_fields = table, len(self._goals)
        return table

    def _build(self, goals: Sequence[Goal]) -> tuple[list[Fields], list[int]]:
        """Return fields, and which of them each goal has; all of a map are built together."""
        fields = [Fields(torch.zeros(1, 0, dtype=torch.int32), torch.zeros(1, 0))]
        which = [0] * len(goals)
        for row in {goal.row for goal in goals} - {-1}:
            mine = [i for i, goal in enumerate(goals) if goal.row == row]
            graph = self.graph(row)
            points = np.array([goals[i].point for i in mine])
            cells = np.array([goals[i].cell for i in mine])
            first, of = np.arange(len(mine)), np.arange(len(mine))
            if self.share:
                squares = np.column_stack((points // self.share, graph.component[cells]))
                _, first, of = np.unique(squares, axis=0, return_index=True, return_inverse=True)
            built = build_fields(graph, cells[first], graph.to_place(points[first]))
            for i, field in zip(mine, of.ravel().tolist(), strict=True):
                which[i] = len(fields) + field
            fields += [Fields(built.waypoint[k : k + 1], built.length[k : k + 1]) for k in range(len(first))]
        return fields, which

    def next_waypoints(self, points: Tensor, goal_id: Tensor, map_id: Tensor, pose: Tensor) -> NextWaypoints:
        """Return people's next waypoints and how far their goals are.

        Waypoints are constants to autograd; the distance is differentiable with respect to ``points``.

        Args:
            points: Scene positions (P, 2), metres.
            goal_id: From `add_goals` (P,) long; -1 for no goal: the waypoint is the position itself.
            map_id: Floor plan of each person (P,) long, -1 for none: the path leads straight to the goal.
            pose: Scene poses (P, 4).

        Raises:
            UserError: A goal is of another map than the person.
        """
        row = self.map_rows(map_id)
        self._on(points.device).check(goal_id, row)
        self._visit(points, goal_id, pose)
        frame = ScenePose.of(pose)
        _, waypoints = self._find(points, goal_id, row, frame)
        with torch.no_grad():
            places = torch.stack((waypoints.waypoint, waypoints.after, waypoints.goal), dim=1)
            waypoint, after, goal = frame.to_scene(places)
        distance = (waypoint - points).norm(dim=1) + waypoints.onward
        return NextWaypoints(waypoint, after, goal, distance)

    def map_rows(self, map_id: Tensor) -> Tensor:
        """Return the rows (N,) long of floor plans ``map_id`` (N,) in the bank; -1 stays -1.

        Raises:
            UserError: One is not in the bank.
        """
        return self.bank.to(map_id.device).index(map_id)

    def _on(self, device: torch.device) -> WaypointTable:
        """Return the table of all goals, on a device."""
        table = self.prepare()
        if table.waypoint.device == device:
            return table
        if self._copies.get(device, (None,))[0] is not table:
            self._copies[device] = table, table.to(device)
        return self._copies[device][1]

    @torch.no_grad()
    def _find(
        self, points: Tensor, goal: Tensor, row: Tensor, frame: ScenePose
    ) -> tuple[Tensor, WaypointLookup]:
        """Return agents' positions on the map (2, *E) and where they go, for points (*E, 2)."""
        home = frame.to_map(points.detach().float())
        waypoints = self._on(points.device).lookup(home.flatten(1), goal.flatten(), row.flatten())
        waypoints = WaypointLookup(*(part.view(*part.shape[:-1], *goal.shape) for part in waypoints))
        none = goal < 0
        stay = none | waypoints.onward.isinf()
        return home, waypoints._replace(
            waypoint=torch.where(stay, home, waypoints.waypoint),
            after=torch.where(stay, home, waypoints.after),
            goal=torch.where(none, home, waypoints.goal),
            last=waypoints.last | stay,
        )

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
        """Return the carrots and desired velocities of the agents of B scenes, (B, A, ...).

        The carrot is the point of the path that is reached in ``look_ahead_seconds`` at ``pref_speed``. Past
        the goal the last segment is prolonged, so that people walk through it instead of braking. A carrot
        beyond the next waypoint is moved back until the line to it keeps a body's radius from walls. A half
        of what is beyond is kept, a quarter, or nothing. Agents without a goal, or a path to it, stay.

        Nothing is read back to the host. On the CPU compiled loops answer. Carrots, velocities and distances
        are differentiable with respect to points and speeds; waypoints are constants.

        Args:
            points: Scene positions (B, A, 2), metres.
            goal_id: From `add_goals` (B, A) long, of the scenes' floor plans; -1 for no goal.
            row: Floor plan of each scene in the bank (B,) long, -1 for none.
            pose: Scene poses (B, 4).
            pref_speed: Metres per second (B, A).
            look_ahead_seconds: How far ahead the carrot is.
            fastest: No ``pref_speed`` is above it, m/s.
        """
        self._visit(points, goal_id, pose)
        if self.compiled and points.device.type == "cpu" and installed("numba"):
            table = self._on(points.device)
            return guidance_compiled(
                self.bank, table, points, goal_id, row, pose, pref_speed, look_ahead_seconds
            )
        frame = ScenePose.of(pose).per_scene()
        home, waypoints = self._find(points, goal_id, row.unsqueeze(1).expand(goal_id.shape), frame)
        with torch.no_grad():
            ahead = pref_speed * look_ahead_seconds
            length, second_length, beyond = segments(home, waypoints)
            # a second segment that does not end at the goal is as far as the carrot goes
            rest = (ahead - length).clamp_min(0)
            rest = torch.where(waypoints.last, rest, rest.minimum(second_length))
            if self.bank.grids:
                walls = self.bank.to(row.device).walls_on_map(row).per_scene()
                farthest = fastest * look_ahead_seconds
                rest = seen_beyond(walls, home, waypoints.waypoint, beyond, rest, farthest)
            places = torch.stack(
                (waypoints.waypoint, waypoints.goal, waypoints.waypoint + beyond * rest), dim=1
            )
            waypoint, point, carrot = frame.to_scene(places)
            straight = (length >= ahead).unsqueeze(-1)
        unit, distance = heading(points, waypoint, frame, length, beyond)
        goal = torch.where(straight, points + unit * ahead.unsqueeze(-1), carrot)
        return Guidance(goal, unit * pref_speed.unsqueeze(-1), waypoint, point, distance + waypoints.onward)

    def _visit(self, points: Tensor, goal_id: Tensor, pose: Tensor) -> None:
        """Take note of where agents with goals ask for their ways: fields have all cells already."""

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
        bends = self.corners(row).way(first, last, *graph.to_place(moved))
        return np.concatenate((graph.xy[bends], moved[1:]))
