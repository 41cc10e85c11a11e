"""The synthetic plaza that ships with the package: for the demo, tests and first steps, never for results."""

from importlib.resources import files
from pathlib import Path
from typing import ClassVar

from pedzoo.core.types import TimeBase
from pedzoo.data.recordings import Dataset, Recording, Split
from pedzoo.data.tracks import Tracks


class Embedded(Dataset):
    """The recordings of the plaza: one for each split, all on the same floor plan."""

    FOLDS: ClassVar = {"embedded": ["plaza_test"]}
    ALWAYS_TRAINED: ClassVar = ["plaza_train"]
    SOURCE: ClassVar = "pedzoo's embedded recordings: synthetic people on a made-up plaza, no human data"
    TERMS: ClassVar = "MIT, as pedzoo"
    CITATION: ClassVar = "none: do not report results on them as if they said something about people"

    def __init__(
        self, fold: str = "embedded", root: str | None = None, clock: TimeBase = "benchmark"
    ) -> None:
        """Find the shipped files; only ``fold`` matters: they lie in the package, and a step is 0.4 s."""
        super().__init__(fold, root, clock)
        self.folder = Path(str(files("pedzoo.data") / "embedded"))

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recording of a split."""
        return [Recording(Tracks.read(self.folder / f"plaza_{split}.csv"), self.folder / "plaza.yaml")]
