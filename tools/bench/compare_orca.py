"""Compares pedzoo's ORCA with RVO2 (pyrvo), one step at a time from the same states.

    python tools/bench/compare_orca.py [--steps 12000] [--map ../shared/maps/igibson_rs.yaml]

All walk to random places, replaced at arrival and at times; after each step they are where RVO2 put them.
Both sides compute in float32 with the same parameters and the same wall polygons. RVO2 splits walls
while it builds its search tree, which is not always neutral; "on RVO2's pieces" is pedzoo on its own pieces.
The other differences of 1e-3 m/s and more are ties: of segments as near as each other, or of people who are
so blocked that the order of lines matters.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from pyrvo.pyrvo import RVOSimulator
from rich.console import Console
from rich.table import Table
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import FASTEST, MapBank
from pedzoo.maps.formats import read_plan
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.segments import Segments, SegmentTable, edges
from pedzoo.policies.rule_based.orca import OrcaSettings, orca_velocity

SPEED, TOP_SPEED = 1.3, 1.69
SETTINGS = OrcaSettings(dt=0.1, max_obstacles=1000)
APART = 1e-3
FARTHEST = 2 * FASTEST


def plan(side: int, boxes: int, seed: int) -> OccupancyGrid:
    """Return a square room of ``side`` cells of 0.1 m with boxes in it."""
    cells, random = np.zeros((side, side), dtype=np.uint8), np.random.default_rng(seed)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    for _ in range(boxes):
        (x, y), (width, height) = random.integers(2, side - 12, 2), random.integers(1, 15, 2)
        cells[y : y + height, x : x + width] = OCCUPIED
    return OccupancyGrid(cells, 0.1, name=f"plan {side} {boxes} {seed}")


def pieces(segments: NDArray[np.float64]) -> SegmentTable:
    """Return the table of segments (S, 18); of equally near ones the first counts first."""
    table = SegmentTable.build([segments], FARTHEST, SETTINGS.max_obstacles)
    return table.to(torch.device("cpu"), torch.float32)


class Rvo2:
    """One RVO2 simulator per scene, asked for one step from given states; ``edges`` are its own walls."""

    def __init__(self, scenes: int, agents: int, polygons: Sequence[NDArray[np.float64]]) -> None:
        """Set up the simulators with the same walls in all of them, polygons (V, 2)."""
        most = 10_000 if SETTINGS.max_neighbors is None else SETTINGS.max_neighbors
        values = (SETTINGS.dt, SETTINGS.neighbor_dist, most, SETTINGS.time_horizon)
        self.simulators = []
        for _ in range(scenes):
            one = RVOSimulator(*values, SETTINGS.time_horizon_obst, SETTINGS.radius, TOP_SPEED)
            for _ in range(agents):
                one.add_agent((0.0, 0.0))
            for polygon in polygons:
                one.add_obstacle([(float(x), float(y)) for x, y in polygon])
            one.process_obstacles()
            self.simulators.append(one)
        self.edges = _split_walls(self.simulators[0])

    def prepare(self, position: Tensor, velocity: Tensor, preferred: Tensor) -> None:
        """Put every person where they are, all (B, A, 2)."""
        values = (part.tolist() for part in (position, velocity, preferred))
        for one, *scene in zip(self.simulators, *values, strict=True):
            for agent, (place, current, wish) in enumerate(zip(*scene, strict=True)):
                one.set_agent_position(agent, place)
                one.set_agent_velocity(agent, current)
                one.set_agent_pref_velocity(agent, wish)

    def step(self) -> None:
        """Let every person choose a velocity and walk."""
        for one in self.simulators:
            one.do_step()

    def velocity(self) -> Tensor:
        """Return the velocities (B, A, 2) that were chosen."""
        count = range(self.simulators[0].get_num_agents())
        found = ([one.get_agent_velocity(agent) for agent in count] for one in self.simulators)
        return torch.tensor([[(v.x, v.y) for v in scene] for scene in found])


def _split_walls(simulator: RVOSimulator) -> NDArray[np.float64]:
    """Return RVO2's own segments: it splits some at the lines of others while it builds its search tree."""
    count = range(simulator.get_num_obstacle_vertices())
    corners = [simulator.get_obstacle_vertex(i) for i in count]
    start = np.array([(corner.x, corner.y) for corner in corners]).reshape(-1, 2)
    following = np.array([simulator.get_next_obstacle_vertex(i) for i in count], dtype=int)
    previous = np.array([simulator.get_prev_obstacle_vertex(i) for i in count], dtype=int)
    # where it splits an edge, RVO2 counts the new corner as convex
    return edges(start, -1e-4, following, previous)


@dataclass(frozen=True)
class State:
    """Where people are, how they walk and want to walk, all (B, A, 2)."""

    position: Tensor
    velocity: Tensor
    preferred: Tensor

    def ours(self, walls: SegmentTable | None, settings: OrcaSettings = SETTINGS) -> Tensor:
        """Return pedzoo's velocities (B, A, 2)."""
        speed = torch.full(self.position.shape[:2], TOP_SPEED)
        present = torch.ones_like(speed, dtype=torch.bool)
        near = None if walls is None else self.near(walls)
        return orca_velocity(self.position, self.velocity, self.preferred, speed, present, settings, near)

    def near(self, walls: SegmentTable) -> Segments:
        """Return the segments near every person."""
        points = self.position.flatten(0, 1)
        reach = SETTINGS.wall_reach(torch.full((len(points),), TOP_SPEED))
        return walls.near(points, torch.zeros(len(points)).long(), identity_pose(len(points)), reach)


class Walk:
    """Scenes of people who walk to random places, moved by RVO2."""

    def __init__(self, grid: OccupancyGrid, walled: bool, scenes: int, agents: int, seed: int) -> None:
        """Place them on free cells."""
        bank = MapBank([grid], unknown="wall")
        self.walls = bank.walls.segments(FARTHEST, SETTINGS.max_obstacles) if walled else None
        polygons = bank.walls.polygons()[0] if walled else []
        self.peer = Rvo2(scenes, agents, polygons)
        self.pieces = pieces(self.peer.edges) if walled else None
        clear = np.argwhere(grid.signed_distance("wall") > SETTINGS.radius)
        affine = grid.map_to_cell()
        centres = (clear[:, ::-1] - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T
        self.free = torch.as_tensor(centres, dtype=torch.float32)
        self.random = torch.Generator().manual_seed(seed)
        self.place, self.goal = self.draw(scenes, agents), self.draw(scenes, agents)
        self.velocity = torch.zeros_like(self.place)

    def draw(self, *shape: int) -> Tensor:
        """Return free places (*shape, 2)."""
        return self.free[torch.randint(len(self.free), shape, generator=self.random)]

    def step(self) -> tuple[State, Tensor]:
        """Return the state and RVO2's velocities (B, A, 2), and go on."""
        way = self.goal - self.place
        distance = way.norm(dim=-1, keepdim=True)
        state = State(self.place, self.velocity, SPEED * way / distance.clamp_min(1e-6))
        self.peer.prepare(state.position, state.velocity, state.preferred)
        self.peer.step()
        self.velocity = self.peer.velocity()
        self.place = self.place + SETTINGS.dt * self.velocity
        tired = torch.rand(distance.shape, generator=self.random) < 0.02
        self.goal = torch.where((distance < 0.3) | tired, self.draw(*self.place.shape[:2]), self.goal)
        return state, self.velocity


def agreement(name: str, plans: list[OccupancyGrid], walled: bool, agents: int, steps: int) -> list[str]:
    """Compare at least so many steps of people; returns a row of the table."""
    apart, on_pieces, capped = [], [], []
    rounds = 40
    for seed, grid in enumerate(plans):
        scenes = -(-steps // (len(plans) * rounds * agents))
        walk = Walk(grid, walled, scenes, agents, seed)
        for _ in range(rounds):
            state, theirs = walk.step()
            result = (state.ours(walk.walls) - theirs).norm(dim=-1)
            apart.append(result.flatten())
            if walk.walls:
                on_pieces.append((state.ours(walk.pieces) - theirs).norm(dim=-1).flatten())
                few = state.ours(walk.walls, replace(SETTINGS, max_obstacles=OrcaSettings().max_obstacles))
                capped.append((few - state.ours(walk.walls)).norm(dim=-1).flatten())
    all_apart = torch.cat(apart)

    def share(parts: list[Tensor]) -> str:
        return f"{100 * float((torch.cat(parts) < APART).double().mean()):.3f}" if parts else ""

    ends = (all_apart.median(), all_apart.double().quantile(0.999), all_apart.max())
    values = [f"{float(end):.1e}" for end in ends]
    return [name, str(len(all_apart)), *values, share(apart), share(on_pieces), share(capped)]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=12_000, help="steps of people per row")
    parser.add_argument("--map", action="append", default=[], help="a floor plan for two more rows")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    head = ("scenes", "n", "median", "99.9 %", "most", "% < 1e-3", "on RVO2's pieces")
    table = Table(*head, "16 walls", title="difference to RVO2, m/s")
    cases = [
        ("no walls, sparse", [plan(120, 0, seed) for seed in range(6)], False, 5),
        ("no walls, dense", [plan(50, 0, seed) for seed in range(6)], False, 20),
        ("walls, sparse", [plan(120, 14, seed) for seed in range(6)], True, 5),
        ("walls, dense", [plan(80, 8, seed) for seed in range(6)], True, 20),
    ]
    for path in options.map:
        grid = read_plan(path)
        cases += [(f"{grid.name}, {agents} people", [grid], True, agents) for agents in (5, 20)]
    for case in cases:
        table.add_row(*agreement(*case, options.steps))
    Console(width=150).print(table)


if __name__ == "__main__":
    main()
