"""Floor plans of scenes that a fixed camera sees: masks of its image, laid onto the ground by a homography.

A homography takes a pixel (u to the right, v down, 1) to the ground (x, y, 1) in metres, up to scale. All is
computed by single additions and multiplications, so that every machine finds the same cells.
"""

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

_SAMPLES = (1 / 6, 3 / 6, 5 / 6)
"""Where a cell is sampled along each of its sides: nine samples."""

_MAJORITY = 5


def seen_from_above(
    solid: NDArray[np.bool_],
    thin: NDArray[np.bool_],
    homography: NDArray[np.float64],
    low: tuple[float, float],
    high: tuple[float, float],
    resolution: float = 0.05,
    name: str = "map",
) -> OccupancyGrid:
    """Return the floor plan of a camera's image.

    A cell is occupied where most of its nine samples are solid or any of them is thin. Else it is free where
    any lies in the image, and unknown where none does.

    Args:
        solid: Pixels of areas without walking people (height, width).
        thin: Pixels of walls, posts and trunks, which may be smaller than a cell (height, width).
        homography: From the image to the ground (3, 3).
        low: Smallest x and y of the plan, metres.
        high: Largest x and y.
        resolution: Side of a cell in metres.
        name: The plan's name in messages.

    Raises:
        UserError: The masks differ in size, the homography cannot be inverted, or the plan has no cells.
    """
    if solid.shape != thin.shape or solid.ndim != 2:
        raise UserError(f"map {name!r}: masks {solid.shape} and {thin.shape}, expected two of one image")
    columns, rows = (round((last - first) / resolution) for first, last in zip(low, high, strict=True))
    if min(columns, rows) < 1:
        raise UserError(f"map {name!r}: from {low} to {high} are no cells of {resolution} m")
    to_pixel = _adjugate(homography, name)
    votes = np.zeros((rows, columns), dtype=np.int64)
    walls, seen = np.zeros((2, rows, columns), dtype=np.bool_)
    for down in _SAMPLES:
        for right in _SAMPLES:
            x = low[0] + (np.arange(columns)[None] + right) * resolution
            y = high[1] - (np.arange(rows)[:, None] + down) * resolution
            row, column, inside = _pixels(to_pixel, x, y, solid.shape)
            votes += inside & solid[row, column]
            walls |= inside & thin[row, column]
            seen |= inside
    cells = np.where(seen, FREE, UNKNOWN)
    cells[walls | (votes >= _MAJORITY)] = OCCUPIED
    return OccupancyGrid(np.flipud(cells), resolution, (*low, 0.0), name=name)


def _adjugate(homography: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return the inverse of a homography up to scale, which is all that a homography has."""
    if homography.shape != (3, 3):
        raise UserError(f"map {name!r}: a homography of shape {homography.shape}, expected (3, 3)")
    first, second, third = homography
    inverse = np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=1)
    if not np.isfinite(inverse).all() or not (first * inverse[:, 0]).sum():
        raise UserError(f"map {name!r}: the homography {homography.tolist()} cannot be inverted")
    return inverse


def _pixels(
    to_pixel: NDArray[np.float64], x: NDArray[np.floating], y: NDArray[np.floating], size: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return row and column of the pixels nearest to ground points, and which of them are in the image.

    Points outside of it get pixel (0, 0).
    """
    u, v, scale = (row[0] * x + row[1] * y + row[2] for row in to_pixel)
    with np.errstate(divide="ignore", invalid="ignore"):  # on the horizon
        column, row = np.round(u / scale), np.round(v / scale)
    inside = (row >= 0) & (row < size[0]) & (column >= 0) & (column < size[1])
    return np.where(inside, row, 0).astype(np.int64), np.where(inside, column, 0).astype(np.int64), inside
