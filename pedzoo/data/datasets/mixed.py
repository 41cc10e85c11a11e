"""Streets, halls and corridors together: folds leave a street, or all recordings of a kind, out."""

from dataclasses import replace
from typing import ClassVar

from pedzoo.core.types import TimeBase
from pedzoo.data.datasets._files import FilesDataset
from pedzoo.data.datasets.eth_ucy import SCENES, EthUcy
from pedzoo.data.datasets.gc import Gc
from pedzoo.data.datasets.hermes import Hermes
from pedzoo.data.datasets.pamela import Pamela
from pedzoo.data.recordings import Dataset, Recording, Split

STREETS = 2.0
"""Weight of a street's recording: together they are half of a training."""


class Mixed(Dataset):
    """The recordings of a fold, at real 0.4 s.

    ``mixed`` leaves none out, ``mixed_zara1`` that street, ``mixed_halls`` and so on a kind, and
    ``mixed_two_way`` all corridors in which people meet. What the datasets test with is in no training.
    """

    FOLDS: ClassVar = {
        "mixed": [],
        "mixed_eth": ["biwi_eth"],
        "mixed_hotel": ["biwi_hotel"],
        "mixed_univ": ["students001", "students003"],
        "mixed_zara1": ["crowds_zara01"],
        "mixed_zara2": ["crowds_zara02"],
        "mixed_streets": [
            "biwi_eth",
            "biwi_hotel",
            "students001",
            "students003",
            "crowds_zara01",
            "crowds_zara02",
        ],
        "mixed_halls": ["gc", "pamela"],
        "mixed_corridors": ["hermes_uo", "hermes_bo"],
        "mixed_two_way": ["hermes_bo"],
    }
    ALWAYS_TRAINED: ClassVar = ["crowds_zara03", "uni_examples"]
    REPLAYED: ClassVar = False
    SOURCE: ClassVar = (
        "ETH/UCY, Grand Central, HERMES and PAMELA: see the datasets eth_ucy, gc, hermes, pamela"
    )
    TERMS: ClassVar = (
        "ETH is public for research, without a licence text; UCY may be used with credit to its authors; "
        "Grand Central, HERMES, PAMELA: no licence stated: research use, cite"
    )
    PLAN_TERMS: ClassVar = (
        "; the floor plans were drawn from scene masks under CC BY-NC 4.0 (LMTrajectory) and the obstacles "
        "of ETH"
    )
    CITATION: ClassVar = (
        "Pellegrini et al., ICCV 2009; Lerner et al., Computer Graphics Forum 26(3), 2007; Yi, Li, Wang, "
        "CVPR 2015; Zhang et al., KDD 2022; HERMES 2009, ped.fz-juelich.de; UCL PAMELA"
    )

    def __init__(self, fold: str, root: str | None, clock: TimeBase = "true") -> None:
        """Find the files of all kinds below ``root`` or PEDZOO_DATA. Raises UserError: some are missing."""
        super().__init__(fold, root, "true")
        self.left_out = fold.removeprefix("mixed").removeprefix("_")
        street = self.left_out if self.left_out in SCENES else "eth_ucy"
        self._streets = EthUcy(street, root, "true")
        self._halls = [Gc("gc", root), Pamela("pamela", root)]
        self._corridors = Hermes("hermes", root)

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recordings of a split."""
        out = self.left_out
        kinds = {"halls": self._halls, "corridors": [self._corridors], "two_way": [self._corridors]}
        if split == "test":
            if out == "streets":
                every = [EthUcy(scene, self.root, "true") for scene in SCENES]
                return [one for street in every for one in street.recordings("test")]
            held: list[FilesDataset] = kinds.get(out, [])
            return [one for kind in held for one in kind.recordings("test")] or self._streets.recordings(
                "test"
            )
        streets = [] if out == "streets" else self._streets.recordings(split)
        result = [replace(one, weight=STREETS) for one in streets]
        for kind in [] if out == "halls" else self._halls:
            result += kind.recordings(split)
        if out != "corridors":
            streams = self._corridors.recordings(split)
            result += [
                one for one in streams if out != "two_way" or not one.tracks.name.startswith("hermes_bo")
            ]
        return result
