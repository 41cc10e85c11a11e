"""What a dataset file gives: recordings of a split, each with its floor plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from pedzoo.core.errors import unknown
from pedzoo.core.registry import DATASETS
from pedzoo.core.types import TimeBase
from pedzoo.data.tracks import Tracks

Split = Literal["train", "val", "test"]


@dataclass(frozen=True)
class Recording:
    """One recording and its floor plan (`pedzoo.maps.library.load_plan`), None where it has none."""

    tracks: Tracks
    plan: Path | None = None


class Dataset(Protocol):
    """What a file in ``pedzoo/data/datasets`` provides; its module lists its ``FOLDS``."""

    def __init__(self, fold: str, root: str | None, clock: TimeBase) -> None:
        """Find the fold's files below ``root``."""
        ...

    def recordings(self, split: Split) -> list[Recording]:
        """Return the recordings of a split."""
        ...


def folds() -> dict[str, str]:
    """Return all folds and the dataset that each belongs to, without importing any."""
    return {fold: name for name in DATASETS.names() for fold in DATASETS.constant(name, "FOLDS") or ()}


def open_fold(fold: str, root: str | None, clock: TimeBase) -> Dataset:
    """Return the dataset that has ``fold``, or the plugin ``path/to/file.py:Class``.

    Raises:
        UserError: No dataset has it.
    """
    known = folds()
    if fold not in known and ".py:" not in fold:
        raise unknown("fold", fold, known)
    return DATASETS.get(known.get(fold, fold))(fold, root, clock)
