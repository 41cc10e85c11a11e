"""Compares pedzoo's ORCA with RVO2 (pyrvo), one step at a time from the same states.

    python tools/bench/compare_orca.py [--steps 12000] [--map ../shared/maps/igibson_rs.yaml]

All walk to random places, replaced at arrival and at times; after each step they are where RVO2 put them.
 Both sides compute in float32 with the same parameters and the same wall polygons. RVO2 splits walls
while it builds its search tree, which is not always neutral; "on RVO2's pieces" is pedzoo on its own pieces.
What is 1e-3 m/s and more apart is counted in the first of these classes that it falls into:

* split: on RVO2's pieces pedzoo agrees with it;
* tie: it agrees for another order of segments at the same distance, such as two that meet at a corner;
* edge: the answer jumps, and a change of the state by less than 1e-4 gives the other one's answer;
* blocked: no velocity obeys all walls, so that the answer depends on the order of lines;
* other.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import FASTEST, MapBank
from pedzoo.maps.formats import read_plan
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.segments import Segments, SegmentTable, edges
from pedzoo.policies.rule_based.orca import OrcaSettings, orca_velocity, solve, wall_lines
from tools.bench.rvo2_peer import Rvo2

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

    def nudged(self, scene: int, copies: int, by: float) -> State:
        """Return many copies of one scene, each a little different."""
        parts = (
            part[scene].expand(copies, -1, -1) for part in (self.position, self.velocity, self.preferred)
        )
        return State(*(part + by * (2 * torch.rand_like(part) - 1) for part in parts))


class Walk:
    """Scenes of people who walk to random places, moved by RVO2."""

    def __init__(self, grid: OccupancyGrid, walled: bool, scenes: int, agents: int, seed: int) -> None:
        """Place them on free cells."""
        bank = MapBank([grid], unknown="wall")
        self.walls = bank.walls.segments(FARTHEST, SETTINGS.max_obstacles) if walled else None
        polygons = bank.walls.polygons()[0] if walled else []
        self.peer = Rvo2(scenes, agents, TOP_SPEED, SETTINGS, polygons)
        self.polygons = polygons
        self.pieces = pieces(self.peer.edges) if walled else None
        clear = np.argwhere(grid.signed_distance("wall") > SETTINGS.radius)
        self.free = torch.as_tensor(_centres(grid, clear), dtype=torch.float32)
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


def _centres(grid: OccupancyGrid, cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the centres (F, 2) of cells (row, column) in the map's frame."""
    affine = grid.map_to_cell()
    return (cells[:, ::-1] - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T


def classify(state: State, walk: Walk, scene: int, agent: int, theirs: Tensor) -> str:
    """Return the class of a person of whom both sides think differently."""

    def close(velocity: Tensor, to: Tensor, margin: float = APART) -> bool:
        return bool(((velocity[..., agent, :] - to).norm(dim=-1) < margin).any())

    one = state.nudged(scene, 1, 0.0)
    mine = one.ours(walk.walls)[0, agent]
    if walk.walls and walk.pieces:
        if close(one.ours(walk.pieces), theirs):
            return "split"
        own = np.concatenate([np.zeros((0, 18)), *map(edges, walk.polygons)])
        for segments in (walk.peer.edges, own):
            for seed in range(16):
                order = np.random.default_rng(seed).permutation(len(segments))
                if close(one.ours(pieces(segments[order])), theirs):
                    return "tie"
    peer = Rvo2(1, one.position.shape[1], TOP_SPEED, SETTINGS, walk.polygons)
    for by in (1e-6, 1e-5, 1e-4):
        copies = state.nudged(scene, 64, by)
        if close(copies.ours(walk.walls), theirs, APART + 10 * by):
            return "edge"
        for copy in range(64):
            peer.prepare(*(part[copy : copy + 1] for part in vars(copies).values()))
            peer.step()
            if close(peer.velocity(), mine, APART + 10 * by):
                return "edge"
    return "blocked" if walk.pieces and blocked(one, walk.pieces)[0, agent] else "other"


def blocked(state: State, walls: SegmentTable) -> Tensor:
    """Return who has no velocity (B, A) that obeys all walls."""
    velocity, preferred = (part.flatten(0, 1).T for part in (state.velocity, state.preferred))
    lines = wall_lines(
        state.near(walls), velocity, velocity.new_full(velocity.shape[1:], SETTINGS.radius), SETTINGS
    )
    chosen = solve(lines, 0, preferred, torch.full(velocity.shape[1:], TOP_SPEED))
    beside = (lines[1] - chosen[1]) * lines[2] - (lines[0] - chosen[0]) * lines[3]
    return (beside > 1e-5).any(0).view(state.position.shape[:2])


def agreement(name: str, plans: list[OccupancyGrid], walled: bool, agents: int, steps: int) -> list[str]:
    """Compare at least so many steps of people; returns a row of the table."""
    apart, on_pieces, capped, classes = [], [], [], Counter()
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
            for scene, agent in (result >= APART).nonzero().tolist():
                classes[classify(state, walk, scene, agent, theirs[scene, agent])] += 1
    all_apart = torch.cat(apart)

    def share(parts: list[Tensor]) -> str:
        return f"{100 * float((torch.cat(parts) < APART).double().mean()):.3f}" if parts else ""

    rest = ", ".join(f"{count} {kind}" for kind, count in classes.most_common())
    return [
        name,
        str(len(all_apart)),
        f"{float(all_apart.median()):.1e}",
        f"{float(all_apart.double().quantile(0.999)):.1e}",
        f"{float(all_apart.max()):.1e}",
        share(apart),
        share(on_pieces),
        rest,
        share(capped),
    ]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=12_000, help="steps of people per row")
    parser.add_argument("--map", action="append", default=[], help="a floor plan for two more rows")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    head = ("scenes", "n", "median", "99.9 %", "most", "% < 1e-3", "on RVO2's pieces", "the rest")
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
