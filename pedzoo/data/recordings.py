"""The contents of a dataset file: recordings of a split, each with its floor plan, and its description."""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import DATASETS, datasets_of_folds, names_code
from pedzoo.core.spec import name_of
from pedzoo.core.types import STEP_SECONDS, TimeBase
from pedzoo.data.tracks import Tracks, check_walks, rows_apart
from pedzoo.maps.grid import OccupancyGrid, home_of

Split = Literal["train", "val", "test"]

OWN_FILES = "files"  # what the fold of people's own recordings is called in a protocol


@dataclass(frozen=True)
class Recording:
    """One recording and its floor plan (`pedzoo.maps.plans.load_plan`), None where it has none."""

    tracks: Tracks
    plan: Path | None = None


class Scene(NamedTuple):
    """The tracks of a recording and its floor plan, both in a frame that has them near its origin."""

    tracks: Tracks
    grid: OccupancyGrid | None  # the floor plan, None where there is none
    home: np.ndarray  # where that origin is in the recording's own frame (2,), metres

    @classmethod
    def of(cls, tracks: Tracks, grid: OccupancyGrid | None) -> "Scene":
        """Return the scene of tracks and a floor plan: from here on single precision is enough."""
        home = np.zeros(2)
        if grid is not None:
            home = grid.home
        elif len(tracks):
            home = home_of((tracks.xy.min(0) + tracks.xy.max(0)) / 2)
        moved = replace(tracks, xy=tracks.xy - home) if home.any() else tracks
        return cls(moved, grid and grid.at_home(), home)


class Dataset(ABC):
    """What a dataset's class has. Its constants are read without importing it: they must be literals.

    A class with the same methods need not inherit from this.

    Attributes:
        FOLDS: Names of folds, each with its tested recordings, which its training leaves out. With none of
            them the fold trains on everything.
        ALWAYS_TRAINED: Recordings that no fold leaves out.
        SOURCE: Description and origin of the recordings, for cards.
        TERMS: Terms of their use, likewise.
        PLAN_TERMS: Addition to the terms for models that see the floor plans.
        CITATION: Publications to cite, likewise.
        REPLAY_SHARE: For crowded folds, the first share of the time whose people the suite ``replay``
            simulates, each in a scene of their own.
    """

    FOLDS: ClassVar[Mapping[str, Sequence[str]]]

    def __init__(self, fold: str, root: str | None, clock: TimeBase) -> None:
        """Take the fold; a dataset of files looks for them here. Raises UserError: there are none.

        Args:
            fold: One of ``FOLDS``.
            root: Folder of all recordings, as given by ``--data.root``.
            clock: Whether annotated steps count as 0.4 s, or positions are resampled to a real 0.4 s.
        """
        self.fold, self.root, self.clock = fold, root, clock

    @abstractmethod
    def recordings(self, split: Split) -> Sequence[Recording]:
        """Return the recordings of a split."""


class OpenFold:
    """A fold of a dataset whose class may be a user's: what it returns is checked."""

    def __init__(self, cls: type, fold: str, root: str | None, clock: TimeBase) -> None:
        """Open a fold of a dataset's class. Raises UserError: that lacks something, or finds no files."""
        self._name = cls.__name__
        method = getattr(cls, "recordings", None)
        if method is None or getattr(method, "__isabstractmethod__", False):
            raise UserError(
                f"dataset {self._name} has no method recordings(self, split), with split 'train', 'val' or "
                f"'test': {_EXPECTED}"
            )
        for call, given, means in (
            (cls, (fold, root, clock), f"{self._name}(fold, root, clock)"),
            (method, (self, "test"), "recordings(self, split)"),
        ):
            try:
                inspect.signature(call).bind(*given)
            except TypeError as error:
                raise UserError(f"dataset {self._name}: expected {means}: {error}") from error
        self._dataset = cls(fold, root, clock)

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recordings of a split. Raises UserError: these are none, or no walks of people."""
        result = self._dataset.recordings(split)
        if not isinstance(result, list | tuple) or not all(
            isinstance(one, Recording) and isinstance(one.tracks, Tracks) for one in result
        ):
            raise UserError(f"{self._name}.recordings({split!r}) returned {result!r:.60}: {_EXPECTED}")
        for one in result:
            if (apart := rows_apart(one.tracks)) > 0:
                check_walks(one.tracks, STEP_SECONDS / apart)
        return list(result)


_EXPECTED = "it has to return a list of pedzoo.data.recordings.Recording(Tracks.read(file), plan=None)"


class Fold(NamedTuple):
    """A fold by its dataset's name, or ``path/to/file.py:Class``, and its own name."""

    dataset: str  # as `DATASETS` takes it
    name: str  # one of the dataset's ``FOLDS``; that of the class where it declares none

    def constant(self, name: str, default: Any) -> Any:
        """Return a constant of the dataset's class, see `Dataset`."""
        value = DATASETS.constant(self.dataset, name)
        return default if value is None else value

    @property
    def tested(self) -> list[str] | None:
        """The recordings that the fold is tested on; None where the dataset does not say it."""
        tested = self.constant("FOLDS", {}).get(self.name)
        return None if tested is None else list(tested)

    @property
    def whole(self) -> bool:
        """Whether the fold leaves no recording out, so that there is none to test on."""
        return self.tested == []

    @property
    def trained(self) -> list[str]:
        """The recordings that a training on the fold sees, in alphabetical order."""
        others = [names for fold, names in self.constant("FOLDS", {}).items() if fold != self.name]
        return sorted({*(name for names in others for name in names), *self.constant("ALWAYS_TRAINED", ())})


def find_fold(text: str | None) -> Fold | None:
    """Return the fold behind ``zara1`` or ``path/to/file.py:Class:fold``, None where there is no such fold.

    Without a name behind the class it is the first of its folds. Nothing is imported.
    """
    if text is None:
        return None
    if not names_code(text):
        known = datasets_of_folds()
        return Fold(known[text], text) if text in known else None
    dataset = name_of(text)
    folds = list(DATASETS.constant(dataset, "FOLDS") or [dataset.rpartition(":")[2]])
    name = text.removeprefix(dataset).removeprefix(":") or folds[0]
    return Fold(dataset, name) if name in folds else None


def open_fold(fold: str, root: str | None, clock: TimeBase) -> OpenFold:
    """Return a fold, as `find_fold` takes it.

    Raises:
        UserError: No dataset has it, or the dataset's class lacks something or does not find its files.
    """
    if fold == OWN_FILES:
        raise UserError(
            f"fold {fold!r} stands for recordings from files that weights were trained on: name "
            "files, --data.files a.csv,b.csv --data.dt 0.1, or a fold, --data.fold zara1"
        )
    if result := find_fold(fold):
        return OpenFold(DATASETS.get(result.dataset), result.name, root, clock)
    dataset = name_of(fold) if names_code(fold) else ""
    datasets, kind = ([dataset], f"fold of {dataset}") if dataset else (DATASETS.names(), "fold")
    known = [name for one in datasets for name in DATASETS.constant(one, "FOLDS") or ()]
    raise unknown(kind, fold.removeprefix(dataset).removeprefix(":"), known)


_FREE, _NO_TRADE = "MIT, as pedzoo", "CC BY-NC 4.0"
"""Terms of recordings that pedzoo made itself, and of masks that floor plans were drawn from."""


def provenance(fold: str | None, files: Sequence[str] | None = None, plans: bool = False) -> dict[str, Any]:
    """Return ``recordings``, ``source``, ``terms`` and ``citation`` of what a model was trained on.

    The dataset's class says them, see `Dataset`; its file is not run. ``plans``: it reads floor plans, too.
    """
    known = None if files else find_fold(fold)
    source = "recordings of one's own" if files else f"dataset {fold or 'unknown'}"
    recordings = [Path(file).name for file in files or ()]
    terms, citation = "unknown to pedzoo: ask who recorded them", "unknown to pedzoo"
    if known:
        recordings = known.trained
        source, citation = known.constant("SOURCE", source), known.constant("CITATION", citation)
        terms = known.constant("TERMS", terms) + known.constant("PLAN_TERMS", "") * plans
    return {"recordings": recordings, "source": source, "terms": terms, "citation": citation}


def licence(terms: str) -> str:
    """Return the licence of weights by the terms of what they were trained on."""
    if terms.replace(_FREE, "").strip("; ") == "":
        return "MIT"
    return "terms of the recordings" + f" and {_NO_TRADE}" * (_NO_TRADE in terms)


def together(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return what is said of a model that was trained on the data of both, one after the other."""
    texts = {key: "; ".join(dict.fromkeys((other[key], one[key]))) for key in ("source", "terms", "citation")}
    return {"recordings": sorted({*one["recordings"], *other["recordings"]}), **texts}
