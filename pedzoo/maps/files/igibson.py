"""iGibson's traversability maps (``floor_trav_0.png``), as its scenes read them.

Source: the scene classes of StanfordVL/iGibson, branch igibson_challenge_2022.
"""

from pathlib import Path

import numpy as np

from pedzoo.core.errors import UserError, need
from pedzoo.core.size_limits import LARGEST_PICTURE, check_limit
from pedzoo.maps.files.images import read_pixels
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid

TRAVERSABLE = 255
"""The only grey level that is free space; resizing makes others at its edges."""

MOST_EROSION = 1000
"""Cells; the work grows with its square."""


def read_igibson(
    path: str | Path, *, resolution: float = 0.1, source_resolution: float = 0.01, erosion: int = 2
) -> OccupancyGrid:
    """Return the floor plan of a scene's traversability map in the scene's world frame.

    The image is resized bilinearly, its free space is eroded, and what is not fully traversable then is wall.
    Row 0 has the smallest y, unlike in other images; the world's origin is the image's centre. Where the
    floor's own image (``floor_0.png``) lies beside ``floor_trav_0.png``, its pixels of 0 are not free.

    Args:
        path: The png, square.
        resolution: Side of a cell of the floor plan in metres, ``trav_map_resolution``.
        source_resolution: Side of a pixel of the png in metres.
        erosion: Side in cells of the box that erodes free space, ``trav_map_erosion``; below 2 for none.

    Raises:
        UserError: An image cannot be read, is not square or of another size, or a setting is out of range.
    """
    need("video", "a plan of iGibson, which is resized as iGibson does,")
    import cv2

    path = Path(path)
    if not (resolution > 0 and source_resolution > 0 and 0 <= erosion <= MOST_EROSION):
        raise UserError(
            f"{path}: resolution {resolution}, source_resolution {source_resolution}, erosion {erosion}: "
            f"expected metres above 0 and cells from 0 to {MOST_EROSION}"
        )
    pixels = read_pixels(path)
    if pixels.shape[0] != pixels.shape[1]:
        raise UserError(
            f"{path}: {pixels.shape[1]} x {pixels.shape[0]} pixels, expected a square image as iGibson "
            "writes it: its world origin is the centre; for another image give its resolution or write a yaml"
        )
    floor = path.with_name(path.name.replace("floor_trav_", "floor_"))
    if floor != path and floor.is_file():
        solid = read_pixels(floor)
        if solid.shape != pixels.shape:
            raise UserError(f"{floor}: {solid.shape} pixels, expected those of {path.name}, {pixels.shape}")
        pixels = np.where(solid == 0, np.uint8(0), pixels)

    side = len(pixels) * source_resolution / resolution
    check_limit(side**2, LARGEST_PICTURE, f"{path} at {resolution} m", "cells", "give a larger resolution")
    size = int(round(side, 6))
    if size < 1:
        raise UserError(
            f"{path}: {len(pixels)} pixels of {source_resolution} m are no cell of {resolution} m"
        )
    pixels = cv2.resize(pixels, (size, size), interpolation=cv2.INTER_LINEAR)
    if erosion > 1:
        pixels = cv2.erode(pixels, np.ones((erosion, erosion)))
    cells = np.where(np.asarray(pixels) == TRAVERSABLE, FREE, OCCUPIED)
    corner = -size / 2 * resolution
    return OccupancyGrid(cells, resolution, (corner, corner, 0.0), name=path.stem)
