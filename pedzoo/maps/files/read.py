"""Floor plans in files of all formats."""

from pathlib import Path

from pedzoo.core.errors import UserError
from pedzoo.maps.files.igibson import read_igibson
from pedzoo.maps.files.images import read_image
from pedzoo.maps.files.ros import read_ros
from pedzoo.maps.grid import OccupancyGrid


def read_plan(path: str | Path, resolution: float | None = None) -> OccupancyGrid:
    """Return the floor plan of a file: ROS yaml, iGibson's ``floor_trav*.png``, or an image.

    `pedzoo.maps.files.ros`, `igibson` and `images` read these formats one by one, with their settings.

    Args:
        path: Its name tells the format.
        resolution: Metres per cell: needed for an image, 0.1 by default for iGibson, not for a yaml.

    Raises:
        UserError: The file is of no known kind, missing or broken, or an image has no resolution.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind in (".yaml", ".yml"):
        if resolution is not None:
            raise UserError(f"{path}: its resolution stands in the yaml, {resolution} was given besides")
        return read_ros(path)
    if kind not in (".png", ".pgm", ".jpg", ".jpeg"):
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
