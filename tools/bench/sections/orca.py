"""ORCA alone: one step of every person from the same states, with walls and without, beside RVO2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, free_points
from pedzoo.maps.walls.segments import WallSegments
from pedzoo.policies.orca.settings import OrcaSettings
from pedzoo.policies.orca.velocity import orca_velocity
from tools.bench.figures import Measured, Row, Verdict
from tools.bench.peer import running
from tools.bench.scenes import LARGEST, Size, for_peers, plan, sizes
from tools.bench.section import Section
from tools.bench.turns import in_turns, ratio, repeated

SPEED, TOP_SPEED = 1.3, 1.69
SETTINGS = OrcaSettings(dt=0.1)
WARM = 20
"""Steps from the start to the states that are timed: people are on their ways then."""

SPACE = 6.0
"""Square metres per person, with and without boxes in the room; five people have 100."""

BARS = {"no walls": 3.0, "walls": 1.0}
"""How many times as fast as RVO2 from Python, at the largest size."""


class Orca(Section):
    """With walls, looking up the segments near every person counts as ours."""

    takes = 9, 75

    def rows(self) -> Iterator[Row]:
        """Measure every size, without walls and with a room full of boxes."""
        usual = (LARGEST, Size(64, 20), Size(64, 5), Size(1, 5), Size(1, 100), Size(1, 500))
        with running(self.settings) as peers:
            for size in sizes(self.settings, usual[2:4] if self.settings.quick else usual):
                for name in BARS:
                    crowd = _Crowd.walking(size, name == "walls")
                    rivals = [case for peer in peers for case in peer.cases([crowd.scenes()])]
                    ours = repeated(crowd.velocities, size.total, self.settings.clock)
                    speeds = in_turns(
                        {"pedzoo": ours} | {case.metric: case.side for case in rivals},
                        self.settings.turns,
                        self.settings.seconds,
                    )
                    metrics = {"agent_steps_per_s": Measured.of(speeds["pedzoo"])}
                    for case in rivals:
                        rival = case.metric.removeprefix("times_")
                        metrics[f"{rival}_per_s"] = Measured.of(speeds[case.metric])
                        metrics[case.metric] = ratio(speeds["pedzoo"], speeds[case.metric])
                    row = Row("orca", name, {"size": str(size)}, metrics)
                    yield replace(row, bars=self._bars(row, size))
            for peer in peers:
                self.versions |= peer.versions

    def _bars(self, row: Row, size: Size) -> list[Verdict]:
        """Return what is asked of a row, judged or not."""
        return [row.beside("times_pyrvo_from_python", BARS[row.name])] if size == LARGEST else []


class _Crowd(NamedTuple):
    """People who walk, all (B, A, 2), and the walls if there are any."""

    position: Tensor
    velocity: Tensor
    preferred: Tensor
    bank: MapBank
    walls: WallSegments | None

    @classmethod
    def walking(cls, size: Size, walled: bool) -> _Crowd:
        """Return people who have walked from random places towards others for two seconds."""
        side = max(100, round(10 * (SPACE * size.people) ** 0.5))
        grid = plan(side, side * side // 1000 if walled else 0, seed=0)
        random = torch.Generator().manual_seed(0)
        start, goal = (_draw(grid, size, random) for _ in range(2))
        bank = MapBank([grid], unknown="wall")
        crowd = cls(start, torch.zeros_like(start), start, bank, WallSegments(bank) if walled else None)
        for _ in range(WARM):
            way = goal - crowd.position
            wanted = SPEED * way / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)
            crowd = crowd._replace(preferred=wanted)
            velocity = crowd.velocities()
            crowd = crowd._replace(position=crowd.position + SETTINGS.dt * velocity, velocity=velocity)
        return crowd

    @torch.no_grad()
    def velocities(self) -> Tensor:
        """Return what all choose (B, A, 2), m/s."""
        speed = torch.full(self.position.shape[:2], TOP_SPEED)
        near = None
        if self.walls is not None:
            points = self.position.flatten(0, 1)
            ids = torch.full((len(points),), self.bank.grids[0].map_id)
            reach = float(SETTINGS.wall_reach(torch.tensor(TOP_SPEED)))
            near = self.walls.near(points, ids, identity_pose(len(points)), reach)
        mask = torch.ones_like(speed, dtype=torch.bool)
        return orca_velocity(self.position, self.velocity, self.preferred, speed, mask, SETTINGS, near)

    def scenes(self):
        """Return them in the form that peers read."""
        speed = torch.full(self.position.shape[:2], TOP_SPEED)
        size = Size(*self.position.shape[:2])
        state = self.position, self.velocity, self.preferred, speed
        return for_peers("orca", size, SETTINGS, self.walls, *state)


def _draw(grid: OccupancyGrid, size: Size, random: torch.Generator) -> Tensor:
    """Return free places (B, A, 2)."""
    free = torch.from_numpy(free_points(grid, "wall", SETTINGS.radius)).float()
    return free[torch.randint(len(free), tuple(size), generator=random)]
