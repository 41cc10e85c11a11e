"""Map encoders: what they see where, and what they keep out of checkpoints."""

import math
import os

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene, turn_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.models.blocks import alexnet
from pedzoo.models.blocks.map_encoders import (
    CLIP,
    ENCODERS,
    RADII,
    RAYS,
    AlexNetEncoder,
    PatchEncoder,
    RingEncoder,
    Viewpoints,
    atlas_of,
)


def room(
    name: str = "room", origin: tuple[float, float, float] = (0.0, 0.0, 0.0), side: int = 60
) -> OccupancyGrid:
    """A square of 0.1 m cells with a wall from x = 4 to 5 m."""
    cells = np.zeros((side, side), dtype=np.uint8)
    cells[:, 40:50] = OCCUPIED
    return OccupancyGrid(cells, 0.1, origin, name=name)


def people(bank: MapBank, grid: OccupancyGrid | None, n: int = 6) -> Viewpoints:
    """People who stand and look anywhere on a floor plan."""
    generator = torch.Generator().manual_seed(0)
    angle = torch.rand(n, generator=generator) * 6
    heading = torch.stack((angle.cos(), angle.sin()), dim=1)
    ids = torch.full((n,), grid.map_id if grid else -1)
    return Viewpoints(bank, torch.rand(n, 2, generator=generator) * 6, heading, ids, identity_pose(n))


def posed(at: Viewpoints, pose: Tensor) -> Viewpoints:
    """The same people in scenes of another pose (6, 4)."""
    position, heading = move_to_scene(at.position, pose), turn_to_scene(at.heading, pose)
    return at._replace(position=position, heading=heading, pose=pose)


@pytest.mark.parametrize("name", ENCODERS)
def test_empty_banks_serve_scenes_without_maps(name):
    encoder = ENCODERS[name](dim=5)
    assert encoder(people(MapBank(), None)).shape == (6, 5)
    assert encoder(people(MapBank(), None, 0)).shape == (0, 5)
    with pytest.raises(UserError, match="not of this bank"):
        encoder(people(MapBank(), room()))


def test_a_wall_in_front_is_in_front():
    grid = room()
    encoder = PatchEncoder(size=4.0, cells=8)
    # One metre before the wall: facing it, with the back to it, with it to the right, and to the left.
    heading = torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    position, ids = torch.tensor([[3.0, 3.0]] * 4), torch.full((4,), grid.map_id)
    patch = encoder.patch(Viewpoints(MapBank([grid]), position, heading, ids, identity_pose(4)))
    assert patch.shape == (4, 1, 8, 8)
    inside = patch[:, 0] < 0
    assert inside[0].any(0).tolist() == [False] * 6 + [True] * 2
    assert inside[1].any(0).tolist() == [True] * 2 + [False] * 6
    assert inside[2].any(1).tolist() == [True] * 2 + [False] * 6
    assert inside[3].any(1).tolist() == [False] * 6 + [True] * 2
    assert patch[0, 0, 4].tolist() == pytest.approx([1, 1, 1, 5 / 6, 1 / 2, 1 / 6, -1 / 6, -1 / 6], abs=1e-5)


def test_patches_turn_with_the_scene():
    grid, encoder = room(), PatchEncoder()
    at = people(MapBank([grid]), grid)
    expected = encoder.patch(at)
    for mirror in (1.0, -1.0):
        turned = encoder.patch(posed(at, torch.tensor([[1.1, mirror, 3.0, -2.0]]).repeat(6, 1)))
        torch.testing.assert_close(turned, expected if mirror > 0 else expected.flip(2), atol=1e-4, rtol=0)


def test_rings_read_distances_turned_to_the_heading():
    """First the distance here, then rings from the smallest, anticlockwise from straight ahead."""
    grid, encoder = room(), RingEncoder(dim=4)
    at = posed(people(MapBank([grid]), grid), torch.tensor([[0.7, -1.0, 2.0, 1.0]]).repeat(6, 1))
    result = encoder.distances(at)
    angle = (
        torch.atan2(at.heading[:, 1], at.heading[:, 0]).unsqueeze(1) + torch.arange(RAYS) * 2 * math.pi / RAYS
    )
    ring = torch.stack((angle.cos(), angle.sin()), -1)
    here = at.position.unsqueeze(1)
    points = torch.cat((here, *(here + radius * ring for radius in RADII)), 1)
    wanted = at.bank.signed_distance(points, at.map_id, at.pose).clamp(-CLIP, CLIP)
    torch.testing.assert_close(result, wanted, atol=1e-4, rtol=0)
    assert result.shape == (6, 1 + len(RADII) * RAYS) and float(result.min()) < 0 < float(result.max())


@pytest.mark.parametrize("name", ["patch", "rings"])
def test_encoders_train_and_carry_gradients_to_positions(name):
    grid, encoder = room(), ENCODERS[name](dim=32)
    at = people(MapBank([grid]), grid)
    at.position.requires_grad_()
    encoder(at).square().sum().backward()
    assert at.position.grad is not None and at.position.grad.abs().sum() > 0
    assert all(weight.grad is not None for weight in encoder.parameters())
    assert all(key.startswith("net.") for key in encoder.state_dict())  # and no map
    with pytest.raises(UserError, match="at least 4 cells"):
        PatchEncoder(cells=2)


def test_pictures_are_normalised_as_on_imagenet():
    """Weights that pass three channels on at their centre give (value - mean) / std, by torchvision."""
    weights = {f"{key}.bias": torch.zeros(shape[0]) for key, shape in alexnet.SHAPES.items()}
    for key, shape in alexnet.SHAPES.items():
        weight = torch.zeros(shape)
        weight[range(3), range(3), shape[2] // 2, shape[3] // 2] = 1.0
        weights[f"{key}.weight"] = weight
    side = alexnet.input_length(3)
    picture = torch.tensor([0.9, 0.7, 0.5]).view(1, 3, 1, 1).expand(1, 3, side, side)
    seen = alexnet.features(picture, weights)[0, :3, 1, 1].tolist()
    assert seen == pytest.approx([(0.9 - 0.485) / 0.229, (0.7 - 0.456) / 0.224, (0.5 - 0.406) / 0.225])


def test_feature_cells_are_centred_on_pixel_16_i_plus_15():
    """With all weights 1, a feature differs from 0 exactly where it sees the picture's only bright pixel."""
    weights = {
        f"{key}.weight": torch.full(shape, 1.0 / math.prod(shape[1:]))
        for key, shape in alexnet.SHAPES.items()
    }
    weights |= {f"{key}.bias": torch.zeros(shape[0]) for key, shape in alexnet.SHAPES.items()}
    mean = torch.tensor((0.485, 0.456, 0.406)).view(3, 1, 1)
    pixels = range(16 * 14, 16 * 15)
    pictures = mean.repeat(16, 1, alexnet.input_length(1), alexnet.input_length(28))
    for picture, pixel in zip(pictures, pixels, strict=True):
        picture[:, 15, pixel] += 1e6
    seen = alexnet.features(pictures, weights)[:, 0, 0] > 1e-3
    assert seen.shape == (16, 28)
    first = [int(row.nonzero()[0]) for row in seen]
    last = [int(row.nonzero()[-1]) for row in seen]
    left_of = next(i for i in range(15) if first[i + 1] > first[i])  # the last pixel that first[i] sees
    right_of = next(i for i in range(1, 16) if last[i] > last[i - 1])  # the first pixel that last[i] sees
    reach = pixels[left_of] - (16 * first[left_of] + 15)
    assert reach == (16 * last[right_of] + 15) - pixels[right_of] > 60


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.1])
def test_features_are_read_exactly_at_a_persons_place(monkeypatch, resolution):
    """A network that returns the centre of each of its cells, in pixels of its input."""

    def where(picture: Tensor, weights: object) -> Tensor:
        height, width = picture[0, 0, 15::16, 15::16].shape
        rows, columns = torch.meshgrid(torch.arange(height) - 0.0, torch.arange(width) - 0.0, indexing="ij")
        assert picture.shape[2:] == (alexnet.input_length(height), alexnet.input_length(width))
        return torch.stack([16 * columns + 15, 16 * rows + 15] * 128)[None]

    monkeypatch.setattr(alexnet, "features", where)
    monkeypatch.setattr(alexnet, "load", lambda path: {})
    origin = (3.0, -1.0, 0.4)
    grids = [OccupancyGrid(np.zeros((70, 130), np.uint8), resolution, origin, name="a"), room()]
    width, height = 130 * resolution, 70 * resolution
    local = torch.tensor([[0.0, 0.0], [width, height], [0.3 * width, 0.9 * height], [width, 0.0]])
    cos, sin = math.cos(0.4), math.sin(0.4)
    places = local @ torch.tensor([[cos, sin], [-sin, cos]]) + torch.tensor(origin[:2])
    pose = torch.tensor([[0.5, -1.0, 7.0, 1.0]]).repeat(4, 1)
    ids = torch.full((4,), grids[0].map_id)
    at = Viewpoints(MapBank(grids), move_to_scene(places, pose), places, ids, pose)
    atlas_of.cache_clear()
    result = AlexNetEncoder(cell=0.4).features(at)[:, 0, :2]
    atlas_of.cache_clear()
    pixel = torch.tensor([width / math.ceil(width * 40 - 1e-6), height / math.ceil(height * 40 - 1e-6)])
    assert (pixel <= 0.4 / 16 + 1e-6).all()
    torch.testing.assert_close(result, local / pixel - 0.5 + 16, atol=5e-3, rtol=0)


@pytest.mark.usefixtures("alexnet")
def test_alexnet_tells_walls_from_floor_and_is_not_saved():
    grid, moved = room(), room("moved", (10.0, 5.0, 0.0))
    encoder = AlexNetEncoder()
    at = people(MapBank([grid]), grid)
    first = encoder.features(at)
    assert first.shape == (6, 5, 256) and first.std(0).max() > 0.1
    assert encoder.features(at._replace(map_id=torch.full_like(at.map_id, -1))).abs().max() == 0
    at.position.requires_grad_()
    encoder(at).sum().backward()
    assert at.position.grad is not None and at.position.grad.abs().sum() > 0
    assert encoder.state_dict().keys() == {"head.weight", "head.bias"}
    assert sum(weight.numel() for weight in encoder.parameters()) == (5 * 256 + 1) * 32

    # Another bank, in which the same room is moved: the same features at moved places; the old map is gone.
    at = at._replace(bank=MapBank([moved]), position=at.position + torch.tensor([10.0, 5.0]))
    there = at._replace(map_id=torch.full_like(at.map_id, moved.map_id))
    torch.testing.assert_close(encoder.features(there), first, atol=1e-3, rtol=1e-3)
    with pytest.raises(UserError, match="not of this bank"):
        encoder.features(at)


@pytest.mark.usefixtures("alexnet")
def test_alexnet_weights_are_read_from_both_formats_and_checked(tmp_path, monkeypatch):
    expected = alexnet.load()
    full = {key: value.float() for key, value in load_file(os.environ["PEDZOO_ALEXNET"]).items()}
    torch.save({**full, "classifier.1.bias": torch.zeros(4096)}, tmp_path / "alexnet.pth")
    monkeypatch.setenv("PEDZOO_ALEXNET", str(tmp_path / "alexnet.pth"))
    assert all(torch.equal(value, expected[key]) for key, value in alexnet.load().items())

    full["features.8.bias"] += 0.01
    save_file(full, tmp_path / "other.safetensors")
    (tmp_path / "broken.safetensors").write_bytes(b"junk")
    (tmp_path / "broken.pth").write_bytes(b"junk")
    save_file({"features.0.weight": torch.zeros(1)}, tmp_path / "tiny.safetensors")
    for name, message in {
        "none.pth": "no AlexNet weights at",
        "other.safetensors": "holds other AlexNet weights",
        "broken.safetensors": "cannot be read",
        "broken.pth": "cannot be read",
        "tiny.safetensors": r"expected features.0.weight of shape \(64, 3, 11, 11\)",
    }.items():
        with pytest.raises(UserError, match=message):
            alexnet.load(str(tmp_path / name))
