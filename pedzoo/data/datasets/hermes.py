"""HERMES: laboratory corridors of 8 m, 1.8 to 3.6 m wide, one- and two-way streams up to jams."""

from functools import cache
from typing import ClassVar

from pedzoo.data.datasets._files import FilesDataset
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plans import rectangles

_HALF, _THICK = 4.0, 0.2  # metres: the walls stand from -4 to 4 along y


class Hermes(FilesDataset):
    """Paths of heads, which sway."""

    FOLDS: ClassVar = {"hermes": ["hermes_bo-360-120-120", "hermes_bot-360-120-120"]}
    ALWAYS_TRAINED: ClassVar = [
        "hermes_bo-360-050-050", "hermes_bo-360-075-075", "hermes_boa-300-065-105", "hermes_bot-300-065-065",
        "hermes_bot-300-085-085", "hermes_bot-360-075-075", "hermes_uo-100-180-180", "hermes_uo-145-180-180",
        "hermes_uo-145-240-240", "hermes_uo-180-180-120", "hermes_uo-180-300-300", "hermes_uo-240-240-160",
    ]  # fmt: skip
    VALIDATED: ClassVar = ["hermes_bot-360-075-075", "hermes_uo-145-240-240"]
    DT: ClassVar = 0.0625
    PHASES: ClassVar = (0, 3)
    REPLAYED: ClassVar = False
    SOURCE: ClassVar = "HERMES; by way of https://github.com/crowdbotp/OpenTraj, datasets/HERMES/Corridor-2D"
    TERMS: ClassVar = "no licence stated: cite"
    CITATION: ClassVar = (
        "HERMES 2009, Forschungszentrum Juelich, pedestrian dynamics data archive, ped.fz-juelich.de"
    )

    def plan(self, name: str) -> OccupancyGrid:
        """Return two walls: the first number in a name is the width in cm, of ``uo`` the second."""
        _, first, second, _ = name.replace("hermes_", "").split("-")
        return corridor(int(second if name.startswith("hermes_uo") else first) / 100)


@cache
def corridor(width: float) -> OccupancyGrid:
    """Return the floor plan of a corridor of a width, metres, along y."""
    walls = [(-_THICK, -_HALF, 0.0, _HALF), (width, -_HALF, width + _THICK, _HALF)]
    return rectangles(walls, around=(-2.0, -8.0, width + 2.0, 8.4), name=f"corridor_{width:g}")
