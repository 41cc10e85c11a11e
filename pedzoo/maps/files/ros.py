"""Floor plans as ROS map_server files: a yaml and the image that it names, read and written.

The format: http://wiki.ros.org/map_server, mode trinary.
"""

import io
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_whole
from pedzoo.core.size_limits import load_yaml, read_text
from pedzoo.maps.files.images import read_pixels
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

LEVELS = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
"""Grey levels that are written, map_server's own."""


def read_ros(path: str | Path) -> OccupancyGrid:
    """Return the floor plan of a ROS map_server file (mode trinary) and the image that it names.

    Raises:
        UserError: A file is missing or broken, a key is missing or wrong, or the image lies elsewhere.
    """
    path = Path(path)
    keys = _read_keys(path)
    mode = keys.get("mode", "trinary")
    if mode != "trinary":
        raise UserError(f"{path}: mode {mode!r:.60} is not supported, expected 'trinary'")
    free, occupied = _number(keys, "free_thresh", path), _number(keys, "occupied_thresh", path)
    if not 0 <= free < occupied <= 1:
        raise UserError(
            f"{path}: free_thresh {free}, occupied_thresh {occupied}: expected 0 <= free < occupied <= 1"
        )
    negate = keys.get("negate", 0)
    if negate not in (0, 1):
        raise UserError(f"{path}: negate {negate!r:.60}, expected 0 (dark is occupied) or 1 (light is)")
    origin = keys["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise UserError(f"{path}: origin {origin!r:.60}, expected [x, y, yaw] in metres and radians")
    x, y, yaw = (_number({"origin": value}, "origin", path) for value in origin)

    level = np.arange(256)
    darkness = (level if negate else 255 - level) / 255
    meaning = np.full(len(level), UNKNOWN, dtype=np.uint8)
    meaning[darkness > occupied] = OCCUPIED
    meaning[darkness < free] = FREE
    cells = meaning[_pixels_of(path, keys["image"])]
    return OccupancyGrid(np.flipud(cells), _number(keys, "resolution", path), (x, y, yaw), name=path.stem)


def write_ros(grid: OccupancyGrid, path: Path) -> None:
    """Write a floor plan as yaml and png beside it, each whole or not at all; read again it is the same.

    Raises:
        UserError: The path does not end in ``.yaml`` or ``.yml``.
    """
    import yaml
    from PIL import Image

    if path.suffix not in (".yaml", ".yml"):
        raise UserError(f"map file {str(path)!r}: maps are saved as a ROS map yaml, expected a name in .yaml")
    image = path.with_suffix(".png")
    keys = {
        "image": image.name,
        "resolution": float(grid.resolution),
        "origin": [float(value) for value in grid.origin],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    pixels = np.array([LEVELS[value] for value in range(len(LEVELS))], dtype=np.uint8)[np.flipud(grid.cells)]
    encoded = io.BytesIO()
    Image.fromarray(pixels).save(encoded, "png")
    write_whole(image, encoded.getvalue())
    write_whole(path, yaml.safe_dump(keys, sort_keys=False).encode())


def _read_keys(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise UserError(f"no map file {str(path)!r}: expected a ROS map yaml with an image beside it")
    try:
        keys = load_yaml(read_text(path))
    except UserError as error:
        raise UserError(f"{path} is not a ROS map yaml: {error}") from error
    required = ("image", "resolution", "origin", "occupied_thresh", "free_thresh")
    missing = [key for key in required if not isinstance(keys, dict) or key not in keys]
    if missing:
        raise UserError(f"{path} is not a ROS map yaml: it lacks {', '.join(missing)}")
    return keys


def _number(keys: Mapping[str, Any], key: str, path: Path) -> float:
    try:
        return float(keys[key])  # YAML reads 5e-2 as text: float() takes both
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{path}: {key} {keys[key]!r:.60} is not a number") from error


def _pixels_of(path: Path, image: Any) -> NDArray[np.uint8]:
    # Maps come from strangers: an image path must not reach out of their folder. The Windows reading of a
    # path knows both kinds of separators and drives.
    given = PureWindowsPath(str(image))
    if given.anchor or ".." in given.parts:
        raise UserError(f"{path}: image {str(image)!r} must lie in the yaml's folder or below it")
    file = path.parent / str(image)
    return read_pixels(file, owner=f"{path}: its ")
