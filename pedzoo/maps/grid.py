"""Occupancy grids: what a floor plan is, how ROS map files are read, and distances to its walls."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PureWindowsPath
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pedzoo.errors import UserError
from pedzoo.errors import unknown as unknown_name

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
"""The values of a cell."""

Unknown = Literal["wall", "free"]
"""What unknown cells count as: walls indoors, free in recorded scenes (outside the camera's image)."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A floor plan of H x W square cells.

    Attributes:
        cells: ``FREE``, ``OCCUPIED`` or ``UNKNOWN`` (H, W) uint8, read-only; row 0 has the SMALLEST y (images
            have it at the top and are flipped on reading), column 0 the smallest x.
        resolution: Side of a cell in metres.
        origin: Where the outer corner of cell (0, 0) lies in the map's frame, and how the grid is turned
            about it: x and y in metres, yaw in radians.
        name: What messages and ``MapBank.id_of`` call it; not part of its content.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = field(default="map", kw_only=True)

    def __post_init__(self) -> None:
        """Check the values and keep a read-only copy of the cells."""
        cells = np.array(self.cells, dtype=np.uint8, order="C")
        if cells.ndim != 2 or not cells.size or cells.max() > UNKNOWN:
            raise UserError(
                f"map {self.name!r}: got cells {cells.shape} with values up to {cells.max(initial=0)}, "
                f"expected (H, W) of {FREE} (free), {OCCUPIED} (occupied) or {UNKNOWN} (unknown)"
            )
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise UserError(
                f"map {self.name!r}: resolution {self.resolution} must be metres per cell, above 0"
            )
        if len(self.origin) != 3 or not all(math.isfinite(value) for value in self.origin):
            raise UserError(f"map {self.name!r}: origin {self.origin} must be x, y (metres), yaw (radians)")
        cells.flags.writeable = False
        object.__setattr__(self, "cells", cells)

    @classmethod
    def from_ros_yaml(cls, path: str | Path) -> OccupancyGrid:
        """Return the floor plan of a ROS map_server file (mode trinary) and the image that it names.

        Raises:
            UserError: A file is missing or broken, a key is missing or wrong, or the image lies elsewhere.
        """
        path = Path(path)
        keys = _read_keys(path)
        mode = keys.get("mode", "trinary")
        if mode != "trinary":
            raise UserError(f"{path}: mode {mode!r} is not supported, expected 'trinary'")
        free, occupied = _number(keys, "free_thresh", path), _number(keys, "occupied_thresh", path)
        if not 0 <= free < occupied <= 1:
            raise UserError(
                f"{path}: free_thresh {free}, occupied_thresh {occupied}: expected 0 <= free < occupied <= 1"
            )
        negate = keys.get("negate", 0)
        if negate not in (0, 1):
            raise UserError(
                f"{path}: negate {negate!r}, expected 0 (dark is occupied) or 1 (light is occupied)"
            )
        origin = keys["origin"]
        if not isinstance(origin, list) or len(origin) != 3:
            raise UserError(f"{path}: origin {origin!r}, expected [x, y, yaw] in metres and radians")
        x, y, yaw = (_number({"origin": value}, "origin", path) for value in origin)

        image = _read_image(path, keys["image"]).astype(np.float64)
        darkness = (image if negate else 255 - image) / 255
        cells = np.full(image.shape, UNKNOWN, dtype=np.uint8)
        cells[darkness > occupied] = OCCUPIED
        cells[darkness < free] = FREE
        return cls(np.flipud(cells), _number(keys, "resolution", path), (x, y, yaw), name=path.stem)

    @cached_property
    def digest(self) -> str:
        """Hex sha256 of the content: cells, resolution and origin, not the name."""
        content = hashlib.sha256(np.array(self.cells.shape, dtype="<i8").tobytes())
        content.update(self.cells.tobytes())
        content.update(np.array([self.resolution, *self.origin], dtype="<f8").tobytes())
        return content.hexdigest()

    @property
    def map_id(self) -> int:
        """What scene batches carry: the first 62 bits of the content hash, the same in every bank."""
        return int(self.digest[:16], 16) >> 2

    def occupied(self, unknown: Unknown) -> NDArray[np.bool_]:
        """Return which cells are walls (H, W), with unknown cells counted as walls or as free."""
        if unknown not in ("wall", "free"):
            raise unknown_name("treatment of unknown cells", unknown, ("wall", "free"))
        walls = self.cells == OCCUPIED
        return walls | (self.cells == UNKNOWN) if unknown == "wall" else walls

    def signed_distance(self, unknown: Unknown) -> NDArray[np.float32]:
        """Return the distance from cell centres to the nearest wall (H, W), metres, negative inside it.

        It is the distance to the nearest centre of the other kind minus half a cell: exact straight in front
        of a wall, up to a fifth of a cell too large beside its corners. Read bilinearly, it is zero at the
        edge between a free cell and a wall. A map without walls is ``inf`` everywhere, a solid one ``-inf``;
        the world outside the map is no wall.
        """
        from scipy.ndimage import distance_transform_edt

        walls = self.occupied(unknown)
        if walls.all() or not walls.any():
            return np.full(walls.shape, -np.inf if walls.all() else np.inf, dtype=np.float32)
        to_wall = np.asarray(distance_transform_edt(~walls))
        to_free = np.asarray(distance_transform_edt(walls))
        cells = np.where(walls, 0.5 - to_free, to_wall - 0.5)
        return (cells * self.resolution).astype(np.float32)

    def map_to_cell(self) -> NDArray[np.float64]:
        """Return the affine (2, 3) from the map's frame (metres) to (column, row), whole at cell centres."""
        x, y, yaw = self.origin
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]) / self.resolution
        return np.column_stack((turn, -turn @ (x, y) - 0.5))


def _read_keys(path: Path) -> Mapping[str, Any]:
    import yaml

    if not path.is_file():
        raise UserError(f"no map file {str(path)!r}: expected a ROS map yaml with an image beside it")
    try:
        keys = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not a ROS map yaml: {error}") from error
    required = ("image", "resolution", "origin", "occupied_thresh", "free_thresh")
    missing = [key for key in required if not isinstance(keys, dict) or key not in keys]
    if missing:
        raise UserError(f"{path} is not a ROS map yaml: it lacks {', '.join(missing)}")
    return keys


def _number(keys: Mapping[str, Any], key: str, path: Path) -> float:
    try:
        return float(keys[key])  # YAML reads 5e-2 as text: float() takes both
    except (TypeError, ValueError) as error:
        raise UserError(f"{path}: {key} {keys[key]!r} is not a number") from error


def _read_image(path: Path, image: Any) -> NDArray[np.uint8]:
    import cv2

    # Maps come from strangers: an image path must not reach out of their folder. The Windows reading of a
    # path knows both kinds of separators and drives.
    given = PureWindowsPath(str(image))
    if given.anchor or ".." in given.parts:
        raise UserError(f"{path}: image {str(image)!r} must lie in the yaml's folder or below it")
    file = path.parent / str(image)
    if not file.is_file():
        raise UserError(f"{path}: its image {str(file)!r} does not exist")
    try:
        pixels = cv2.imdecode(np.fromfile(file, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise UserError(f"{path}: its image {str(file)!r} cannot be read: expected png or pgm")
    return np.asarray(pixels, dtype=np.uint8)
