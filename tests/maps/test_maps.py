"""Occupancy grids and the map bank, against distances computed by hand."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose, move_to_scene
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import read_pixels, read_ros
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

KEYS = {
    "image": "m.png",
    "resolution": 0.5,
    "origin": [1, 2, 0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
PIXELS = np.array([[0, 205, 254], [254, 254, 255]], dtype=np.uint8)  # the first row is the top, the largest y


def write(folder: Path, image: str = "m.png", pixels: np.ndarray = PIXELS, **keys: object) -> Path:
    (folder / image).parent.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / image), pixels)
    everything = {**KEYS, "image": image, **keys}
    text = "\n".join(f"{key}: {value}" for key, value in everything.items() if value is not None)
    (folder / "m.yaml").write_text(text)
    return folder / "m.yaml"


def corridor(name: str = "corridor", **options: object) -> OccupancyGrid:
    """One wall column at x in [2, 2.5] of a 4 x 2 m map: walls left and right of it are easy to measure."""
    cells = np.zeros((4, 8), dtype=np.uint8)
    cells[:, 4] = OCCUPIED
    return OccupancyGrid(cells, 0.5, name=name, **options)  # type: ignore[arg-type]


def ask(bank: MapBank, grid: OccupancyGrid | None, *points: tuple[float, float]) -> list[float]:
    ids = torch.tensor([grid.map_id if grid else -1] * len(points))
    return bank.signed_distance(torch.tensor(points), ids, identity_pose(len(points))).tolist()


@pytest.mark.parametrize("image", ["m.png", "m.pgm", "below/m.png"])
def test_ros_yaml_is_read_with_the_smallest_y_first(tmp_path, image: str) -> None:
    grid = read_ros(write(tmp_path, image))
    assert grid.cells.tolist() == [[FREE, FREE, FREE], [OCCUPIED, UNKNOWN, FREE]]
    assert (grid.resolution, grid.origin, grid.name) == (0.5, (1.0, 2.0, 0.0), "m")
    assert grid.occupied("wall").tolist() == [[False] * 3, [True, True, False]]
    assert grid.occupied("free").tolist() == [[False] * 3, [True, False, False]]
    again = read_ros(write(tmp_path, image, pixels=255 - PIXELS, negate=1, resolution="5e-2"))
    assert np.array_equal(again.cells, grid.cells) and again.resolution == 0.05


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"resolution": None}, "lacks resolution"),
        ({"resolution": "wide"}, "resolution 'wide' is not a number"),
        ({"resolution": 0}, "above 0"),
        ({"origin": [1, 2]}, "expected \\[x, y, yaw\\]"),
        ({"free_thresh": 0.9}, "expected 0 <= free < occupied"),
        ({"negate": 2}, "negate 2"),
        ({"mode": "grey"}, "mode 'grey', expected 'trinary', 'scale' or 'raw'"),
        ({"mode": "[unclosed"}, "not a ROS map yaml"),
    ],
)
def test_bad_values_are_named(tmp_path, keys: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        read_ros(write(tmp_path, **keys))  # type: ignore[arg-type]


OUTSIDE = "/etc/n.png ../m.png a/../../m.png C:\\n.png ..\\m.png /../m.png /etc/../etc/m.png //host/m.png"


@pytest.mark.parametrize("image", [*OUTSIDE.split(), "\\\\host\\share\\m.png", "/", "C:\\"])
def test_an_image_outside_the_folder_is_refused(tmp_path, image: str) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace("m.png", image))
    with pytest.raises(UserError, match="must lie in the yaml's folder"):
        read_ros(path)


def test_absolute_paths_lead_to_the_image_or_one_beside(tmp_path) -> None:
    path = write(tmp_path)
    text = path.read_text()
    for image in (str(tmp_path / "m.png"), "/home/robot/maps/m.png", "C:\\maps\\m.png"):
        path.write_text(text.replace("m.png", image))
        assert read_ros(path).cells.tolist() == [[FREE, FREE, FREE], [OCCUPIED, UNKNOWN, FREE]]
    (tmp_path / "yaml").mkdir()
    (tmp_path / "yaml" / "m.yaml").write_text(text.replace("m.png", str(tmp_path / "m.png")))
    assert read_ros(tmp_path / "yaml" / "m.yaml").cells.tolist()[1] == [OCCUPIED, UNKNOWN, FREE]


def nav2(pixel: np.ndarray, mode: str, negate: bool, free: float, occupied: float) -> int:
    """Return a cell of one pixel by the rules of nav2_map_server, then by those of its saver's thresholds."""
    colours = pixel[:3] if len(pixel) > 2 else pixel[:1]
    opacity = pixel[3] if len(pixel) == 4 else 255
    shade = float(np.mean([*colours, opacity] if mode == "trinary" and len(pixel) == 4 else colours)) / 255
    occ = shade if negate else 1 - shade
    if mode == "raw":
        value = round(shade * 255)
        known = FREE if value <= 100 * free else OCCUPIED if value >= 100 * occupied else UNKNOWN
        return known if value <= 100 else UNKNOWN
    if mode == "scale" and opacity < 255:
        return UNKNOWN
    return OCCUPIED if occ > occupied else FREE if occ < free else UNKNOWN


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw", "Scale"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_modes_are_those_of_nav2(tmp_path, mode: str, channels: int) -> None:
    rng = np.random.default_rng(channels)
    for negate, free, occupied in ((0, 0.2, 0.65), (1, 0.25, 0.7), (0, 0.1, 0.9)):
        pixels = rng.integers(0, 256, (24, 24, channels), dtype=np.uint8)
        pixels[:8] = pixels[:8, :, :1] // 2  # greys of which raw maps know some
        if channels == 4:
            pixels[::2, :, 3] = 255
        shown = pixels[:, :, 0] if channels == 1 else pixels[:, :, [2, 1, 0, 3][:channels]]  # OpenCV has BGR
        limits: dict = {"free_thresh": free, "occupied_thresh": occupied}
        grid = read_ros(write(tmp_path, pixels=shown, mode=mode, negate=negate, **limits))
        expected = [[nav2(one, mode.lower(), bool(negate), free, occupied) for one in row] for row in pixels]
        assert np.array_equal(grid.cells, np.flipud(expected))
        assert len(np.unique(expected)) == 3


@pytest.mark.parametrize(
    "kind", ["grey", "16 bits", "palette", "colour", "transparent", "pgm", "jpg", "jpg in colour"]
)
def test_grey_levels_are_those_of_opencv(tmp_path, kind: str) -> None:
    """Of colours to one level: roundings differ."""
    rng = np.random.default_rng(2)
    grey = np.kron(rng.integers(0, 256, (3, 5)), np.ones((8, 8))).astype(np.uint8)
    colours = np.stack([grey, grey[::-1], 255 - grey], 2)
    pixels = {
        "16 bits": grey.astype(np.uint16) * 256 + 77,
        "colour": colours,
        "transparent": np.dstack([colours, grey]),
        "jpg in colour": colours,
    }.get(kind, grey)
    file = tmp_path / {"pgm": "m.pgm", "jpg": "m.jpg", "jpg in colour": "m.jpg"}.get(kind, "m.png")
    if kind == "palette":
        Image.fromarray(grey).convert("P").save(file)
    else:
        cv2.imwrite(str(file), pixels)
    known = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    assert known is not None
    most = 1 if "colour" in kind or kind == "transparent" else 0
    assert np.abs(read_pixels(file).astype(int) - known).max() <= most


def test_missing_and_broken_files_are_named(tmp_path) -> None:
    with pytest.raises(UserError, match="no map file"):
        read_ros(tmp_path / "none.yaml")
    path = write(tmp_path)
    for content in (b"not a picture", b""):
        (tmp_path / "m.png").write_bytes(content)
        with pytest.raises(UserError, match="cannot be read"):
            read_ros(path)
    (tmp_path / "m.png").unlink()
    with pytest.raises(UserError, match="does not exist"):
        read_ros(path)
    path.write_text("just text")
    with pytest.raises(UserError, match="lacks image, resolution"):
        read_ros(path)


def test_signed_distance_by_hand() -> None:
    row = [1.75, 1.25, 0.75, 0.25, -0.25, 0.25, 0.75, 1.25]
    assert np.allclose(corridor().signed_distance("free"), [row] * 4)
    empty = OccupancyGrid(np.full((2, 3), UNKNOWN, np.uint8), 1.0)
    assert (empty.signed_distance("free") == np.inf).all()
    assert (empty.signed_distance("wall") == -np.inf).all()


def test_the_content_makes_the_id_and_not_the_name() -> None:
    assert corridor("a").map_id == corridor("b").map_id >= 0
    others = [corridor(origin=(0.0, 0.0, 0.1)), OccupancyGrid(corridor().cells, 0.4)]
    assert len({corridor().map_id, *(other.map_id for other in others)}) == 3
    with pytest.raises(ValueError, match="read-only"):
        corridor().cells[0, 0] = UNKNOWN


def test_bank_reads_between_cell_centres_and_stops_at_the_border() -> None:
    grid = corridor()
    result = ask(
        MapBank([grid]), grid, (1.0, 1.0), (1.75, 1.0), (2.0, 1.0), (2.25, 0.3), (-9.0, 1.0), (2.0, 99.0)
    )
    assert result == pytest.approx([1.0, 0.25, 0.0, -0.25, 1.75, 0.0], abs=1e-5)


def test_turned_maps_and_scenes_have_the_same_walls() -> None:
    plain, turned = corridor(), corridor("turned", origin=(10.0, -5.0, math.pi / 2))
    bank = MapBank([plain, turned])
    # a quarter turn to the left: the map's x axis points along the world's y
    points = [(0.4, 0.7), (1.9, 1.1), (3.3, 0.2)]
    moved = [(10.0 - y, -5.0 + x) for x, y in points]
    assert ask(bank, turned, *moved) == pytest.approx(ask(bank, plain, *points), abs=1e-4)
    grid = corridor(origin=(1.0, 2.0, 0.3))
    bank, ids, places = MapBank([grid]), torch.full((5,), grid.map_id), torch.rand(5, 3, 4, 2) * 4
    mirror = torch.tensor([1.0, -1, 1, -1, -1])
    pose = torch.stack((torch.rand(5) * 6, mirror, torch.rand(5), torch.rand(5)), dim=1)
    there = bank.signed_distance(places, ids, identity_pose(5))
    assert there.shape == (5, 3, 4)
    torch.testing.assert_close(bank.signed_distance(move_to_scene(places, pose), ids, pose), there)


def test_gradient_points_away_from_walls() -> None:
    grid = corridor(origin=(0.0, 0.0, 0.5))
    bank = MapBank([grid])
    points = torch.tensor([[0.6, 1.2], [1.5, 1.6], [-50.0, 3.0]], requires_grad=True)
    ids, pose = torch.full((3,), grid.map_id), torch.tensor([[0.7, -1.0, 0.2, 0.1]]).repeat(3, 1)
    places = move_to_scene(points, pose)
    (gradient,) = torch.autograd.grad(bank.signed_distance(places, ids, pose).sum(), points)
    step = 1e-2
    for axis in range(2):
        shift = torch.zeros(2)
        shift[axis] = step
        ahead, behind = (
            bank.signed_distance(move_to_scene(points.detach() + sign * shift, pose), ids, pose)
            for sign in (1, -1)
        )
        torch.testing.assert_close(gradient[:, axis], (ahead - behind) / (2 * step), atol=2e-3, rtol=1e-3)
    assert gradient[:2].norm(dim=1).tolist() == pytest.approx([1.0, 1.0], abs=1e-3)
    assert gradient[2].tolist() == [0.0, 0.0]


def test_maps_of_a_bank_do_not_bleed() -> None:
    solid = OccupancyGrid(np.full((3, 20), OCCUPIED, np.uint8), 0.5, name="solid")
    grid = corridor()
    bank = MapBank([solid, grid, OccupancyGrid(solid.cells[:2], 0.5, name="solid2"), corridor("again")])
    edges = [(x, y) for x in (0.0, 1.0, 2.25, 4.0, 90.0) for y in (-9.0, 0.0, 0.25, 1.75, 2.0, 9.0)]
    assert ask(bank, grid, *edges) == pytest.approx(ask(MapBank([grid]), grid, *edges), abs=1e-5)
    assert ask(bank, solid, (0.0, 0.0), (50.0, 50.0)) == [-bank.max_distance] * 2
    assert len(bank.grids) == 3
    assert bank.id_of("corridor") == bank.id_of("again") == grid.map_id


def test_ids_are_checked() -> None:
    grid, other = corridor(), corridor("other", origin=(1.0, 0.0, 0.0))
    bank = MapBank([other, grid])
    ids = torch.tensor([grid.map_id, -1, other.map_id])
    assert bank.index(ids).tolist() == [1, -1, 0]
    assert bank.index(ids[[2, 2]]).tolist() == [0, 0]
    with pytest.raises(UserError, match=f"map_id {grid.map_id} is not of this bank.*other"):
        MapBank([other]).index(ids)
    with pytest.raises(UserError, match="map_id -2"):
        bank.index(torch.tensor([-2]))
    with pytest.raises(UserError, match="did you mean 'corridor'"):
        bank.id_of("coridor")
    with pytest.raises(UserError, match="two different maps"):
        MapBank([grid, OccupancyGrid(grid.cells, 9.0, name=grid.name)])


def test_no_map_and_no_points() -> None:
    nothing = torch.zeros(0, 3, 2), torch.zeros(0, dtype=torch.long), torch.zeros(0, 4)
    for bank in (MapBank(), MapBank([corridor()])):
        assert ask(bank, None, (2.25, 1.0), (1e6, 0.0)) == [5.0, 5.0]
        assert bank.signed_distance(*nothing).shape == (0, 3)
    with pytest.raises(UserError, match="holds no map"):
        MapBank().index(torch.tensor([7]))


def test_half_precision_does_not_blur_positions() -> None:
    grid = corridor()
    points, ids, pose = torch.rand(9, 2) * 4, torch.full((9,), grid.map_id), identity_pose(9)
    bank = MapBank([grid])
    exact = bank.signed_distance(points, ids, pose)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(bank.signed_distance(points, ids, pose), exact)


@pytest.mark.parametrize("name", ["eth", "hotel", "univ", "zara1", "zara2"])
def test_recorded_people_walk_on_free_cells(shared: Path, name: str) -> None:
    recordings = {"eth": "biwi_eth", "hotel": "biwi_hotel", "univ": "students003"}
    recording = recordings.get(name, name.replace("zara", "crowds_zara0"))
    rows = np.loadtxt(shared / "data" / "eth_ucy" / "raw" / f"{recording}.txt")
    grid = read_ros(shared / "data" / "eth_ucy" / "maps" / f"{name}.yaml")
    points = torch.tensor(rows[:, 2:], dtype=torch.float32)
    ids = torch.full((len(points),), grid.map_id)
    distance = MapBank([grid]).signed_distance(points, ids, identity_pose(len(points)))
    assert (distance > 0).float().mean() > 0.975
