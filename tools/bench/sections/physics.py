"""The physics backends: milliseconds per decision of contacts, distances, rays, pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.core.registry import PHYSICS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid, free_points
from pedzoo.sim.dynamics import integrate
from pedzoo.sim.make import physics_class
from pedzoo.sim.physics.torch import Torch
from pedzoo.sim.physics_parts import base
from pedzoo.sim.physics_parts.bodies import Bodies
from pedzoo.sim.physics_parts.camera import Camera
from pedzoo.sim.scenarios.goals import Goals
from tools.bench.figures import Measured, Row
from tools.bench.scenes import LARGEST, Size
from tools.bench.section import Section
from tools.bench.turns import seconds_of

TRACE, STEPS, RAYS, PICTURE = 4, 4, 128, (640, 480)
SIZES = (Size(1, 5), Size(1, 20), Size(64, 5), LARGEST)
SPEED = 1.3


class Physics(Section):
    """People start at random free places at least 0.3 m from walls and walk at 1.3 m/s in random directions.

    They walk along the walls that stop them: more of them touch walls than people do. Each agent has 128 rays
    around it; the picture from the top and the oblique one have 640 x 480 pixels.
    """

    takes = 5, 10

    def rows(self) -> Iterator[Row]:
        """Measure backends in torch at every size, others with one scene; absent ones have no rows."""
        (grid,) = Goals(self.settings.maps[0] if self.settings.maps else "flat").plans()
        bank = MapBank([grid], "wall")
        free = torch.from_numpy(free_points(grid, "wall", 0.3)).float()
        for name in PHYSICS.names():
            kind = physics_class(name)
            try:
                kind.check()
            except UserError:  # it needs what is not installed
                continue
            for size in SIZES[:2] if self.settings.quick or not issubclass(kind, Torch) else SIZES:
                crowds = [draw(grid, free, size, seed) for seed in range(self.settings.turns)]
                where = {"size": str(size), "map": grid.name}
                yield Row("physics", name, where, self._measure(kind(bank), crowds))

    def _measure(self, physics: base.Physics, crowds: list[Bodies]) -> dict[str, Measured]:
        """Time each question over several crowds of the same size."""
        now = self.settings.clock
        first = seconds_of(lambda: everything(physics, crowds[0]), now)
        paths = iter([walks(physics, people) for people in crowds])
        beams = iter([lidar(people) for people in crowds])
        questions: dict[str, Callable[[Bodies], object]] = {
            "contacts": lambda people: physics.contacts(next(paths), people),
            "distances": physics.distances,
            "rays": lambda people: physics.rays(people, *next(beams)),
            "picture": lambda people: physics.image(people, 0, PICTURE),
        }
        if "perspective" in physics.views:
            questions["oblique"] = lambda people: physics.image(people, 0, PICTURE, Camera("perspective"))
        result = {}
        for what, ask in questions.items():
            taken = [seconds_of(lambda ask=ask, one=one: ask(one), now) for one in crowds]
            result[f"{what}_ms"] = Measured.of([1e3 * second for second in taken])
        physics.close()
        return result | {"first_use_s": Measured.of([first])}


def draw(grid: OccupancyGrid, free: Tensor, size: Size, seed: int) -> Bodies:
    """Return people at random free places."""
    generator = torch.Generator().manual_seed(seed)
    places = free[torch.randint(len(free), tuple(size), generator=generator)]
    mask = torch.ones(tuple(size), dtype=torch.bool)
    return Bodies(places, mask, torch.full((size.scenes, 1), grid.map_id), identity_pose(size.scenes))


def walks(physics: base.Physics, people: Bodies) -> Tensor:
    """Return where they go in a decision (B, A, S, M, 2)."""
    angle = torch.rand(people.mask.shape, generator=torch.Generator().manual_seed(0)) * 2 * math.pi
    velocity = SPEED * torch.stack((angle.cos(), angle.sin()), dim=-1)
    row = physics.bank.index(people.map_id[:, 0])
    walls = physics.bank.walls_of_state(*physics.bank.walls_of_scenes(row, people.pose))
    radius = torch.full(people.mask.shape, physics.body_radius)
    wanted = velocity.movedim(-1, 0).unsqueeze(1).expand(-1, TRACE, -1, -1)
    path = integrate(people.position.movedim(-1, 0), wanted, radius, STEPS, walls)
    return path.permute(2, 3, 1, 0).unflatten(2, (TRACE, STEPS))


def lidar(people: Bodies) -> tuple[Tensor, Tensor]:
    """Return origins and directions (B, A * 128, 2) of a full turn around every agent."""
    angle = torch.arange(RAYS) * (2 * math.pi / RAYS)
    scenes, slots = people.mask.shape
    direction = torch.stack((angle.cos(), angle.sin()), dim=-1).repeat(slots, 1).expand(scenes, -1, -1)
    return people.position.repeat_interleave(RAYS, dim=1), direction


def everything(physics: base.Physics, people: Bodies) -> None:
    """Ask each question once: builds what the physics builds at first use."""
    physics.contacts(walks(physics, people), people)
    physics.distances(people)
    physics.rays(people, *lidar(people))
    physics.image(people, 0, PICTURE)
