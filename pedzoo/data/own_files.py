"""People's own recordings: any files, cut in time into train, val and test, resampled to 0.4 s."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.core.size_limits import LARGEST_CARD, read_text
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.recordings import Recording, Split
from pedzoo.data.text_format import check_dt
from pedzoo.data.tracks import Tracks, doubts, rows_apart, say

LARGEST = 20_000.0
"""Metres that a recording may extend; those that are larger are in pixels or in degrees times something."""


class OwnFiles:
    """The recordings of ``--data.files``."""

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
