"""Floor plans from geometry and files, and their free space."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.distance import pdist

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.formats import read_igibson, read_image, read_plan, read_ros, write_ros
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, boxes, free_points, spread_points
from pedzoo.maps.plans import flat, rectangles, room, wall


def two_rooms(width: float = 0.85, thickness: float = 0.15) -> OccupancyGrid:
    """Two rooms beside a wall on the y axis with a door about the origin."""
    half, depth = thickness / 2, 2.0
    side = width / 2 + 1.5
    outer = room((-half - depth, -side), (half + depth, side), 0.1)
    return rectangles(outer + wall((0, -side), (0, side), thickness, doors=[(side, width)]))


def distance(grid: OccupancyGrid, *points: tuple[float, float]) -> list[float]:
    given = torch.tensor(points, dtype=torch.float64)
    ids = torch.full((len(points),), grid.map_id)
    return MapBank([grid], max_distance=1.0).closest_wall(given, ids, identity_pose(len(points)))[0].tolist()


@pytest.mark.parametrize(("width", "resolution"), [(0.85, 0.05), (0.9, 0.05), (0.71, 0.01), (1.02, 0.01)])
def test_a_door_is_as_wide_as_it_is_said_to_be(width: float, resolution: float) -> None:
    grid = two_rooms(width)
    assert grid.resolution == resolution
    result = distance(grid, (0, 0), (0, width / 2 + 0.5), (-0.075 - 0.3, 1.0), (0.06, width / 2 + 0.01))
    assert result == pytest.approx([width / 2, -0.075, 0.3, -0.01], abs=1e-9)
    assert len(boxes(grid, "free")) == 6


def test_rectangles_are_exact_and_the_plan_ends_with_them() -> None:
    grid = rectangles([(1.0, -2.0, 1.5, -1.5), (2.0, -1.0, 2.5, -0.5)], 0.5, name="two")
    assert grid.cells.tolist() == [[1, 0, 0], [0, 0, 0], [0, 0, 1]]
    assert (grid.origin, grid.resolution, grid.name) == ((1.0, -2.0, 0.0), 0.5, "two")
    wider = rectangles([(1.0, -2.0, 1.5, -1.5)], 0.5, around=(0.5, -2.0, 1.0, -1.0))
    assert wider.cells.tolist() == [[0, 1], [0, 0]]


def test_walls_run_both_ways_and_doors_split_them() -> None:
    doors = [(3.0, 0.5), (0.5, 1.0)]
    assert wall((0, 1), (4, 1), 0.2, doors) == [(1.0, 0.9, 2.75, 1.1), (3.25, 0.9, 4.0, 1.1)]
    assert wall((4, 1), (0, 1), 0.2, doors) == [(1.25, 0.9, 3.0, 1.1), (0.0, 0.9, 0.75, 1.1)]
    assert wall((1, 4), (1, 0), 0.2) == [(0.9, 0, 1.1, 4)]
    inner = room((0, 0), (2, 1), 0.5)
    assert rectangles(inner, 0.5).cells.tolist() == [[1] * 6, [1, 0, 0, 0, 0, 1], [1, 0, 0, 0, 0, 1], [1] * 6]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rectangles([(0, 0, 0.71, 1)], 0.05), "x = 0.71 is not .* 0.7 and 0.75; resolution 0.01"),
        (
            lambda: rectangles([(0, 0, 1, 0.333)]),
            "y = 0.333 .*that begin at 0: the nearest are 0.33 and 0.34",
        ),
        (lambda: rectangles([]), "expected rectangles"),
        (lambda: rectangles([(1, 0, 0, 1)]), "expected rectangles"),
        (lambda: rectangles([(0, 0, float("nan"), 1)]), "expected rectangles"),
        (lambda: rectangles([(0, 0, 1, 1)], 0.0), "above 0"),
        (lambda: wall((0, 0), (1, 1), 0.1), "along x or along y"),
        (lambda: wall((0, 0), (1, 0), 0.0), "a thickness above 0"),
        (lambda: wall((0, 0), (1, 0), 0.1, [(0.2, 0.5)]), "door .* of a wall of 1 m"),
        (lambda: wall((0, 0), (1, 0), 0.1, [(0.9, 0.5)]), "door .* of a wall of 1 m"),
        (lambda: wall((0, 0), (1, 0), 0.1, [(0.5, 0.5), (0.6, 0.5)]), "its sides between 0.75 and 1"),
        (lambda: room((1, 1), (0, 2), 0.1), "low corner first"),
    ],
)
def test_what_does_not_fit_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        make()


def test_free_space_is_the_largest_part_and_keeps_clear_of_walls() -> None:
    walls = room((0, 0), (5, 2), 0.5) + wall((1.25, 0), (1.25, 2), 0.5)  # rooms of 1 m and of 3.5 m
    grid = rectangles(walls, 0.5)
    points = free_points(grid, "free", 0.0)
    assert len(points) == 7 * 4
    assert points.min(axis=0).tolist() == [1.75, 0.25] and points.max(axis=0).tolist() == [4.75, 1.75]
    clear = free_points(grid, "free", 0.75)
    assert clear.tolist() == [[x, y] for y in (0.75, 1.25) for x in (2.25, 2.75, 3.25, 3.75, 4.25)]
    turned = OccupancyGrid(grid.cells, 0.5, (1.0, 2.0, np.pi / 2), name="turned")
    np.testing.assert_allclose(
        free_points(turned, "free", 0.75), np.stack((0.5 - clear[:, 1], 2.5 + clear[:, 0]), 1)
    )
    with pytest.raises(UserError, match=r"no free cell is 2 m or more from all walls .* lower the clearance"):
        free_points(grid, "free", 2.0)
    # cells that touch at a corner, or unknown ones, do not connect
    grid = OccupancyGrid(np.array([[0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 2, 1]], dtype=np.uint8), 1.0)
    assert (len(free_points(grid, "wall", 0.0)), len(free_points(grid, "free", 0.0))) == (5, 9)


def test_spread_points_are_apart_and_nothing_more_fits() -> None:
    grid = rectangles(room((0, 0), (6, 4), 0.1), 0.1)
    everything = free_points(grid, "free", 0.3)
    points = spread_points(grid, "free", 0.3, 0.7, seed=3)
    assert pdist(points).min() >= 0.7 - 1e-6
    assert np.hypot(*(everything[:, None] - points).transpose(2, 0, 1)).min(axis=1).max() < 0.7
    assert {tuple(point) for point in points} <= {tuple(point) for point in everything}
    assert np.array_equal(points, spread_points(grid, "free", 0.3, 0.7, seed=3))
    assert not np.array_equal(points[:5], spread_points(grid, "free", 0.3, 0.7, seed=4)[:5])


CLEAR = {
    "igibson_rs": 43,
    "stanford_area1": 361,
    "stanford_area3": 171,
    "willow_2010": 622,
    "fetch_hq": 544,
    "aws_small_house": 111,
    "nav2_depot": 363,
}
"""Square metres of the shared maps more than 0.3 m from any cell that is not free, by their README."""


def test_free_space_of_the_shared_maps(shared: Path) -> None:
    for path in sorted((shared / "maps").glob("*.yaml")):
        grid = read_ros(path)
        # The README measures to the centres of pixels, a clearance to their edges.
        clearance = 0.3 - grid.resolution / 2 + 1e-6
        area = len(free_points(grid, "wall", clearance)) * grid.resolution**2
        assert area == pytest.approx(CLEAR[grid.name], abs=0.6)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-3.05, 1 / 3, 0.7), (-0.0, 1e-7, -3.1)])
@pytest.mark.parametrize("resolution", [0.05, 0.1 / 3])
def test_saving_is_a_round_trip(tmp_path, origin: tuple[float, float, float], resolution: float) -> None:
    cells = np.random.default_rng(0).integers(0, 3, (7, 5))
    grid = OccupancyGrid(cells.astype(np.uint8), resolution, origin, name="office")
    path = tmp_path / "new" / "office.yaml"
    for _ in range(2):  # onto itself, too
        write_ros(grid, path)
        again = read_plan(path)
        assert (again.digest, again.map_id, again.name) == (grid.digest, grid.map_id, "office")
        assert again.origin == origin
    assert sorted(file.name for file in path.parent.iterdir()) == ["office.png", "office.yaml"]
    pixels = cv2.imread(str(path.with_suffix(".png")), cv2.IMREAD_UNCHANGED)
    assert (np.array([254, 0, 205])[np.flipud(cells)] == pixels).all()
    with pytest.raises(UserError, match=r"expected a name in \.yaml"):
        write_ros(grid, tmp_path / "office.png")


def igibson(folder: Path, name: str = "floor_trav_0.png", size: int = 60) -> Path:
    """A room of 60 x 60 cm, 1 cm a pixel, walls 10 cm thick and a pillar at the image's top left."""
    pixels = np.full((size, 60), 255, dtype=np.uint8)
    pixels[:10] = pixels[-10:] = pixels[:, :10] = pixels[:, -10:] = 0
    pixels[10:20, 10:20] = 0
    cv2.imwrite(str(folder / name), pixels)
    return folder / name


def test_igibson_maps_have_their_own_frame(tmp_path) -> None:
    path = igibson(tmp_path)
    plain = read_igibson(path, erosion=0)
    expected = np.zeros((6, 6), dtype=int)
    expected[[0, -1]] = expected[:, [0, -1]] = expected[1, 1] = OCCUPIED  # row 0 is the smallest y
    assert plain.cells.tolist() == expected.tolist()
    assert plain.origin == pytest.approx((-0.3, -0.3, 0.0))
    # the world's origin is the centre: the pillar is at small x and small y
    assert distance(plain, (-0.15, -0.15), (0.15, 0.15))[0] < 0 < distance(plain, (0.15, 0.15))[0]
    fine = read_igibson(path, resolution=0.05, erosion=0)
    assert (fine.cells == np.kron(expected, np.ones((2, 2)))).all()

    # A box of two erodes towards larger rows and columns, as OpenCV anchors it.
    eroded = expected.copy()
    eroded[1, 1:5] = eroded[1:5, 1] = eroded[2, 2] = OCCUPIED
    grid = read_plan(path)
    assert (grid.cells == eroded).all() and grid.resolution == 0.1 and grid.name == "floor_trav_0"
    assert read_plan(path, resolution=0.05).resolution == 0.05


def test_igibson_floor_image_forbids_cells(tmp_path) -> None:
    path = igibson(tmp_path)
    floor = np.full((60, 60), 255, dtype=np.uint8)
    floor[34, 34] = 0  # bilinear resizing samples the four pixels at a cell's centre
    cv2.imwrite(str(tmp_path / "floor_0.png"), floor)
    assert read_igibson(path, erosion=0).cells[3, 3] == OCCUPIED
    for options in ({"resolution": 0}, {"source_resolution": -1}, {"erosion": -1}):
        with pytest.raises(UserError, match="expected metres above 0"):
            read_igibson(path, **options)
    with pytest.raises(UserError, match="are no cell of 10"):
        read_igibson(path, resolution=10.0)
    cv2.imwrite(str(tmp_path / "floor_0.png"), floor[:30])
    with pytest.raises(UserError, match=r"floor_0.png: \(30, 60\) pixels"):
        read_igibson(path)
    with pytest.raises(UserError, match="60 x 50 pixels, expected a square image"):
        read_plan(igibson(tmp_path, size=50))


def test_an_image_with_a_resolution(tmp_path) -> None:
    pixels = np.array([[0, 127, 128], [255, 200, 90]], dtype=np.uint8)
    for name in ("plan.png", "plan.pgm"):
        cv2.imwrite(str(tmp_path / name), pixels)
        grid = read_plan(tmp_path / name, resolution=0.2)
        assert grid.cells.tolist() == [[FREE, FREE, OCCUPIED], [OCCUPIED, OCCUPIED, FREE]]
        assert (grid.resolution, grid.origin, grid.name) == (0.2, (0.0, 0.0, 0.0), "plan")
    light = read_image(tmp_path / "plan.png", 0.2, threshold=80, origin=(1.0, 2.0, 0.5))
    assert light.cells.sum() == 1 and light.origin == (1.0, 2.0, 0.5)
    with pytest.raises(UserError, match="threshold 0"):
        read_image(tmp_path / "plan.png", 0.2, threshold=0)
    with pytest.raises(UserError, match=r"resolution 0.* above 0"):
        read_plan(tmp_path / "plan.png", resolution=0)


def test_plain_and_binary_pgm_and_yaw(tmp_path) -> None:
    keys = "resolution: 0.5\norigin: [1, 2, 0.3]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text("image: m.pgm\n" + keys)
    for content in (
        b"P2\n# made by hand\n3 2\n255\n0 205 254\n254 254 255\n",
        b"P5\n3 2\n255\n\x00\xcd\xfe\xfe\xfe\xff",
    ):
        (tmp_path / "m.pgm").write_bytes(content)
        grid = read_plan(tmp_path / "m.yaml")
        assert grid.cells.tolist() == [[FREE] * 3, [OCCUPIED, UNKNOWN, FREE]]
        assert grid.origin == (1.0, 2.0, 0.3)


def test_files_of_no_known_kind(tmp_path) -> None:
    for name, message in {
        "plan.png": "an image needs a resolution: write a ROS map yaml",
        "plan.dxf": "expected a ROS map yaml or an image",
        "floor_trav_1.png": "does not exist",
        "plan.yaml": "no map file",
    }.items():
        with pytest.raises(UserError, match=message):
            read_plan(tmp_path / name)
    with pytest.raises(UserError, match="stands in the yaml"):
        read_plan(tmp_path / "plan.yaml", resolution=0.1)


def test_the_image_of_a_ros_map_names_its_yaml(tmp_path) -> None:
    write_ros(flat(), tmp_path / "lab.yaml")
    image = next(file for file in tmp_path.iterdir() if file.suffix != ".yaml")
    with pytest.raises(UserError, match=r"an image has no metres: give '.*lab\.yaml', which does"):
        read_plan(image)
