"""Floor plans of ETH/UCY, made from published image masks, homographies and recordings."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.maps.formats import read_pixels, seen_from_above
from pedzoo.maps.grid import OccupancyGrid

FRAMES = {
    "eth": ["biwi_eth"],
    "hotel": ["biwi_hotel"],
    "univ": ["students001", "students003", "uni_examples"],
    "zara1": ["crowds_zara01"],
    "zara2": ["crowds_zara02", "crowds_zara03"],
}
"""Scenes, and the recordings in the world frame of each."""

WITHOUT_PLAN = ["uni_examples"]
"""Recordings of another layout or camera: people walk through the planter of univ."""

DIGESTS = {
    "eth": "3b0cddb48da56c9abd476e70f0ee521ccd61cff921607c136515d927079fa8d0",
    "hotel": "0029930eebbc17bc7e220844629663f46ded15e0469bd7d497700b73de4a062f",
    "univ": "a074cdca6a0e2e3c3c64ffdda521ad25742e8544de668e38227d60f98a816ac8",
    "zara1": "dd6aed1c9a6154681171e528d7117e11c51a01da3a036703be0ee494f503f9d0",
    "zara2": "b4a7bd9baca6e39d5f8cafc8d78fc7d852914a935a45e8d44d51fda3e26d91c1",
}
"""Content of the floor plans that the released models were trained and measured on."""

_MARGIN = 2.0
"""Metres of floor plan beyond the people."""

_ENTRANCE_ROW = 440
"""From this row of the image down the mask of eth closes an entrance through which people walk."""


def plan_of_recording() -> dict[str, str | None]:
    """Return the floor plan of every recording, None where it has none."""
    return {
        name: None if name in WITHOUT_PLAN else scene for scene, names in FRAMES.items() for name in names
    }


def floor_plan(scene: str, folder: Path) -> OccupancyGrid:
    """Return the floor plan of a scene of `FRAMES`; people fix its extent, not its cells.

    Raises:
        UserError: A mask is missing, or the plan is not the one of `DIGESTS`.
    """
    solid, thin = _masks(scene, folder / "maps" / "source")
    people = np.concatenate([np.loadtxt(folder / "raw" / f"{name}.txt")[:, 2:] for name in FRAMES[scene]])
    low, high = np.floor(people.min(0) - _MARGIN), np.ceil(people.max(0) + _MARGIN)
    homography = np.loadtxt(folder / "homography" / f"{scene}_H.txt")
    plan = seen_from_above(
        solid, thin, homography, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])), name=scene
    )
    if plan.digest != DIGESTS[scene]:
        raise UserError(
            f"the floor plan of {scene} came out with digest {plan.digest}, expected {DIGESTS[scene]}: "
            "please report it, with the versions that `pip freeze` lists"
        )
    return plan


def _masks(scene: str, folder: Path) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where people do not walk in a scene's image, areas and thin things apart.

    Two of the published masks are wrong where people walk, and mended by the obstacles that were published
    with the recordings (EWAP): eth has its entrance closed, hotel the walkable grates about its trees.
    """
    from scipy.ndimage import label

    name = "zara" if scene.startswith("zara") else scene
    solid = read_pixels(folder / f"{name}_oracle.png") == 0
    if scene not in ("eth", "hotel"):
        return solid, np.zeros_like(solid)
    if scene == "eth":
        solid[_ENTRANCE_ROW:] = False
    else:  # the tram and the kerb, which reach the upper and the lower border of the image
        pieces, _ = label(solid)  # type: ignore[misc]  # a count alone only with output=
        solid = np.isin(pieces, np.setdiff1d(pieces[[0, -1]], 0))
    return solid, read_pixels(folder / f"{scene}_ewap_obstacles.png") > 127
