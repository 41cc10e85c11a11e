"""ETH/UCY: five outdoor scenes of real people, leave one scene out.

Pellegrini et al., "You'll never walk alone", ICCV 2009; Lerner et al., "Crowds by example", 2007; the split
of Gupta et al., "Social GAN", CVPR 2018. Two layouts of the data root are read. One is Social GAN's
(``zara1/train/*.txt``). The other has floor plans; its ``splits.json`` lists the files of every fold, the
floor plan of every recording and the true time between two annotated steps.
"""

import json
from typing import ClassVar

from pedzoo.core.errors import UserError
from pedzoo.core.paths import data_root
from pedzoo.core.types import STEP_SECONDS, TimeBase
from pedzoo.data.recordings import Dataset, Recording, Split
from pedzoo.data.tracks import Tracks

FRAMES_PER_STEP = 10  # one annotated step is 10 in the frame column of every file

TRUE_SECONDS = {"biwi_eth": 2 / 3}
"""Real time of an annotated step where it is not 0.4 s: biwi_eth has every tenth frame of a 15 Hz video."""

HOW_TO_GET = "`pedzoo download eth_ucy` gets those of ETH/UCY, to where they are found"


class EthUcy(Dataset):
    """The recordings of one fold."""

    FOLDS: ClassVar = {
        "eth": ["biwi_eth"],
        "hotel": ["biwi_hotel"],
        "univ": ["students001", "students003"],
        "zara1": ["crowds_zara01"],
        "zara2": ["crowds_zara02"],
        "eth_ucy": [],  # for controllers, which are judged in other places
    }
    ALWAYS_TRAINED: ClassVar = ["crowds_zara03", "uni_examples"]
    SOURCE: ClassVar = (
        "ETH (BIWI walking pedestrians) and UCY (crowds by example), split as by Social GAN; "
        "`pedzoo download eth_ucy`"
    )
    TERMS: ClassVar = (
        "ETH is public for research, without a licence text; UCY may be used with credit to its authors"
    )
    PLAN_TERMS: ClassVar = (
        "; the floor plans were drawn from scene masks under CC BY-NC 4.0 (LMTrajectory) and the obstacles "
        "of ETH"
    )
    CITATION: ClassVar = (
        "S. Pellegrini, A. Ess, K. Schindler, L. Van Gool, You'll never walk alone, ICCV 2009; "
        "A. Lerner, Y. Chrysanthou, D. Lischinski, Crowds by example, Computer Graphics Forum 26(3), 2007"
    )
    REPLAY_SHARE: ClassVar = {"univ": 0.25}  # 820 people among up to 75 others

    def __init__(self, fold: str, root: str | None, clock: TimeBase = "benchmark") -> None:
        """Find the fold's files below ``root``, PEDZOO_DATA or the folder of ``pedzoo download``.

        Raises:
            UserError: There are none; the message says how to get them.
        """
        try:
            base = data_root(root)
        except UserError as error:
            raise UserError(f"{error}; {HOW_TO_GET}") from error
        super().__init__(fold, root, clock)
        self.scenes = [fold] if self.FOLDS[fold] else SCENES
        for folder in (base, base / "eth_ucy", base / "datasets"):
            self._folder, lists = folder, folder / "splits.json"
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
        """Return the recordings of a split, positions rounded to 4 decimals as in Social GAN.

        Raises:
            UserError: The test recordings of the fold that leaves none out.
        """
        if split == "test" and not self.FOLDS[self.fold]:
            raise UserError(
                f"fold {self.fold!r} trains on every scene and has none left to test on: "
                f"--data.fold {' or '.join(SCENES)}"
            )
        files = [self._folder / file for scene in self.scenes for file in self.lists[scene][split]]
        result = []
        for path in {file.name: file for file in files}.values():  # by name: the folds share recordings
            name = path.stem.removesuffix("_train").removesuffix("_val")
            tracks, plan = Tracks.read(path).rounded(4), self.plans.get(name)
            if self.clock == "true":
                tracks = tracks.resampled(self.seconds.get(name, STEP_SECONDS) / FRAMES_PER_STEP)
            result.append(Recording(tracks, self._folder / "maps" / f"{plan}.yaml" if plan else None))
        return result

    def _below(self, scene: str) -> dict[Split, list[str]]:
        paths_by_split: dict[Split, list[str]] = {}
        for split in ("train", "val", "test"):
            folder = self._folder / scene / split
            if not (files := sorted(folder.glob("*.txt"))):
                raise UserError(f"no recordings in {str(folder)!r}: expected *.txt; {HOW_TO_GET}")
            paths_by_split[split] = [str(path.relative_to(self._folder)) for path in files]
        return paths_by_split


SCENES = [fold for fold, tested in EthUcy.FOLDS.items() if tested]  # the folds that leave one scene out
