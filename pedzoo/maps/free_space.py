"""Where people can stand: free space away from walls, all of it within reach of all the rest."""

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.maps.grid import OccupancyGrid, Unknown


def free_points(grid: OccupancyGrid, unknown: Unknown, clearance: float) -> NDArray[np.float64]:
    """Return the centres (F, 2) of the cells in the largest connected part of the free space, row by row.

    Cells are free if their centre is at least ``clearance`` from every wall by
    `OccupancyGrid.signed_distance`; they are connected through their four sides. Unreachable places, such as
    closed courtyards, are left out.

    Raises:
        UserError: No cell is that far from all walls.
    """
    from scipy.ndimage import label

    free = ~grid.occupied(unknown) & (grid.signed_distance(unknown) >= clearance)
    parts = np.empty(free.shape, dtype=np.int32)
    if not label(free, output=parts):  # its default structure connects the four sides
        raise UserError(
            f"map {grid.name!r}: no free cell is {clearance:g} m or more from all walls "
            f"(unknown cells count as {unknown}): lower the clearance"
        )
    sizes = np.bincount(parts.ravel())
    row, column = np.nonzero(parts == 1 + sizes[1:].argmax())
    return grid.cells_to_map(np.stack((column, row), axis=1))


def spread_points(
    grid: OccupancyGrid, unknown: Unknown, clearance: float, spacing: float, seed: int
) -> NDArray[np.float64]:
    """Return some of `free_points` (S, 2) in random order, ``spacing`` metres apart and as many as then fit.

    A point is taken unless one taken before it is nearer than ``spacing``: no further one could be added. The
    same seed gives the same points.

    Raises:
        UserError: No cell is that far from all walls.
    """
    from scipy.spatial import KDTree

    points = free_points(grid, unknown, clearance)
    points = points[np.random.default_rng(seed).permutation(len(points))]
    tree = KDTree(points)
    left, taken = np.ones(len(points), dtype=bool), []
    for number, point in enumerate(points):
        if left[number]:
            taken.append(number)
            # The ball is closed, but points exactly the spacing away may stay.
            left[tree.query_ball_point(point, spacing * (1 - 1e-9))] = False
    return points[taken]
