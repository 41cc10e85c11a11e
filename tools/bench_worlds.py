"""Times what the worlds answer per decision of 0.4 s (4 trace points of 4 sub-steps).

    python tools/bench_worlds.py [--map ../shared/maps/igibson_rs.yaml] [--json FILE]

One thread; medians over draws of people. They start at random free places at least 0.3 m from walls, and
walk at 1.3 m/s in random directions, along the walls that stop them: more of them touch walls than people do.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from pedzoo.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.free_space import free_points
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.dynamics import walk
from pedzoo.sim.worlds.base import People, World
from pedzoo.sim.worlds.bullet import BulletWorld
from pedzoo.sim.worlds.camera import Camera
from pedzoo.sim.worlds.grid import GridWorld

TRACE, STEPS, RAYS, SIZE = 4, 4, 128, (640, 480)


@dataclass(frozen=True)
class Timing:
    """Median milliseconds per decision of one world.

    Attributes:
        world: Its name.
        scenes: Asked about at once.
        people: Per scene.
        contacts: Of the trace.
        distances: At its end.
        rays: 128 per person.
        frame: One picture of 640 x 480 from the top.
        perspective: One obliquely from above; the grid has none.
    """

    world: str
    scenes: int
    people: int
    contacts: float
    distances: float
    rays: float
    frame: float
    perspective: float | None

    @property
    def step(self) -> float:
        """Contacts and distances: what an environment asks in every step."""
        return self.contacts + self.distances


def main() -> None:
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--map", default="../shared/maps/igibson_rs.yaml", help="a ROS map yaml")
    parser.add_argument("--times", type=int, default=11, help="scenes per number")
    parser.add_argument("--json", help="also write the table to this file")
    options = parser.parse_args()
    torch.set_num_threads(1)
    grid = OccupancyGrid.from_ros_yaml(Path(options.map))
    bank = MapBank([grid], "wall")
    free = torch.from_numpy(free_points(grid, "wall", 0.3)).float()

    rows, building = [], {}
    for name, world in (("grid", GridWorld(bank)), ("bullet", BulletWorld(bank))):
        one = draw(grid, free, 1, 1, seed=0)
        building[name] = seconds(lambda world=world, one=one: everything(world, one))
        for scenes, people in ((1, 5), (1, 20)) + (((64, 5), (1024, 5)) if name == "grid" else ()):
            crowds = [draw(grid, free, scenes, people, seed) for seed in range(options.times)]
            rows.append(measure(name, world, crowds))
        world.close()
    show(grid.name, rows, building)
    if options.json:
        table = {"map": grid.name, "first_use_s": building, "rows": [asdict(row) for row in rows]}
        Path(options.json).write_text(json.dumps(table, indent=1))


def draw(grid: OccupancyGrid, free: Tensor, scenes: int, people: int, seed: int) -> People:
    """Return people at random free places."""
    generator = torch.Generator().manual_seed(seed)
    places = free[torch.randint(len(free), (scenes, people), generator=generator)]
    mask = torch.ones(scenes, people, dtype=torch.bool)
    return People(places, mask, torch.full((scenes, 1), grid.map_id), identity_pose(scenes))


def walks(world: World, people: People) -> Tensor:
    """Return where they go in 0.4 s (B, A, S, M, 2)."""
    angle = torch.rand(people.mask.shape) * 2 * math.pi
    velocity = 1.3 * torch.stack((angle.cos(), angle.sin()), dim=-1)
    path = walk(people.position, velocity, 0.4, TRACE * STEPS, world.bank, people.map_id[:, 0], people.pose)
    return path.unflatten(2, (TRACE, STEPS))


def lidar(people: People) -> tuple[Tensor, Tensor]:
    """Return origins and directions (B, A * 128, 2) of a full turn around everybody."""
    angle = torch.arange(RAYS) * (2 * math.pi / RAYS)
    scenes, slots = people.mask.shape
    direction = torch.stack((angle.cos(), angle.sin()), dim=-1).repeat(slots, 1).expand(scenes, -1, -1)
    return people.position.repeat_interleave(RAYS, dim=1), direction


def everything(world: World, people: People) -> None:
    """Ask each question once: builds what the world builds at first use."""
    world.contacts(walks(world, people), people)
    world.distances(people)
    world.rays(people, *lidar(people))
    world.image(people, 0, SIZE)


def measure(name: str, world: World, crowds: list[People]) -> Timing:
    """Time each question over several crowds of the same size."""
    everything(world, crowds[0])

    def median(ask: Callable[[People], object]) -> float:
        return 1e3 * statistics.median(seconds(lambda people=people: ask(people)) for people in crowds)

    paths = iter([walks(world, people) for people in crowds])
    beams = iter([lidar(people) for people in crowds])
    oblique = Camera("perspective")
    return Timing(
        name,
        *crowds[0].mask.shape,
        contacts=median(lambda people: world.contacts(next(paths), people)),
        distances=median(world.distances),
        rays=median(lambda people: world.rays(people, *next(beams))),
        frame=median(lambda people: world.image(people, 0, SIZE)),
        perspective=median(lambda people: world.image(people, 0, SIZE, oblique))
        if name == "bullet"
        else None,
    )


def seconds(ask: Callable[[], object]) -> float:
    """Return how long one call takes."""
    start = time.perf_counter()
    ask()
    return time.perf_counter() - start


def show(plan: str, rows: list[Timing], building: dict[str, float]) -> None:
    """Print the table."""
    table = Table(title=f"ms per decision of 0.4 s ({TRACE} x {STEPS} sub-steps) on {plan}, one thread")
    columns = ("world", "scenes", "people", "contacts", "distances", "step")
    for column in (*columns, f"{RAYS} rays", "frame", "oblique", "step + rays + frame"):
        table.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        numbers = (row.contacts, row.distances, row.step, row.rays, row.frame, row.perspective)
        texts = ["-" if number is None else f"{number:.3g}" for number in numbers]
        total = f"{row.step + row.rays + row.frame:.3g}"
        table.add_row(row.world, str(row.scenes), str(row.people), *texts, total)
    Console(width=110).print(table)
    print("first use, everything built:", ", ".join(f"{name} {s:.2f} s" for name, s in building.items()))


if __name__ == "__main__":
    main()
