"""People with starts and goals of your own, written one by one; ``mine.yaml`` has the settings of this."""

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.geometry import identity_pose
from pedzoo.core.randomness import Draws
from pedzoo.core.types import BODY_RADIUS, OBS_LEN, STEP_SECONDS
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.planning.graph import format_point
from pedzoo.maps.planning.planner import Planner
from pedzoo.maps.plans import load_plan
from pedzoo.sim.scenario import SLOWEST, WARM_SECONDS, Layout, PreparedScenario, Scenario

SWAP = [{"from": [-3.0, 0.0], "to": [3.0, 0.0]}, {"from": [3.0, 0.0], "to": [-3.0, 0.0]}]
"""Two people who change places."""

KEYS = ("from", "to", "speed")
"""What may stand of a person."""


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
        """
        super().__init__(len(people), speed, speed_std)
        self.map = map
        for number, one in enumerate(people, 1):
            if wrong := [key for key in one if key not in KEYS]:
                raise unknown(f"key of person {number}", str(wrong[0]), KEYS)
        self._starts, self._ends = (
            np.array([_place(number, one, end) for number, one in enumerate(people, 1)]) for end in KEYS[:2]
        )
        means = [one.get("speed", speed) for one in people]
        for number, mean in enumerate(means, 1):
            if not _is_number(mean) or mean < SLOWEST:
                raise UserError(f"person {number}: speed {mean!r:.60}: expected at least {SLOWEST} m/s")
        self._means = torch.tensor(means, dtype=torch.float32)

    @property
    def fastest(self) -> float:
        """The largest preferred speed that can be drawn, m/s."""
        return float(self._means.max()) + 3 * self.speed_std

    def plans(self) -> list[OccupancyGrid]:
        """Return the floor plan, or none."""
        return [] if self.map is None else [load_plan(self.map)]

    def prepare(self, clearance: float, planner: str = Planner.name) -> PreparedScenario:
        """Find the ways from starts to goals; tables: floor plans, starts, directions (0: stands), goals.

        Warns of places that are nearer to a wall than ``clearance``: they are moved, and goals count there.

        Raises:
            UserError: A place is in a wall or outside the map, two people overlap, or there is no way.
        """
        prepared = super().prepare(clearance, planner)
        bank, paths, pose = prepared.bank, prepared.planner, identity_pose(self.people)
        row, map_id = (0, bank.grids[0].map_id) if bank.grids else (-1, -1)
        maps, starts = torch.full((self.people,), map_id), self._starts
        for end, places in zip(KEYS, (self._starts, self._ends), strict=False) if bank.grids else ():
            graph = paths.graph(row)
            room = bank.signed_distance(torch.from_numpy(places).float().unsqueeze(1), maps, pose)
            for number in (room.flatten() < 0).nonzero().flatten().tolist():
                raise UserError(
                    f"person {number + 1}: {end}: {format_point(places[number])} is inside a wall of map "
                    f"{self.map!r} or outside it: expected free floor"
                )
            _, settled = graph.settle(places, paths.snap, "the start" if end == "from" else "goal")
            starts = settled if end == "from" else starts
            for number in range(self.people):
                if text := graph.moved(f"person {number + 1}: {end}:", places[number], settled[number]):
                    warnings.warn(text, stacklevel=2)
        goal = paths.add_goals(row, self._ends)
        apart = torch.pdist(torch.from_numpy(starts))
        if len(apart) and float(apart.min()) < 2 * BODY_RADIUS:
            first, second = torch.triu_indices(self.people, self.people, 1)[:, apart.argmin()].tolist()
            raise UserError(
                f"persons {first + 1} and {second + 1} start {float(apart.min()):.2f} m apart: expected at "
                f"least {2 * BODY_RADIUS} m"
            )
        start = torch.from_numpy(starts).float()
        ways = paths.next_waypoints(start, goal, maps, pose)
        for number, way in enumerate(ways.distance.tolist()):
            if not math.isfinite(way):
                raise UserError(
                    f"person {number + 1}: no way from {format_point(self._starts[number])} to "
                    f"{format_point(self._ends[number])} on map {self.map!r} with {clearance} m "
                    "clearance: move one of them, or set a smaller clearance"
                )
        ahead = torch.nn.functional.normalize(ways.waypoint - start, dim=1)
        # back to where the fastest would be at the first observed step
        steps = torch.linspace(0, WARM_SECONDS * self.fastest, 32)
        behind = start.unsqueeze(1) - steps[:, None] * ahead.unsqueeze(1)
        if row >= 0:
            ahead = ahead * (bank.signed_distance(behind, maps, pose).amin(1) > BODY_RADIUS).unsqueeze(1)
        return replace(prepared, tables=(maps, start, ahead, goal))

    def layout(self, prepared: PreparedScenario, draws: Draws) -> Layout:
        """Return people where they start, on their way already."""
        device, scenes = draws.key.device, len(draws.key)
        maps, start, ahead, goal = (
            table.to(device).expand(scenes, *table.shape) for table in prepared.tables
        )
        speed = self.speeds(draws)
        seconds = STEP_SECONDS * torch.arange(1 - OBS_LEN, 1, device=device)
        return Layout(
            maps[:, 0],
            start,
            torch.ones_like(goal, dtype=torch.bool),
            speed,
            goal,
            history=start.unsqueeze(2) + (speed.unsqueeze(2) * seconds).unsqueeze(3) * ahead.unsqueeze(2),
            person=torch.arange(self.people, device=device).expand(scenes, -1),
        )

    def speeds(self, draws: Draws) -> Tensor:
        """Return the preferred speeds (B, A), m/s."""
        deviation = draws.normal("speed", self.people).clamp(-3, 3) * self.speed_std
        return (self._means.to(deviation) + deviation).clamp_min(SLOWEST)


def _place(number: int, one: dict[str, Any], end: str) -> list[float]:
    """Return the position that a person has under the key ``end``."""
    place = one.get(end)
    if not isinstance(place, list | tuple) or len(place) != 2 or not all(map(_is_number, place)):
        given = f"{end}: {place!r:.60}" if end in one else f"no {end}"
        expected = "{from: [x, y], to: [x, y]} in metres, and speed in m/s if it is their own"
        raise UserError(f"person {number}: {given}: expected {expected}")
    return [float(value) for value in place]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
