"""ETH/UCY: five outdoor scenes of real people, leave one scene out.

Pellegrini et al., "You'll never walk alone", ICCV 2009; Lerner et al., "Crowds by example", 2007; the
split of Gupta et al., "Social GAN", CVPR 2018. ``splits.json`` in the data root lists the files of
every fold, the floor plan of every recording and the true time between two annotated steps.
"""

from __future__ import annotations

import json
from pathlib import Path

from pedzoo.data.recordings import Recording, Split
from pedzoo.data.tracks import Tracks
from pedzoo.errors import UserError
from pedzoo.paths import data_root
from pedzoo.types import Clock

FOLDS = ["eth", "hotel", "univ", "zara1", "zara2"]

FRAMES_PER_STEP = 10
"""One annotated step is 10 in the frame column of every file."""


class EthUcy:
    """The recordings of one fold."""

    def __init__(self, fold: str, root: str | None, clock: Clock = "benchmark") -> None:
        """Read the split lists below ``root`` (or PEDZOO_DATA)."""
        base = data_root(root)
        found = [folder for folder in (base, base / "eth_ucy") if (folder / "splits.json").is_file()]
        if not found:
            raise UserError(
                f"no ETH/UCY recordings in {str(base)!r}: expected splits.json there or in its folder eth_ucy; "
                "set --data.root or PEDZOO_DATA to the folder that holds it"
            )
        self.root = found[0]
        self.clock = clock
        self.splits = json.loads((self.root / "splits.json").read_text())
        self.fold = self.splits["folds"][fold]

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recordings of a split, positions rounded to 4 decimals as in Social GAN."""
        return [self._recording(self.root / file) for file in self.fold[split]]

    def _recording(self, path: Path) -> Recording:
        name = path.stem.removesuffix("_train").removesuffix("_val")
        tracks = Tracks.read(path).rounded(4)
        if self.clock == "true":
            seconds = self.splits["true_seconds_per_step"][name]
            tracks = tracks.resampled(seconds / FRAMES_PER_STEP)
        plan = self.splits["map_of_recording"][name]
        return Recording(tracks, self.root / "maps" / f"{plan}.yaml" if plan else None)
