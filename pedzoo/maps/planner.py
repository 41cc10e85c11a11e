"""The global planner: ways through floor plans to people's goals, looked up for everybody at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from pedzoo.errors import UserError
from pedzoo.geometry import move_to_map, move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.corners import CornerGraph
from pedzoo.maps.fields import Fields, build_fields
from pedzoo.maps.graph import OpenGraph
from pedzoo.maps.tables import Goal, Tables

BODY_CLEARANCE = 0.15
"""Metres that the line to the carrot keeps from walls: a body's radius."""

_SPACING = 0.3
"""Metres between samples of that line: with the clearance around each, no wall fits between two of them."""

_EPSILON = 1e-6


class Look(NamedTuple):
    """Where people's ways lead, in the scene's frame, metres."""

    waypoint: Tensor
    """The farthest point of the way in sight (P, 2); where none leads to the goal, the person's position."""
    next_waypoint: Tensor
    """The waypoint after that (P, 2): the same where the way ends."""
    goal_point: Tensor
    """The goal (P, 2)."""
    distance: Tensor
    """Length of the way to the goal (P,): ``inf`` where none leads to it, 0 for people without a goal."""


class Guidance(NamedTuple):
    """What people are told, in the scene's frame, metres and seconds."""

    goal: Tensor
    """The carrot (P, 2)."""
    desired_velocity: Tensor
    """``pref_speed`` towards the next waypoint (P, 2)."""
    waypoint: Tensor
    """As in `Look` (P, 2)."""
    goal_point: Tensor
    """As in `Look` (P, 2)."""
    distance: Tensor
    """As in `Look` (P,)."""


class Planner:
    """Ways to goals on the floor plans of a bank.

    Goals are registered once (`add_goals`); at first use every goal gets a field of next waypoints over its
    whole floor plan, so that asking for anybody's way from anywhere is two look-ups. People who are not on
    an open cell (pushed towards a wall, or outside the map) take the way of the nearest open cell, and go to
    that cell's centre first when it is farther away than the clearance.

    Attributes:
        bank: The floor plans.
        clearance: Metres that ways keep from walls, at the centres of the cells they lead through.
        snap: Metres that a goal may be moved to the nearest open cell.
    """

    def __init__(self, bank: MapBank, clearance: float = 0.25, snap: float = 0.5) -> None:
        """Take the floor plans; nothing is computed before the first goal.

        Raises:
            UserError: The clearance or the snap is negative.
        """
        if clearance < 0 or snap < 0:
            raise UserError(f"planner clearance {clearance} and snap {snap} must be metres, at least 0")
        self.bank = bank
        self.clearance = clearance
        self.snap = snap
        self._graphs: dict[int, OpenGraph] = {}
        self._corners: dict[int, CornerGraph] = {}
        self._ids: dict[tuple[int, float, float], int] = {}
        self._goals: list[Goal] = []
        self._tables = Tables.build([None] * len(bank.grids), [], None, [])

    @property
    def goals(self) -> int:
        """How many goals there are: their ids are 0 to that, exclusive."""
        return len(self._goals)

    def graph(self, row: int) -> OpenGraph:
        """Return the open cells of the bank's map ``row``."""
        if row not in self._graphs:
            self._graphs[row] = OpenGraph(self.bank.grids[row], self.bank.unknown, self.clearance)
        return self._graphs[row]

    def corners(self, row: int) -> CornerGraph:
        """Return the graph that `path` searches on the bank's map ``row``."""
        if row not in self._corners:
            self._corners[row] = CornerGraph(self.graph(row))
        return self._corners[row]

    def add_goals(self, row: int, points: ArrayLike | Tensor) -> Tensor:
        """Return the ids (G,) of goals at map-frame ``points`` (G, 2); a known point keeps its id.

        A goal that is not in an open cell is moved to the centre of the nearest one, by ``snap`` at most.

        Args:
            row: Row of the map in the bank, -1 for goals without a map.
            points: Where the goals are, metres.

        Raises:
            UserError: A goal is not finite, in or too near a wall, or outside the map.
        """
        places = _as_points(points)
        ids = []
        cells = [-1] * len(places)
        if row >= 0 and len(places):
            cells, places = self._settle(row, places, "goal")
        for (x, y), cell in zip(places.tolist(), cells, strict=True):
            key = (row, x, y)
            if key not in self._ids:
                self._ids[key] = len(self._goals)
                self._goals.append(Goal(row, (x, y), int(cell)))
            ids.append(self._ids[key])
        return torch.tensor(ids, dtype=torch.long)

    def prepare(self) -> None:
        """Build the fields of all goals that have none yet."""
        first = self._tables.goals
        fresh = self._goals[first:]
        if not fresh:
            return
        fields: dict[int, Fields] = {}
        for row in {goal.row for goal in fresh}:
            mine = [i for i, goal in enumerate(fresh) if goal.row == row]
            if row < 0:
                built = Fields(torch.zeros(len(mine), 0, dtype=torch.int32), torch.zeros(len(mine), 0))
            else:
                graph = self.graph(row)
                points = graph.to_place(np.array([fresh[i].point for i in mine]))
                built = build_fields(graph, np.array([fresh[i].cell for i in mine]), points)
            for k, i in enumerate(mine):
                fields[i] = Fields(built.waypoint[k : k + 1], built.length[k : k + 1])
        maps = [self._graphs.get(row) for row in range(len(self.bank.grids))]
        ordered = [fields[i] for i in range(len(fresh))]
        self._tables = Tables.build(maps, self._goals, self._tables, ordered)

    def look(self, points: Tensor, goal_id: Tensor, map_id: Tensor, pose: Tensor) -> Look:
        """Return everybody's next waypoints and how far their goals are.

        Waypoints are constants to autograd; the distance is differentiable with respect to ``points``.

        Args:
            points: Scene positions (P, 2), metres.
            goal_id: From `add_goals` (P,) long; -1 for no goal: the waypoint is the position itself.
            map_id: Floor plan of each person (P,) long, -1 for none: the way leads straight to the goal.
            pose: Scene poses (P, 4).

        Raises:
            UserError: A goal is of another map than the person, or unknown.
        """
        waypoint, after, goal, onward, _ = self._look(points, goal_id, map_id, pose)
        distance = (waypoint - points).norm(dim=1) + onward
        return Look(waypoint, after, goal, distance)

    def _look(self, points: Tensor, goal_id: Tensor, map_id: Tensor, pose: Tensor) -> tuple[Tensor, ...]:
        self.prepare()
        self._tables = tables = self._tables.to(points.device)
        row = self.bank.index(map_id)
        with torch.no_grad():
            home = move_to_map(points, pose)
            found = tables.look(home, goal_id, row)
            scene = move_to_scene(torch.stack((found.waypoint, found.after, found.goal), dim=1), pose)
            waypoint, after, goal = scene.unbind(1)
            stay = (goal_id < 0) | found.onward.isinf()
        waypoint = torch.where(stay[:, None], points.detach(), waypoint)
        after = torch.where(stay[:, None], points.detach(), after)
        goal = torch.where((goal_id < 0)[:, None], points.detach(), goal)
        return waypoint, after, goal, found.onward, found.last

    def guide(
        self,
        points: Tensor,
        goal_id: Tensor,
        map_id: Tensor,
        pose: Tensor,
        pref_speed: Tensor,
        look_ahead_seconds: float,
    ) -> Guidance:
        """Return everybody's carrot and desired velocity.

        The carrot is the point of the way that is reached in ``look_ahead_seconds`` at ``pref_speed``; past
        the goal the last segment is prolonged, so that people walk through it instead of braking. It is
        moved back towards the waypoint until the line to it keeps a body's radius from walls.

        Args:
            points: Scene positions (P, 2), metres.
            goal_id: As in `look`.
            map_id: As in `look`.
            pose: As in `look`.
            pref_speed: Metres per second (P,).
            look_ahead_seconds: How far ahead the carrot is.
        """
        waypoint, after, end, onward, last = self._look(points, goal_id, map_id, pose)
        way = waypoint - points
        length = way.norm(dim=1)
        second = after - waypoint
        second_length = second.norm(dim=1)
        there = (length > _EPSILON)[:, None]
        beyond = second / second_length.clamp_min(_EPSILON)[:, None]
        direction = torch.where(there, way / length.clamp_min(_EPSILON)[:, None], beyond)
        beyond = torch.where((second_length > _EPSILON)[:, None], beyond, direction)

        ahead = pref_speed * look_ahead_seconds
        rest = (ahead - length).clamp_min(0)
        # a second segment that does not end at the goal is as far as anybody looks
        rest = torch.where(last, rest, torch.minimum(rest, second_length))
        with torch.no_grad():
            rest = self._in_sight(points, map_id, pose, waypoint, beyond, rest)
        goal = torch.where(
            (length < ahead)[:, None], waypoint + beyond * rest[:, None], points + direction * ahead[:, None]
        )
        return Guidance(goal, direction * pref_speed[:, None], waypoint, end, length + onward)

    def _in_sight(
        self, points: Tensor, map_id: Tensor, pose: Tensor, waypoint: Tensor, beyond: Tensor, rest: Tensor
    ) -> Tensor:
        """Return how far beyond the waypoint the carrot is seen (P,): ``rest``, a half, a quarter, or not."""
        rest = rest.clone()
        who = torch.nonzero((rest > 0) & (map_id >= 0))[:, 0]
        for _ in range(3):
            if not len(who):
                return rest
            here, carrot = points[who], waypoint[who] + beyond[who] * rest[who, None]
            chord = carrot - here
            count = int(chord.norm(dim=1).max() / _SPACING) + 1
            part = torch.arange(1, count + 1, device=points.device) / count
            line = here[:, None] + chord[:, None] * part[:, None]
            clear = (self.bank.signed_distance(line, map_id[who], pose[who]) >= BODY_CLEARANCE).all(dim=1)
            who = who[~clear]
            rest[who] *= 0.5
        rest[who] = 0
        return rest

    def path(self, start: ArrayLike | Tensor, goal: ArrayLike | Tensor, row: int) -> NDArray[np.float64]:
        """Return the waypoints (W, 2) of a shortest way in the map's frame: the goal is the last.

        Start and goal are moved like goals in `add_goals` when they are not in open cells.

        Args:
            start: Where the way begins (2,), metres.
            goal: Where it ends (2,).
            row: Row of the map in the bank, -1 for none: straight to the goal.

        Raises:
            UserError: No way leads there, or an end of it is in a wall or outside the map.
        """
        ends = _as_points(np.stack((np.asarray(start), np.asarray(goal))))
        if row < 0:
            return ends[1:]
        graph = self.graph(row)
        first, begin = self._settle(row, ends[:1], "start")
        last, place = self._settle(row, ends[1:], "goal")
        if graph.component[first[0]] != graph.component[last[0]]:
            raise UserError(
                f"no way from {_show(ends[0])} to {_show(ends[1])} on map {graph.grid.name!r}: they are in "
                f"rooms without a door between that leaves clearance {self.clearance} m"
            )
        bends = self.corners(row).way(
            int(first[0]), int(last[0]), graph.to_place(begin)[0], graph.to_place(place)[0]
        )
        return np.concatenate((graph.xy[bends], place))

    def _settle(
        self, row: int, points: NDArray[np.float64], what: str
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return the open cells of points, and the points, moved where they had to be."""
        graph = self.graph(row)
        if not len(graph):
            raise UserError(
                f"map {graph.grid.name!r} has no cell with clearance {self.clearance} m: nobody can walk"
                " there"
            )
        flat, inside = graph.locate(points)
        cell = graph.nearest[flat]
        snapped = ~inside | (graph.index[flat] < 0)
        moved = np.where(snapped[:, None], graph.xy[cell], points)
        far = np.linalg.norm(moved - points, axis=1) > self.snap
        if far.any():
            i = int(far.argmax())
            where = "is in a wall or too near to one" if inside[i] else "is outside the map"
            raise UserError(
                f"{what} {_show(points[i])} {where} on map {graph.grid.name!r}: the nearest point with "
                f"clearance {self.clearance} m is {_show(moved[i])}, more than {self.snap} m away"
            )
        return cell, moved


def _as_points(points: ArrayLike | Tensor) -> NDArray[np.float64]:
    given = points.detach().cpu().numpy() if isinstance(points, Tensor) else points
    found = np.array(given, dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(found).all():
        raise UserError(
            f"goals must be finite positions in metres, got {found[~np.isfinite(found).all(1)][0]}"
        )
    return found


def _show(point: NDArray[np.float64]) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"
