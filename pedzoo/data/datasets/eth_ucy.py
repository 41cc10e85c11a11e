"""ETH/UCY: five outdoor scenes of real people, leave one scene out.

Pellegrini et al., "You'll never walk alone", ICCV 2009; Lerner et al., "Crowds by example", 2007; the
split of Gupta et al., "Social GAN", CVPR 2018. Two layouts of the data root are read: Social GAN's
(``zara1/train/*.txt``), and one with floor plans, whose ``splits.json`` lists the files of every fold, the
floor plan of every recording and the true time between two annotated steps.
"""

from __future__ import annotations

import json
from pathlib import Path

from pedzoo.core.errors import UserError
from pedzoo.core.paths import data_root
from pedzoo.core.types import STEP_SECONDS, TimeBase
from pedzoo.data.recordings import Recording, Split
from pedzoo.data.tracks import Tracks

FOLDS = ["eth", "hotel", "univ", "zara1", "zara2", "eth_ucy"]

EVERYTHING = "eth_ucy"
"""The fold that leaves nothing out: for controllers, which are judged in other places."""

SCENES = [fold for fold in FOLDS if fold != EVERYTHING]
"""The folds that leave one scene out."""

FRAMES_PER_STEP = 10
"""One annotated step is 10 in the frame column of every file."""

TRUE_SECONDS = {"biwi_eth": 2 / 3}
"""Real time of an annotated step where it is not 0.4 s: biwi_eth has every tenth frame of a 15 Hz video."""

HOW_TO_GET = "`pedzoo download eth_ucy` gets those of ETH/UCY, to where they are found"


class EthUcy:
    """The recordings of one fold."""

    def __init__(self, fold: str, root: str | None, clock: TimeBase = "benchmark") -> None:
        """Find the fold's files below ``root``, PEDZOO_DATA or the folder of ``pedzoo download``.

        Raises:
            UserError: There are none; the message says how to get them.
        """
        try:
            base = data_root(root)
        except UserError as error:
            raise UserError(f"{error}; {HOW_TO_GET}") from error
        self.clock, self.fold = clock, fold
        self.scenes = SCENES if fold == EVERYTHING else [fold]
        for folder in (base, base / "eth_ucy", base / "datasets"):
            self.root, lists = folder, folder / "splits.json"
            if lists.is_file():
                splits = json.loads(lists.read_text())
                self.lists: dict[str, dict[Split, list[str]]] = splits["folds"]
                self.plans, self.seconds = splits["map_of_recording"], splits["true_seconds_per_step"]
                return
            if all((folder / scene / "test").is_dir() for scene in self.scenes):
                self.lists = {scene: self._below(scene) for scene in self.scenes}
                self.plans, self.seconds = {}, TRUE_SECONDS
                return
        raise UserError(
            f"no recordings of {fold!r} in {str(base)!r}: expected splits.json or {fold}/train/*.txt there; "
            f"{HOW_TO_GET}"
        )

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recordings of a split, positions rounded to 4 decimals as in Social GAN."""
        return [self._recording(file) for file in self.files(split)]

    def files(self, split: Split) -> list[Path]:
        """Return the files of a split's recordings.

        Raises:
            UserError: The test recordings of the fold that leaves none out.
        """
        if split == "test" and self.fold == EVERYTHING:
            raise UserError(
                f"fold {EVERYTHING!r} trains on every scene and has none left to test on: "
                f"--data.fold {' or '.join(SCENES)}"
            )
        # by name: the folds share recordings
        files = [self.root / file for scene in self.scenes for file in self.lists[scene][split]]
        return list({file.name: file for file in files}.values())

    def _below(self, scene: str) -> dict[Split, list[str]]:
        paths_by_split: dict[Split, list[str]] = {}
        for split in ("train", "val", "test"):
            folder = self.root / scene / split
            if not (files := sorted(folder.glob("*.txt"))):
                raise UserError(f"no recordings in {str(folder)!r}: expected *.txt; {HOW_TO_GET}")
            paths_by_split[split] = [str(path.relative_to(self.root)) for path in files]
        return paths_by_split

    def _recording(self, path: Path) -> Recording:
        name = path.stem.removesuffix("_train").removesuffix("_val")
        tracks = Tracks.read(path).rounded(4)
        if self.clock == "true":
            tracks = tracks.resampled(self.seconds.get(name, STEP_SECONDS) / FRAMES_PER_STEP)
        plan = self.plans.get(name)
        return Recording(tracks, self.root / "maps" / f"{plan}.yaml" if plan else None)
