"""How people move: speed, walls, and none goes through them."""

import numpy as np
import pytest
import torch
from torch import Tensor

from pedzoo.core.geometry import direction_of, identity_pose, move_to_map, move_to_scene
from pedzoo.core.types import BODY_RADIUS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.maps.plans import rectangles, room, wall
from pedzoo.sim import dynamics
from pedzoo.sim.dynamics import SKIN, substeps

BANK = MapBank([rectangles(room((0, 0), (4, 3), 0.1) + wall((2.05, 0), (2.05, 3), 0.1), 0.05)], "wall")
"""Two rooms and no door: free for x from 0 to 2 and from 2.1 to 4, for y from 0 to 3."""

NEAREST = BODY_RADIUS - SKIN


def walk(
    position: Tensor,
    velocity: Tensor,
    seconds: float = 0.4,
    steps: int = 16,
    bank: MapBank = BANK,
    pose: Tensor | None = None,
) -> Tensor:
    """Return the paths (1, A, N, 2) of people on the first floor plan of a bank."""
    map_id = torch.tensor([bank.grids[0].map_id if bank.grids else -1])
    frame, place = bank.walls_of_scenes(bank.index(map_id), identity_pose(1) if pose is None else pose)
    ticks = round(seconds / 0.1)
    wanted = velocity.movedim(-1, 0).unsqueeze(1).expand(2, ticks, *velocity.shape[:2])
    radius, walls = torch.full(position.shape[:2], BODY_RADIUS), bank.walls_of_state(frame, place)
    path = dynamics.integrate(position.movedim(-1, 0), wanted, radius, steps // ticks, walls)
    return path.permute(2, 3, 1, 0)


def gaps(path: Tensor, bank: MapBank = BANK) -> Tensor:
    """Return the distances to walls (A, N) on paths (1, A, N, 2)."""
    map_id = torch.tensor([bank.grids[0].map_id])
    return bank.closest_wall(path.flatten(1, 2), map_id, identity_pose(1))[0].view(path.shape[1:3])


def moved(start: list[float], velocity: list[float], steps: int = 16) -> Tensor:
    """Return one person's path (N, 2)."""
    position, wanted = (torch.tensor([[values]]) for values in (start, velocity))
    return walk(position, wanted, steps=steps)[0, 0]


def anywhere(people: int, generator: torch.Generator) -> Tensor:
    """Return random places (1, A, 2) in the left room."""
    return torch.rand(1, people, 2, generator=generator) * torch.tensor([1.7, 2.7]) + 0.15


def test_free_walking_is_straight() -> None:
    path = moved([0.5, 1.5], [1.0, 0.5], steps=8)
    expected = torch.tensor([[0.6, 1.55], [0.7, 1.6], [0.8, 1.65], [0.9, 1.7]])
    assert torch.allclose(path[1::2], expected, atol=1e-6)
    path = walk(torch.zeros(1, 1, 2), torch.ones(1, 1, 2), steps=8, bank=MapBank())  # without a floor plan
    assert torch.allclose(path[0, 0, -1], torch.tensor([0.4, 0.4]))


@pytest.mark.parametrize(
    ("start", "velocity", "end", "off"),
    [
        ([1.5, 1.5], [2.0, 0.0], [2.0 - NEAREST, 1.5], 1e-5),  # a wall stops a head-on walk
        ([1.8, 1.0], [1.0, 1.0], [2.0 - NEAREST, 1.4], 1e-4),  # people slide along walls
        ([1.7, 2.7], [2.0, 2.0], [2.0 - NEAREST, 3.0 - NEAREST], 1e-3),  # an inner corner stops both ways
    ],
)
def test_walls_stop_people(start: list, velocity: list, end: list, off: float) -> None:
    path = moved(start, velocity)
    assert torch.allclose(path[-1], torch.tensor(end), atol=off)
    assert (path.max(0).values <= torch.tensor(end) + off).all()


@pytest.mark.parametrize(("thickness", "top"), [(0.1, 2.5), (0.01, 1.49), (0.01, 2.5), (0.05, 3.1)])
def test_no_person_tunnels_through_a_thin_wall(thickness: float, top: float) -> None:
    resolution = min(thickness, 0.05)
    walls = room((0, 0), (4, 3), resolution) + wall((2 + thickness / 2, 0), (2 + thickness / 2, 3), thickness)
    bank, generator = MapBank([rectangles(walls, resolution)], "wall"), torch.Generator().manual_seed(0)
    start = anywhere(1000, generator)
    for _ in range(10):
        velocity = top * direction_of(torch.rand(1, 1000, generator=generator) * 6.3)
        path = walk(start, velocity, steps=4 * substeps(top), bank=bank)
        assert float(path[..., 0].max()) < 2.0
        assert float(gaps(path, bank).min()) > NEAREST - 1e-3
        moves = torch.cat((start.unsqueeze(2), path), dim=2).diff(dim=2).norm(dim=-1)
        assert float(moves.max()) < BODY_RADIUS / 2 * 1.1
        start = path[:, :, -1]


@pytest.mark.parametrize("top", [1.3, 2.9])
def test_no_sub_step_is_deeper_in_a_wall_than_a_body_gives(top: float) -> None:
    """Among scattered pieces of wall, where people turn round corners and are pushed out of them."""
    cells = np.where(np.random.default_rng(0).random((60, 80)) < 0.015, OCCUPIED, 0).astype(np.uint8)
    bank, generator = MapBank([OccupancyGrid(cells, 0.05)], "free"), torch.Generator().manual_seed(0)
    start = torch.rand(1, 3000, 2, generator=generator) * torch.tensor([4.0, 3.0])
    for _ in range(4):
        begun = gaps(start.unsqueeze(2), bank)
        velocity = top * direction_of(torch.rand(1, 3000, generator=generator) * 6.3)
        path = walk(start, velocity, steps=4 * substeps(top), bank=bank)
        deeper = begun.clamp_max(NEAREST) - gaps(path, bank)
        assert float(deeper[:, 1::2].max()) < 2e-3  # where strides end, and so at all trace points
        # half-way between two of them the straight line may cut a corner a little
        assert float(deeper.max()) < NEAREST / 4
        start = path[:, :, -1]


def test_who_starts_inside_a_wall_may_only_move_out() -> None:
    deeper = moved([2.04, 1.5], [1.0, 0.0])
    assert (gaps(deeper[None, None])[0].diff() >= -1e-5).all()
    assert float(moved([2.04, 1.5], [-1.0, 0.0])[-1, 0]) < 2.0 - BODY_RADIUS


def test_gradients_follow_the_wall() -> None:
    velocity = torch.tensor([[[1.0, 1.0]]], requires_grad=True)
    end = walk(torch.tensor([[[1.85, 1.0]]]), velocity)[0, 0, -1]
    gradient = [torch.autograd.grad(value, velocity, retain_graph=True)[0][0, 0] for value in end]
    # along the wall the whole 0.4 s count, against it nothing
    assert torch.allclose(torch.stack(gradient), torch.tensor([[0.0, 0.0], [0.0, 0.4]]), atol=1e-4)
    free = walk(torch.tensor([[[0.5, 1.0]]]), velocity)[0, 0, -1]
    assert float(torch.autograd.grad(free[0], velocity)[0][0, 0, 0]) == pytest.approx(0.4)


def test_a_turned_and_mirrored_scene_moves_alike() -> None:
    pose = torch.tensor([[0.7, -1.0, 5.0, -3.0]])
    start, goal = torch.tensor([[[1.8, 1.0]]]), torch.tensor([[[2.8, 1.9]]])
    turned = move_to_scene(start, pose)
    path = walk(turned, move_to_scene(goal, pose) - turned, pose=pose)
    assert torch.allclose(move_to_map(path, pose), walk(start, goal - start), atol=1e-4)


def test_no_persons_path_depends_on_who_else_walks() -> None:
    generator = torch.Generator().manual_seed(1)
    start, velocity = anywhere(400, generator), 2 * torch.randn(1, 400, 2, generator=generator)
    together = walk(start, velocity)
    for i in range(0, 400, 9):
        alone = walk(start[:, i : i + 1], velocity[:, i : i + 1])
        assert torch.equal(alone[:, 0], together[:, i])


def test_no_person_creeps_into_a_wall() -> None:
    """Sliding along at a shallow angle, for a minute."""
    position = torch.tensor([[[2.0 - NEAREST, 0.5]]])
    for step in range(150):
        velocity = torch.tensor([[[1e-3, 0.5 if step // 10 % 2 else -0.5]]])
        position = walk(position, velocity)[:, :, -1]
    assert float(position[0, 0, 0]) < 2.0 - NEAREST + 1e-3
