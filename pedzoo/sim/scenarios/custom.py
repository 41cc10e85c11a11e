"""People with starts and goals of your own, written one by one; ``mine.yaml`` has the settings of this."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.geometry import identity_pose
from pedzoo.core.randomness import Draws
from pedzoo.core.types import BODY_RADIUS, OBS_LEN, STEP_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.planning.graph import format_point
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import load_plan
from pedzoo.sim.replay.script import SceneStarts
from pedzoo.sim.scenario import SLOWEST, WARM_SECONDS, Layout, PreparedScenario, Scenario
from pedzoo.sim.state import PAST_LEN

SWAP = [{"from": [-3.0, 0.0], "to": [3.0, 0.0]}, {"from": [3.0, 0.0], "to": [-3.0, 0.0]}]
"""Two people who change places."""

KEYS = ("from", "to", "speed")
"""What may stand of a person."""

EXPECTED = "expected {from: [x, y], to: [x, y]} in metres, and speed in m/s if it is their own"


class Custom(Scenario):
    """Every person walks from a given place to a given goal, and leaves there.

    People come to their start in a straight line, or stand there where that is no free floor; no warm start
    moves them. Episodes differ in people's speeds alone. Places too near to walls are moved to the nearest
    place where paths may lead, by half a metre at most.
    """

    begun = True

    def __init__(
        self,
        people: list[dict[str, Any]] = SWAP,
        map: str | None = None,
        speed: float = 1.3,
        speed_std: float = 0.2,
    ) -> None:
        """Set the scene.

        Args:
            people: For each ``{from: [-3, 0], to: [3, 0]}``, metres, and ``speed``, m/s, of those who have
                another mean than others.
            map: Floor plan, as of `pedzoo.sim.scenarios.goals`; none for an open space.
            speed: Mean preferred speed, m/s.
            speed_std: Its standard deviation.

        Raises:
            UserError: A person without start or goal, with a place that is none, or with an unknown key.
        """
        super().__init__(len(people), speed, speed_std)
        self.map = map
        for number, one in enumerate(people, 1):
            if wrong := [key for key in one if key not in KEYS]:
                raise unknown(f"key of person {number}", str(wrong[0]), KEYS)
        named = {f"person {number}": one for number, one in enumerate(people, 1)}
        self._starts, self._ends = (
            np.array([_place(name, one, end) for name, one in named.items()]) for end in KEYS[:2]
        )
        self._means = torch.tensor([_speed(name, one.get("speed", speed)) for name, one in named.items()])

    @property
    def fastest(self) -> float:
        """The largest preferred speed that can be drawn, m/s."""
        return float(self._means.max()) + 3 * self.speed_std

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plan, or none."""
        return [] if self.map is None else [load_plan(self.map)]

    def prepare(self, clearance: float) -> PreparedScenario:
        """Find the ways from starts to goals.

        Warns of places that are nearer to a wall than ``clearance``: they are moved, and goals count there.

        Raises:
            UserError: A place is in a wall or outside the map, two people overlap, or there is no way.
        """
        prepared = super().prepare(clearance)
        planner, starts = prepared.planner, self._starts
        row, map_id = -1, -1
        if prepared.bank.grids:
            row, map_id = 0, prepared.bank.grids[0].map_id
            self._check_free(prepared.bank, map_id)
            graph = planner.graph(row)
            _, starts = graph.settle(starts, planner.snap, "the start")
            _, ends = graph.settle(self._ends, planner.snap, "goal")
            for end, asked, places in zip(KEYS, (self._starts, self._ends), (starts, ends), strict=False):
                for number in range(self.people):
                    if text := graph.moved(f"person {number + 1}: {end}:", asked[number], places[number]):
                        warnings.warn(text, stacklevel=2)
        goal = planner.add_goals(row, self._ends)
        _check_apart(torch.from_numpy(starts))
        start, maps = torch.from_numpy(starts).float(), torch.full((self.people,), map_id)
        ways = planner.next_waypoints(start, goal, maps, identity_pose(self.people))
        self._check_ways(planner, ways.distance)
        ahead = torch.nn.functional.normalize(ways.waypoint - start, dim=1)
        # back to where the fastest would be at the first observed step
        steps = torch.linspace(0, WARM_SECONDS * self.fastest, 32)
        behind = start.unsqueeze(1) - steps[:, None] * ahead.unsqueeze(1)
        if row >= 0:
            room = prepared.bank.signed_distance(behind, maps, identity_pose(self.people)).amin(1)
            ahead = ahead * (room > BODY_RADIUS).unsqueeze(1)
        return replace(prepared, tables=_Starts(map_id, start, ahead, goal))

    def _check_free(self, bank: MapBank, map_id: int) -> None:
        """Raise the error for places inside a wall."""
        for end, places in zip(KEYS, (self._starts, self._ends), strict=False):
            maps, pose = torch.full((self.people,), map_id), identity_pose(self.people)
            room = bank.signed_distance(torch.from_numpy(places).float().unsqueeze(1), maps, pose)
            for number in (room.flatten() < 0).nonzero().flatten().tolist():
                raise UserError(
                    f"person {number + 1}: {end}: {format_point(places[number])} is inside a wall of map "
                    f"{self.map!r} or outside it: expected free floor"
                )

    def _check_ways(self, planner: Planner, distance: Tensor) -> None:
        """Raise the error for people without a way to their goal."""
        for number, way in enumerate(distance.tolist()):
            if not math.isfinite(way):
                raise UserError(
                    f"person {number + 1}: no way from {format_point(self._starts[number])} to "
                    f"{format_point(self._ends[number])} on map {self.map!r} with {planner.clearance} m "
                    "clearance: move one of them, or set a smaller clearance"
                )

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people where they start, on their way already."""
        device, scenes = draws.key.device, len(draws.key)
        map_id = torch.full((scenes,), prepared.tables.map_id, device=device)
        start, ahead, goal = (table.to(device).expand(scenes, *table.shape) for table in prepared.tables[1:])
        mask = torch.ones_like(goal, dtype=torch.bool)
        speed = self.speeds(draws)
        seconds = STEP_SECONDS * torch.arange(1 - OBS_LEN, 1, device=device)
        history = start.unsqueeze(2) + (speed.unsqueeze(2) * seconds).unsqueeze(3) * ahead.unsqueeze(2)
        slot = torch.arange(self.people, device=device).expand(scenes, -1)
        opening = SceneStarts(torch.zeros_like(map_id), slot, mask, torch.full_like(goal, PAST_LEN))
        return Layout(map_id, start, mask, speed, goal, history=history, opening=opening)

    def speeds(self, draws: Draws) -> Tensor:
        """Return the preferred speeds (B, A), m/s."""
        deviation = draws.normal("speed", self.people).clamp(-3, 3) * self.speed_std
        return (self._means.to(deviation) + deviation).clamp_min(SLOWEST)


class _Starts(NamedTuple):
    """Where the P people begin.

    Attributes:
        map_id: Floor plan, -1 for none.
        start: Their starts (P, 2), metres.
        ahead: The direction (P, 2) in which they come there; 0 for people who stand.
        goal: The planner's numbers of their goals (P,) long.
    """

    map_id: int
    start: Tensor
    ahead: Tensor
    goal: Tensor


def _place(where: str, one: dict[str, Any], end: str) -> list[float]:
    """Return a position that a person has under the key ``end``."""
    place = one.get(end)
    if not isinstance(place, list | tuple) or len(place) != 2 or not all(map(_is_number, place)):
        given = f"{end}: {place!r:.60}" if end in one else f"no {end}"
        raise UserError(f"{where}: {given}: {EXPECTED}")
    return [float(value) for value in place]


def _speed(where: str, speed: Any) -> float:
    """Return the mean speed of a person."""
    if not _is_number(speed) or speed < SLOWEST:
        raise UserError(f"{where}: speed {speed!r:.60}: expected at least {SLOWEST} m/s")
    return float(speed)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _check_apart(starts: Tensor) -> None:
    """Raise the error for people who begin in one place."""
    apart = torch.pdist(starts)
    if len(apart) and float(apart.min()) < 2 * BODY_RADIUS:
        first, second = torch.triu_indices(len(starts), len(starts), 1)[:, apart.argmin()].tolist()
        raise UserError(
            f"persons {first + 1} and {second + 1} start {float(apart.min()):.2f} m apart: expected at least "
            f"{2 * BODY_RADIUS} m"
        )
