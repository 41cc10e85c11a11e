"""What both worlds answer: against formulas, against one another, and when something is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.errors import UserError
from pedzoo.geometry import identity_pose, move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.worlds.base import People, World
from pedzoo.sim.worlds.camera import FLOOR, WALL, Camera, person_color
from pedzoo.sim.worlds.grid import GridWorld

RADIUS = 0.15


def hall(name: str = "hall", **options: object) -> OccupancyGrid:
    """6 x 4 m behind 0.2 m walls: a wall with a door 1 m wide at x = 3, and a pillar of 0.4 m around (1.6, 1)."""
    cells = np.zeros((44, 64), dtype=np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[2:17, 31:33], cells[27:42, 31:33] = 1, 1
    cells[10:14, 16:20] = 1
    return OccupancyGrid(cells, 0.1, name=name, **options)  # type: ignore[arg-type]


def crowd(
    position: Tensor,
    grid: OccupancyGrid | None = None,
    mask: Tensor | None = None,
    pose: Tensor | None = None,
) -> People:
    """People at scene positions (B, A, 2), all scenes on one floor plan."""
    scenes = len(position)
    mask = torch.ones(position.shape[:2], dtype=torch.bool) if mask is None else mask
    map_id = torch.full((scenes, 1), grid.map_id if grid else -1)
    return People(position, mask, map_id, identity_pose(scenes) if pose is None else pose)


def walks(start: Tensor, seed: int, speed: float = 1.3, trace: int = 4, steps: int = 4) -> Tensor:
    """Straight paths (B, A, S, M, 2) of 0.4 s in random directions."""
    generator = torch.Generator().manual_seed(seed)
    angle = torch.rand(start.shape[:2], generator=generator) * 2 * math.pi
    move = speed * 0.4 * torch.stack((angle.cos(), angle.sin()), dim=-1)
    time = torch.arange(1, trace * steps + 1).view(1, 1, trace, steps, 1) / (trace * steps)
    return start[:, :, None, None] + move[:, :, None, None] * time


def plain_contacts(bank: MapBank, path: Tensor, people: People) -> tuple[Tensor, Tensor]:
    """The definition, without any shortcut."""
    apart = (path.unsqueeze(2) - path.unsqueeze(1)).norm(dim=-1)  # (B, A, A, S, M)
    both = people.mask.unsqueeze(1) & people.mask.unsqueeze(2)
    both &= ~torch.eye(path.shape[1], dtype=torch.bool)
    agent = ((apart < 2 * RADIUS).any(-1) & both.unsqueeze(-1)).any(2)
    wall, _ = bank.closest_wall(path, people.map_id[:, 0], people.pose)
    return agent, (wall < RADIUS).any(-1) & people.mask.unsqueeze(-1)


@pytest.mark.parametrize(("scenes", "people"), [(40, 5), (1, 150), (3, 1), (2, 0)])
def test_bounds_change_no_contact(scenes: int, people: int) -> None:
    generator = torch.Generator().manual_seed(0)
    grid = hall(origin=(1.0, -2.0, 0.4))
    bank = MapBank([grid, hall("other")], "wall")
    # also outside the map, and on the walls themselves
    pose = torch.tensor([[0.3, -1.0, 2.0, 1.0]]).repeat(scenes, 1)
    position = torch.rand(scenes, people, 2, generator=generator) * 8 - 1
    position = move_to_scene(position + torch.tensor([1.0, -2.0]), pose)
    mask = torch.rand(scenes, people, generator=generator) < 0.8
    everybody = crowd(position, grid, mask, pose)
    path = walks(position, seed=1)
    found = GridWorld(bank).contacts(path, everybody)
    agent, wall = plain_contacts(bank, path, everybody)
    assert torch.equal(found.agent, agent)
    assert torch.equal(found.wall, wall)
    if people > 1:
        assert 0 < found.agent.float().mean() < 0.9
        assert 0 < found.wall.float().mean() < 0.9


def test_contacts_by_hand() -> None:
    grid = hall()
    for world in worlds(MapBank([grid], "wall")):
        # two walk towards one another and stop 0.29 m apart at the end of trace point 1; one stands 0.14 m from
        # the left wall's face at x = 0.2; the last one is absent, in the middle of everything
        start = torch.tensor([[[1.0, 3.0], [2.0, 3.0], [0.34, 2.0], [1.5, 3.0]]])
        path = start[:, :, None, None].repeat(1, 1, 3, 2, 1)
        path[0, 0, 0, :, 0] = torch.tensor([1.2, 1.3])
        path[0, 1, 0, :, 0] = torch.tensor([1.8, 1.61])
        path[0, 0, 1, :, 0] = torch.tensor([1.32, 1.3])
        path[0, 1, 1, :, 0] = torch.tensor([1.61, 1.7])
        path[0, 2, 2, :, 0] = torch.tensor([0.36, 0.36])
        people = crowd(start, grid, torch.tensor([[True, True, True, False]]))
        found = world.contacts(path, people)
        assert found.agent[0].tolist() == [[False, True, False]] * 2 + [[False] * 3] * 2
        assert found.wall[0].tolist() == [[False] * 3] * 2 + [[True, True, False], [False] * 3]


def test_distances_by_hand() -> None:
    grid = hall()
    for world in worlds(MapBank([grid], "wall")):
        people = crowd(
            torch.tensor([[[0.7, 3.0], [1.0, 3.4], [5.0, 2.0], [5.1, 2.0]]]),
            grid,
            torch.tensor([[True, True, True, False]]),
        )
        found = world.distances(people, reach=1.5)
        assert found.agent[0].tolist() == pytest.approx([0.5, 0.5, 1.5, 1.5], abs=1e-5)
        assert found.wall[0].tolist() == pytest.approx([0.5, 0.8, 1.2, 1.5], abs=1e-5)
        assert found.agent_normal[0].flatten().tolist() == pytest.approx([-0.6, -0.8, 0.6, 0.8] + [0] * 4, abs=1e-5)
        # the third one stands as far from the corner of the door's wall as Pythagoras says
        assert found.wall_normal[0, 0].tolist() == pytest.approx([1, 0], abs=1e-5)
        assert found.wall_normal[0, 3].tolist() == [0, 0]


def worlds(bank: MapBank) -> list[World]:
    bullet = pytest.importorskip("pedzoo.sim.worlds.bullet")
    pytest.importorskip("pybullet")
    return [GridWorld(bank), bullet.BulletWorld(bank)]
