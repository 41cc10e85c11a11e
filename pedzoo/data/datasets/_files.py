"""Recordings as CSV files of one folder, ``people`` below the data root, at steps of 0.4 s."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from pedzoo.core.errors import UserError
from pedzoo.core.paths import data_root
from pedzoo.core.types import TimeBase
from pedzoo.data.recordings import Dataset, Recording, Split
from pedzoo.data.tracks import Tracks
from pedzoo.maps.grid import OccupancyGrid

FOLDER = "people"


class FilesDataset(Dataset):
    """A dataset of whole files at a rate above 2.5 Hz: each file is in one split.

    Training has every file at `PHASES` phases of its native rate, which differ by when the first step begins.

    Attributes:
        DT: Seconds between consecutive frame numbers.
        PHASES: Frame numbers at which the first step of a training recording begins.
        VALIDATED: Recordings that choose checkpoints.
    """

    FOLDS: ClassVar[Mapping[str, Sequence[str]]]
    ALWAYS_TRAINED: ClassVar[Sequence[str]]
    VALIDATED: ClassVar[Sequence[str]] = ()
    DT: ClassVar[float]
    SOURCE: ClassVar[str]
    PHASES: ClassVar[Sequence[int]] = (0,)

    def __init__(self, fold: str, root: str | None, clock: TimeBase = "true") -> None:
        """Find the files below ``root``, PEDZOO_DATA or the folder of ``pedzoo download``.

        Raises:
            UserError: There is no such folder.
        """
        super().__init__(fold, root, clock)
        base = data_root(root)
        self.folder = base / FOLDER if (base / FOLDER).is_dir() else base

    def files(self, split: Split) -> list[str]:
        """Return the names of the recordings of a split."""
        tested = [name for names in self.FOLDS.values() for name in names]
        if split == "test":
            return tested
        return [name for name in self.ALWAYS_TRAINED if (name in self.VALIDATED) == (split == "val")]

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recordings of a split, at 0.4 s. Raises UserError: a file is missing."""
        phases = self.PHASES if split == "train" else (0,)
        return [one for name in self.files(split) for one in self.read(name, phases)]

    def read(self, name: str, phases: Sequence[int] = (0,)) -> list[Recording]:
        """Return a recording at 0.4 s, once for each phase. Raises UserError: there is no such file."""
        file = self.folder / f"{name}.csv"
        if not file.is_file():
            raise UserError(
                f"no recording {str(file)!r}: expected rows frame, agent, x, y, {self.DT:g} s apart, of "
                f"{self.SOURCE}"
            )
        tracks, plan = Tracks.read(file), self.plan(name)
        result = []
        for phase in phases:
            begun = tracks.frame >= tracks.frame.min() + phase
            part = replace(
                tracks,
                name=f"{name}+{phase}" if phase else name,
                **{key: getattr(tracks, key)[begun] for key in ("frame", "agent", "xy")},
            )
            result.append(Recording(part.resampled(self.DT), plan, 1 / len(phases)))
        return result

    def plan(self, name: str) -> OccupancyGrid | None:
        """Return the floor plan of a recording; None where nobody knows the walls."""
        return None
