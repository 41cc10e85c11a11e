"""Floor plans as ROS map_server files: a yaml and the image that it names, read and written.

The format: http://wiki.ros.org/map_server, with the three modes as nav2_map_server reads them. What lies
between the thresholds is unknown in all of them: grey of ``trinary`` and ``scale``, per cent of ``raw``.
"""

import io
import os
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_atomically
from pedzoo.core.size_limits import load_yaml, read_text
from pedzoo.maps.files.images import read_channels
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

LEVELS = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
"""Grey levels that are written, map_server's own."""


def read_ros(path: str | Path) -> OccupancyGrid:
    """Return the floor plan of a ROS map_server file and the image that it names.

    Raises:
        UserError: A file is missing or broken, a key is missing or wrong, or the image lies elsewhere.
    """
    path = Path(path)
    keys = _read_keys(path)
    mode = str(keys.get("mode", "trinary")).lower()
    if mode not in ("trinary", "scale", "raw"):
        raise UserError(f"{path}: mode {mode!r:.60}, expected 'trinary', 'scale' or 'raw'")
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

    pixels = read_channels(_image_of(path, keys["image"]), owner=f"{path}: its ")
    # opacity counts as one more colour in trinary maps, and tells unknown cells in others
    levels = pixels if mode == "trinary" else pixels[:, :, :3]
    most = 255 * levels.shape[2]
    level = np.arange(most + 1)
    meaning = np.full(len(level), UNKNOWN, dtype=np.uint8)
    if mode == "raw":  # per cent, whatever negate is; 255 stands for unknown
        value = np.rint(level * 255 / most)
        meaning[(value >= np.rint(100 * occupied)) & (value <= 100)] = OCCUPIED
        meaning[value <= np.rint(100 * free)] = FREE
    else:
        darkness = (level if negate else most - level) / most
        meaning[darkness > occupied] = OCCUPIED
        meaning[darkness < free] = FREE
    cells = meaning[levels.sum(2, dtype=np.uint16)]
    if mode == "scale" and pixels.shape[2] == 4:
        cells[pixels[:, :, 3] < 255] = UNKNOWN
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
    write_atomically(image, encoded.getvalue())
    write_atomically(path, yaml.safe_dump(keys, sort_keys=False).encode())


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


def _image_of(path: Path, image: Any) -> Path:
    """Return the image that a yaml names.

    Raises:
        UserError: It is neither in the yaml's folder or below it, nor where its absolute path says.
    """
    # Maps come from strangers: a relative path must not reach out of their folder, and none to another
    # computer. The Windows reading of a path knows both kinds of separators and drives.
    text = str(image)
    given, file = PureWindowsPath(text), path.parent / text
    if given.anchor and given.name and not text.startswith(("//", "\\\\")):
        # written where the map was made: often on another computer
        file = Path(text) if Path(text).is_absolute() and os.path.isfile(text) else path.parent / given.name
    if (given.anchor and not os.path.isfile(file)) or ".." in given.parts:
        raise UserError(f"{path}: image {text!r} must lie in the yaml's folder or below it, or where it says")
    return file
