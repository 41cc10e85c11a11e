"""Turns and scene poses, by hand and back again."""

import math

import pytest
import torch

from pedzoo.core import geometry

QUARTER = math.pi / 2


def test_a_pose_mirrors_then_turns_then_shifts() -> None:
    """(2, 1) mirrored is (2, -1), a quarter turn to the left makes it (1, 2), the shift (11, 22)."""
    north = torch.tensor([0.0, 1.0])
    assert torch.allclose(geometry.rotate(torch.tensor([2.0, 1.0]), north), torch.tensor([-1.0, 2.0]))
    assert torch.allclose(geometry.unrotate(torch.tensor([-1.0, 2.0]), north), torch.tensor([2.0, 1.0]))
    pose = torch.tensor([[QUARTER, -1.0, 10.0, 20.0]])
    point = torch.tensor([[2.0, 1.0]])
    assert torch.allclose(geometry.turn_to_scene(point, pose), torch.tensor([[1.0, 2.0]]), atol=1e-6)
    assert torch.allclose(geometry.move_to_scene(point, pose), torch.tensor([[11.0, 22.0]]), atol=1e-5)
    assert torch.allclose(geometry.move_to_map(torch.tensor([[11.0, 22.0]]), pose), point, atol=1e-5)
    # each scene of a batch has its own
    pose = torch.tensor([[0.0, 1.0, 0.0, 0.0], [0.0, -1.0, 1.0, 0.0]])
    points = torch.tensor([[3.0, 4.0]]).expand(2, 5, 2)  # two scenes of five people
    moved = geometry.move_to_scene(points, pose)
    assert torch.equal(moved[0], points[0])
    assert torch.allclose(moved[1], torch.tensor([4.0, -4.0]))


@pytest.mark.parametrize("shape", [(6, 2), (6, 3, 2), (6, 3, 8, 2)])
def test_round_trips_for_points_of_any_rank(shape: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(0)
    pose = torch.randn(6, 4, generator=generator)
    pose[:, 1] = torch.tensor([1.0, -1.0] * 3)
    points = torch.randn(shape, generator=generator)
    moved, turned = geometry.move_to_scene(points, pose), geometry.turn_to_scene(points, pose)
    torch.testing.assert_close(geometry.move_to_map(moved, pose), points, atol=1e-5, rtol=0)
    torch.testing.assert_close(geometry.turn_to_map(turned, pose), points, atol=1e-5, rtol=0)
    torch.testing.assert_close(turned.norm(dim=-1), points.norm(dim=-1), atol=1e-5, rtol=0)


def test_the_identity_changes_nothing_and_gradients_flow() -> None:
    points = torch.randn(2, 3, 2, generator=torch.Generator().manual_seed(0), requires_grad=True)
    pose = geometry.identity_pose(2)
    assert torch.equal(geometry.move_to_scene(points, pose), points)
    geometry.move_to_map(points, pose).sum().backward()
    assert points.grad is not None
    assert torch.equal(points.grad, torch.ones_like(points))
