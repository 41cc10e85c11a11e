"""Recordings of a split, each with its floor plan: those of a dataset file, and people's own."""

import inspect
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, cast

import numpy as np

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import DATASETS, datasets_of_folds, names_code
from pedzoo.core.spec import name_of
from pedzoo.core.types import STEP_SECONDS, TimeBase
from pedzoo.core.untrusted import LARGEST_CARD, read_text
from pedzoo.data.text_format import check_dt
from pedzoo.data.tracks import Tracks, check_walks, doubts, rows_apart, say
from pedzoo.maps.grid import OccupancyGrid, home_of
from pedzoo.maps.plans import load_plan

Split = Literal["train", "val", "test"]

OWN_FILES = "files"  # what the fold of people's own recordings is called in a protocol


@dataclass(frozen=True)
class Recording:
    """One recording.

    Attributes:
        tracks: Its people.
        plan: The floor plan: a file, as `load_plan` takes it, a drawn one, or None.
        weight: By how much it counts in trainings that draw from recordings, beside the root of its states.
    """

    tracks: Tracks
    plan: Path | OccupancyGrid | None = None
    weight: float = 1.0


def grids_of(recordings: Iterable[Recording]) -> dict[Path | OccupancyGrid, OccupancyGrid]:
    """Return the floor plans of recordings; every file is read once. Raises UserError: one is broken."""
    plans = dict.fromkeys(one.plan for one in recordings if one.plan is not None)
    return {plan: plan if isinstance(plan, OccupancyGrid) else load_plan(plan) for plan in plans}


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
        REPLAYED: False for folds that the suite ``replay`` leaves out unless they are named.
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


LARGEST = 20_000.0
"""Metres that a recording may extend; those that are larger are in pixels or in degrees times something."""


class OwnFiles:
    """The recordings of ``--data.files``, cut in time into train, val and test, resampled to 0.4 s."""

    def __init__(
        self,
        files: list[str],
        dt: float | None,
        split: str = "0.7,0.15,0.15",
        plan: str | None = None,
        homography: str | None = None,
        option: str = "--data.dt",
    ) -> None:
        """Check the settings, which are those of `TrajectoryDataModule`.

        ``plan`` is its ``map``, and ``option`` the one that has ``dt``.
        """
        check_dt(dt, option=option, files=files)
        if twice := [file for i, file in enumerate(files) if file in files[:i]]:
            raise UserError(f"files name {twice[0]!r} twice: its people would count twice; leave one out")
        self.files, self.dt, self.plan, self.option = files, dt, Path(plan) if plan else None, option
        try:
            train, val, test = (float(part) for part in split.split(","))
        except ValueError as error:
            raise UserError(f"--data.split {split!r}: expected three shares such as 0.7,0.15,0.15") from error
        if not (min(train, val, test) >= 0 and np.isclose(train + val + test, 1)):
            raise UserError(f"--data.split {split!r}: expected shares of at least 0 that add up to 1")
        self._ranges: dict[Split, tuple[float, float]]  # shares of the time, begin and end
        self._ranges = {"train": (0, train), "val": (train, train + val), "test": (train + val, 1)}
        self.homography = _homography(homography) if homography else None
        self._resampled: list[Tracks] = []

    def recordings(self, split: Split) -> list[Recording]:
        """Return the part of a split of every file. Raises UserError: one is refused, or all are empty."""
        self._resampled = self._resampled or [self._read(file) for file in self.files]
        parts, (begin, end) = [], self._ranges[split]
        for tracks in self._resampled:
            frame, steps = tracks.frame - tracks.frame.min(), np.ptp(tracks.frame) + 1
            keep = (frame >= begin * steps) & (frame < end * steps)
            part = replace(tracks, frame=tracks.frame[keep], agent=tracks.agent[keep], xy=tracks.xy[keep])
            parts.append(part)
        if not any(len(part) for part in parts):
            raise UserError(
                f"no person is recorded in the {split} part of {', '.join(self.files)}: it is the share "
                f"{end - begin:g} of the time; set --data.split (train,val,test)"
            )
        return [Recording(part, self.plan) for part in parts]

    def _read(self, file: str) -> Tracks:
        tracks = Tracks.read(file)
        seconds = self._seconds(tracks, file)
        if self.homography is not None:
            given = tracks.source.metres or 1.0  # it maps the numbers of the file
            tracks = tracks.through(self.homography @ np.diag((1 / given, 1 / given, 1.0)))
        elif not tracks.source.metres:
            raise UserError(
                f"recording {file!r} is in pixels: give --data.homography, which maps them to metres"
            )
        if (extent := np.ptp(tracks.xy, axis=0).max()) > LARGEST:
            raise UserError(
                f"recording {file!r} extends over {extent:g}, expected metres, at "
                f"most {LARGEST:g}: name columns by their unit (x_mm, y_mm), or give a homography to metres"
            )
        if (lasts := np.ptp(tracks.frame) * seconds) < STEP_SECONDS - 1e-6:
            raise UserError(
                f"recording {file!r} lasts {lasts:.3g} s at {self.option} {seconds:g}: is it right?"
            )
        resampled = tracks.resampled(seconds, option=self.option)
        for doubt in doubts(tracks, seconds, self.option):
            say(f"{file}: {doubt}")
        return resampled

    def _seconds(self, tracks: Tracks, file: str) -> float:
        """Return the seconds between two frame numbers of a file, and say what was found out of it."""
        source, dt, stated = tracks.source, self.dt, tracks.source.seconds
        if dt is None:
            check_dt(stated, file, self.option)
        elif source.timed and stated:
            apart = rows_apart(tracks) * stated
            if dt != 1 and not np.isclose(dt, apart, rtol=0.05):
                raise UserError(
                    f"recording {file!r} has times in seconds, rows {apart:.3g} s apart: leave out "
                    f"{self.option} {dt:g}"
                )
            dt = None
        seconds = cast("float", stated if dt is None else dt)
        unit = {0.0: "pixels", 1.0: "metres"}.get(source.metres, f"units of {source.metres:g} m")
        if source.timed:
            clock = "times in seconds"
        elif stated is None or dt is None:
            by = self.option if stated is None else "it says so"
            clock = f"{seconds:.4g} s between frame numbers ({by})"
        else:
            clock = f"{dt:g} s between frame numbers ({self.option}; it says {stated:.4g})"
        if source.form or stated or source.metres != 1:
            say(f"{file} read as {source.form or 'a table'}: {clock}, {unit}")
        return seconds


def _homography(path: str) -> np.ndarray:
    expected = "expected a text file of 3 rows of 3 numbers"
    try:
        with warnings.catch_warnings(action="ignore"):  # of an empty file
            matrix = np.loadtxt(read_text(Path(path), LARGEST_CARD).splitlines())
    except (OSError, ValueError) as error:
        raise UserError(f"--data.homography {path!r}: {error}; {expected}") from error
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise UserError(f"--data.homography {path!r} has shape {matrix.shape}: {expected}")
    if np.linalg.matrix_rank(matrix) < 3:
        raise UserError(f"--data.homography {path!r} is singular, it maps the floor to a line: {expected}")
    return matrix


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
