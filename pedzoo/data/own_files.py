"""People's own recordings: any files, cut in time into train, val and test, resampled to 0.4 s."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pedzoo.data.recordings import Recording, Split
from pedzoo.data.tracks import Tracks
from pedzoo.errors import UserError


class OwnFiles:
    """The recordings of ``--data.files``."""

    def __init__(
        self,
        files: list[str],
        dt: float | None,
        split: str = "0.7,0.15,0.15",
        plan: str | None = None,
        homography: str | None = None,
    ) -> None:
        """Check the settings.

        Args:
            files: Text or CSV files (see `pedzoo.data.tracks`).
            dt: Seconds between two consecutive frame numbers.
            split: Shares of the recorded time for train, val and test, in this order.
            plan: ROS yaml of the floor plan of all files.
            homography: Text file of a 3x3 matrix from the files' (x, y, 1) to world metres.
        """
        if dt is None or not dt > 0:
            raise UserError(
                f"--data.dt is {dt}: give the seconds between two consecutive frame numbers of --data.files "
                "(0.04 for a 25 Hz video whose frames are numbered one by one)"
            )
        self.files, self.dt, self.plan = files, dt, Path(plan) if plan else None
        self.shares = _shares(split)
        self.homography = _homography(homography) if homography else None

    def recordings(self, split: Split) -> list[Recording]:
        """Return the part of every file that belongs to a split, resampled to 0.4 s; empty parts are left out."""
        parts = [self._part(file, split) for file in self.files]
        return [Recording(part, self.plan) for part in parts if len(part)]

    def _part(self, file: str, split: Split) -> Tracks:
        tracks = Tracks.read(file)
        if self.homography is not None:
            tracks = tracks.through(self.homography)
        tracks = tracks.resampled(self.dt)
        if not len(tracks):
            raise UserError(
                f"recording {file!r} is shorter than one step of 0.4 s at --data.dt {self.dt}: is dt right?"
            )
        edges = tracks.frame.min() + np.cumsum((0.0, *self.shares)) * (np.ptp(tracks.frame) + 1)
        i = ("train", "val", "test").index(split)
        keep = (tracks.frame >= edges[i]) & (tracks.frame < edges[i + 1])
        return replace(tracks, frame=tracks.frame[keep], agent=tracks.agent[keep], xy=tracks.xy[keep])


def _shares(text: str) -> tuple[float, float, float]:
    try:
        train, val, test = (float(part) for part in text.split(","))
    except ValueError as error:
        raise UserError(f"--data.split {text!r}: expected three shares such as 0.7,0.15,0.15") from error
    if min(train, val, test) < 0 or not np.isclose(train + val + test, 1):
        raise UserError(f"--data.split {text!r} adds up to {train + val + test:g}: expected shares that add up to 1")
    return train, val, test


def _homography(path: str) -> np.ndarray:
    try:
        matrix = np.loadtxt(path)
    except (OSError, ValueError) as error:
        raise UserError(f"--data.homography {path!r}: {error}; expected a text file of 3 rows of 3 numbers") from error
    if matrix.shape != (3, 3):
        raise UserError(f"--data.homography {path!r} has shape {matrix.shape}: expected 3 rows of 3 numbers")
    return matrix
