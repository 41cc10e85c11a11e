"""ETH/UCY from public repositories, as `pedzoo.data.datasets.eth_ucy` reads it, and its floor plans."""

import json
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.paths import write_atomically
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datasets.eth_ucy import SCENES, TRUE_SECONDS, EthUcy
from pedzoo.data.published.files import PublishedFile, bring, files_of
from pedzoo.maps.formats import read_pixels, seen_from_above, write_ros
from pedzoo.maps.grid import OccupancyGrid

TERMS = f"{EthUcy.TERMS}{EthUcy.PLAN_TERMS}. For research; do not pass the files on inside a package."
CITATION = f"{EthUcy.CITATION}; for the split: A. Gupta et al., Social GAN, CVPR 2018"

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

_MARGIN = 2.0  # metres of floor plan beyond the people

_ENTRANCE_ROW = 440
"""From this row of the image down the mask of eth closes an entrance through which people walk."""


def download(folder: Path) -> list[PublishedFile]:
    """Bring ETH/UCY into a folder and return the files that came from elsewhere; a second call mends it.

    ``splits.json`` is written last: by it the folder is known to be whole.

    Raises:
        UserError: A file cannot be had, or the folder cannot be written. What is there is kept.
    """
    files = files_of("eth_ucy")
    bring(files, folder, "eth_ucy")
    used = dict.fromkeys(file.places[0][:2] for file in files)
    sources = "\n".join(f"- https://github.com/{repository} at {commit}" for repository, commit in used)
    page = Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8"))
    for scene in FRAMES:
        write_ros(floor_plan(scene, folder), folder / "maps" / f"{scene}.yaml")
    sums = "".join(f"{file.sha256}  {file.path}\n" for file in files)
    write_atomically(folder / "SHA256SUMS", sums.encode())
    readme = page.substitute(terms=TERMS, citation=CITATION, sources=sources)
    write_atomically(folder / "README.md", readme.encode())
    write_atomically(folder / "splits.json", (json.dumps(splits(), indent=1) + "\n").encode())
    return files


def splits() -> dict[str, Any]:
    """Return the content of ``splits.json``: leave one scene out, the rest cut in time as by Social GAN.

    The scene's other recordings, zara03 and uni_examples, stay in the training set.
    """
    plans = {
        name: None if name in WITHOUT_PLAN else scene for scene, names in FRAMES.items() for name in names
    }
    folds = {}
    for scene in SCENES:
        tested = EthUcy.FOLDS[scene]
        others = sorted(set(plans) - set(tested))
        folds[scene] = {
            "train": [f"train/{name}_train.txt" for name in others],
            "val": [f"val/{name}_val.txt" for name in others],
            "test": [f"raw/{name}.txt" for name in tested],
        }
    return {
        "seconds_per_step": STEP_SECONDS,
        "true_seconds_per_step": {name: round(TRUE_SECONDS.get(name, STEP_SECONDS), 4) for name in plans},
        "map_of_recording": plans,
        "folds": folds,
    }


def floor_plan(scene: str, folder: Path) -> OccupancyGrid:
    """Return the floor plan of a scene of `FRAMES`; people fix its extent, not its cells.

    Raises:
        UserError: A mask is missing, or the plan is not the one of `DIGESTS`.
    """
    solid, thin = _masks(scene, folder / "maps" / "source")
    people = np.concatenate([np.loadtxt(folder / "raw" / f"{name}.txt")[:, 2:] for name in FRAMES[scene]])
    low, high = (np.floor(people.min(0) - _MARGIN).tolist(), np.ceil(people.max(0) + _MARGIN).tolist())
    homography = np.loadtxt(folder / "homography" / f"{scene}_H.txt")
    plan = seen_from_above(solid, thin, homography, (low[0], low[1]), (high[0], high[1]), name=scene)
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
