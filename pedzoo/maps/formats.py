"""Floor plans in files: ROS map_server's, iGibson's, plain images, and images of a fixed camera."""

import io
import math
import os
import struct
import warnings
from collections.abc import Mapping
from itertools import product
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_atomically
from pedzoo.core.untrusted import LARGEST_PICTURE, check_limit, load_yaml, read_text
from pedzoo.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

FORMATS = ("PNG", "PPM", "JPEG", "BMP", "TIFF")
"""What Pillow calls the formats that are read; PPM includes pgm."""

_LONGEST_FILE = 8 * LARGEST_PICTURE  # bytes: the largest picture, its grey levels written as texts
_DENSEST = 8 * 1032  # pixels in a byte of PNG: eight of one bit, and deflate makes a byte of 1032


def read_pixels(file: Path, owner: str = "", channels: bool = False) -> NDArray[np.uint8]:
    """Return an image's grey levels (H, W), row 0 at the top, of any of `FORMATS`.

    With ``channels`` these are (H, W, C): of grey (C = 1), of three colours, or of these and opacity.

    Raises:
        UserError: The file does not exist, is no image, or has more than `LARGEST_PICTURE` pixels.
    """
    from PIL import Image, ImageOps

    if not os.path.isfile(file):  # unlike Path's, for names that no system takes, too
        raise UserError(f"{owner}image {str(file)!r:.300} does not exist")
    what, remedy = f"{owner}image {str(file)!r}", "reduce it, and give its resolution accordingly"
    check_limit(file.stat().st_size, _LONGEST_FILE, what, "bytes", remedy)
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(file, formats=FORMATS) as image:
            # what the header states, before a decoder makes place for it
            check_limit(image.width * image.height, LARGEST_PICTURE, what, "pixels", remedy)
            if image.format == "PNG" and image.width * image.height > _DENSEST * file.stat().st_size:
                raise UserError(f"{what} has fewer pixels than it says: is it cut off?")
            if not channels:
                image.draft("L", None)  # of a jpg the brightness itself
            upright = ImageOps.exif_transpose(image)
            if upright.mode.startswith("I"):  # 16 bits: the upper half
                pixels = (np.asarray(upright, dtype=np.int64) >> 8).astype(np.uint8)
            else:
                kind = "RGBA" if "A" in upright.getbands() or "transparency" in upright.info else "RGB"
                kind = kind if channels and upright.mode not in ("1", "L") else "L"
                pixels = np.asarray(upright.convert(kind), dtype=np.uint8)
            return pixels if pixels.ndim == 3 or not channels else pixels[:, :, None]
    except UserError:
        raise
    except Image.DecompressionBombError:
        check_limit(math.inf, LARGEST_PICTURE, what, "pixels", remedy)
        raise
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError, struct.error) as error:
        raise UserError(f"{what} cannot be read: expected png, pgm or jpg") from error


def read_image(
    path: str | Path,
    resolution: float,
    *,
    threshold: int = 128,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> OccupancyGrid:
    """Return the floor plan that an image shows, dark on light.

    Args:
        path: The image; its row 0 is the top, where y is largest.
        resolution: Side of a pixel in metres.
        threshold: Grey levels below it, of 0 to 255, are walls, all others free.
        origin: Pose of the image's lower left corner in the map's frame: x, y in metres, yaw in radians.

    Raises:
        UserError: The image cannot be read, or the resolution or the threshold is out of range.
    """
    path = Path(path)
    if not 0 < threshold <= 255:
        raise UserError(f"{path}: threshold {threshold}, expected a grey level from 1 to 255")
    cells = np.where(read_pixels(path) < threshold, OCCUPIED, FREE)
    return OccupancyGrid(np.flipud(cells), resolution, origin, name=path.stem)


LEVELS = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}  # grey levels that are written, map_server's own


def read_ros(path: str | Path) -> OccupancyGrid:
    """Return the floor plan of a ROS map_server file and the image that it names.

    Raises:
        UserError: A file is missing or broken, a key is missing or wrong, or the image lies elsewhere.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"no map file {str(path)!r}: expected a ROS map yaml with an image beside it")
    try:
        keys: Any = load_yaml(read_text(path))
    except UserError as error:
        raise UserError(f"{path} is not a ROS map yaml: {error}") from error
    required = ("image", "resolution", "origin", "occupied_thresh", "free_thresh")
    missing = [key for key in required if not isinstance(keys, dict) or key not in keys]
    if missing:
        raise UserError(f"{path} is not a ROS map yaml: it lacks {', '.join(missing)}")
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

    pixels = read_pixels(_image_of(path, keys["image"]), f"{path}: its ", channels=True)
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

    if path.suffix not in ENDINGS[:2]:
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


def _number(keys: Mapping[str, Any], key: str, path: Path) -> float:
    try:
        return float(keys[key])  # YAML reads 5e-2 as text: float() takes both
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{path}: {key} {keys[key]!r:.60} is not a number") from error


def _image_of(path: Path, image: Any) -> Path:
    """Return the image that a yaml names: in its folder or below it, or where its absolute path says."""
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


TRAVERSABLE = 255  # the only grey level that is free space; resizing makes others at its edges
MOST_EROSION = 1000  # cells; the work grows with its square


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


ENDINGS = (".yaml", ".yml", ".png", ".pgm", ".jpg", ".jpeg")  # of map files


def read_plan(path: str | Path, resolution: float | None = None) -> OccupancyGrid:
    """Return the floor plan of a file by `read_ros`, `read_igibson` (``floor_trav*.png``) or `read_image`.

    Args:
        path: Its name tells the format.
        resolution: Metres per cell: needed for an image, 0.1 by default for iGibson, not for a yaml.

    Raises:
        UserError: The file is of no known kind, missing or broken, or an image has no resolution.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind in ENDINGS[:2]:
        if resolution is not None:
            raise UserError(f"{path}: its resolution stands in the yaml, {resolution} was given besides")
        return read_ros(path)
    if kind not in ENDINGS:
        raise UserError(f"map file {str(path)!r}: expected a ROS map yaml or an image (png, pgm, jpg)")
    if kind == ".png" and path.name.startswith("floor_trav"):
        return read_igibson(path) if resolution is None else read_igibson(path, resolution=resolution)
    if resolution is None:
        yaml = path.with_suffix(".yaml")
        if yaml.is_file():
            raise UserError(f"map file {str(path)!r}: an image has no metres: give {str(yaml)!r}, which does")
        raise UserError(
            f"map file {str(path)!r}: an image needs a resolution: write a ROS map yaml beside it that "
            "states it, or give read_plan(path, resolution=...) metres per pixel"
        )
    return read_image(path, resolution)


_SAMPLES, _MAJORITY = (1 / 6, 3 / 6, 5 / 6), 5  # along each side of a cell; of nine samples


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
    for down, right in product(_SAMPLES, repeat=2):
        x = low[0] + (np.arange(columns)[None] + right) * resolution
        y = high[1] - (np.arange(rows)[:, None] + down) * resolution
        u, v, scale = (row[0] * x + row[1] * y + row[2] for row in to_pixel)
        with np.errstate(divide="ignore", invalid="ignore"):  # on the horizon
            column, row = np.round(u / scale), np.round(v / scale)
        inside = (row >= 0) & (row < solid.shape[0]) & (column >= 0) & (column < solid.shape[1])
        row, column = (np.where(inside, place, 0).astype(np.int64) for place in (row, column))
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
