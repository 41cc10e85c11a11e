"""Images as floor plans: grey levels of a file, and plain images with a known resolution."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid


def read_pixels(file: Path, owner: str = "") -> NDArray[np.uint8]:
    """Return an image's grey levels (H, W), row 0 at the top, of any format that OpenCV reads.

    Raises:
        UserError: The file does not exist or is no image.
    """
    import cv2

    if not file.is_file():
        raise UserError(f"{owner}image {str(file)!r} does not exist")
    try:
        pixels = cv2.imdecode(np.fromfile(file, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise UserError(f"{owner}image {str(file)!r} cannot be read: expected png, pgm or jpg")
    return np.asarray(pixels, dtype=np.uint8)


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
