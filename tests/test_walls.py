"""Walls as boxes and exact distances to them, against brute force over all cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pedzoo.maps.boxes import boxes, merge_cells
from pedzoo.maps.grid import OCCUPIED, UNKNOWN, OccupancyGrid


def drawn(*rows: str, **options: object) -> OccupancyGrid:
    """A map from text, the first line at the top: ``#`` wall, ``?`` unknown, anything else free."""
    values = {"#": OCCUPIED, "?": UNKNOWN}
    cells = np.array([[values.get(letter, 0) for letter in row] for row in rows], dtype=np.uint8)
    return OccupancyGrid(np.flipud(cells), **{"resolution": 0.5, **options})  # type: ignore[arg-type]


def scattered(height: int, width: int, share: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width)) < share


def painted(parts: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """How many boxes cover each cell."""
    count = np.zeros(shape, dtype=int)
    for x0, y0, x1, y1 in parts:
        count[y0:y1, x0:x1] += 1
    return count


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_boxes_cover_every_wall_once_and_nothing_else(share: float) -> None:
    for seed, shape in enumerate([(1, 1), (1, 9), (9, 1), (23, 31)]):
        cells = scattered(*shape, share, seed)
        assert (painted(merge_cells(cells), shape) == cells).all()


def test_plain_walls_are_few_boxes() -> None:
    assert boxes(drawn("....", ".##.", ".##."), "free").tolist() == [[0.5, 0.0, 1.5, 1.0]]
    room = drawn("#####", "#...#", "#...#", "#####")
    assert len(boxes(room, "free")) == 4
    two_rooms_and_a_door = drawn("#######", "#..#..#", "#.....#", "#..#..#", "#######")
    assert len(boxes(two_rooms_and_a_door, "free")) == 6
    comb = drawn("#.#.#.#", "#.#.#.#", "#######")  # fewer along the columns than along the rows or as many
    assert len(boxes(comb, "free")) <= 5
    assert len(boxes(drawn("..", ".."), "free")) == 0


def test_unknown_cells_are_boxes_where_they_are_walls() -> None:
    grid = drawn("??", "..", "##")
    assert boxes(grid, "free").tolist() == [[0.0, 0.0, 1.0, 0.5]]
    assert sorted(boxes(grid, "wall").tolist()) == [[0.0, 0.0, 1.0, 0.5], [0.0, 1.0, 1.0, 1.5]]


def test_boxes_of_the_shared_maps(shared: Path) -> None:
    for path in sorted((shared / "maps").glob("*.yaml")):
        grid = OccupancyGrid.from_ros_yaml(path)
        walls = grid.occupied("wall")
        parts = np.rint(boxes(grid, "wall") / grid.resolution).astype(int)
        assert (painted(parts, walls.shape) == walls).all()
        assert len(parts) < walls.sum() / 4
