"""Images as floor plans: grey levels of a file, and plain images with a known resolution."""

import math
import os
import struct
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.size_limits import LARGEST_PICTURE, check_limit
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid

FORMATS = ("PNG", "PPM", "JPEG", "BMP", "TIFF")
"""What Pillow calls the formats that are read; PPM includes pgm."""

_LONGEST_FILE = 8 * LARGEST_PICTURE
"""Bytes: the largest picture with grey levels that are written out as texts."""

_DENSEST = 8 * 1032
"""Pixels in a byte of PNG, at most: eight of one bit, and deflate makes a byte of 1032."""


def read_pixels(file: Path, owner: str = "") -> NDArray[np.uint8]:
    """Return an image's grey levels (H, W), row 0 at the top, of any of `FORMATS`.

    Raises:
        UserError: The file does not exist, is no image, or has more than `LARGEST_PICTURE` pixels.
    """
    return _read(file, owner, "L")


def read_channels(file: Path, owner: str = "") -> NDArray[np.uint8]:
    """Return an image's levels (H, W, C): of grey (C = 1), of three colours, or of these and opacity.

    Raises:
        UserError: As `read_pixels`.
    """
    pixels = _read(file, owner, None)
    return pixels if pixels.ndim == 3 else pixels[:, :, None]


def _read(file: Path, owner: str, kind: str | None) -> NDArray[np.uint8]:
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
            if kind == "L":
                image.draft("L", None)  # of a jpg the brightness itself
            upright = ImageOps.exif_transpose(image)
            if upright.mode.startswith("I"):  # 16 bits: the upper half
                return (np.asarray(upright, dtype=np.int64) >> 8).astype(np.uint8)
            if kind is None and upright.mode not in ("1", "L"):
                kind = "RGBA" if "A" in upright.getbands() or "transparency" in upright.info else "RGB"
            return np.asarray(upright.convert(kind or "L"), dtype=np.uint8)
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
