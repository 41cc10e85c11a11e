"""Sliding windows over recorded people, cut exactly as Social GAN cuts them, or keeping all people.

A window is a run of consecutive *distinct* frames of a file (holes in the frame numbers are not
looked at), one for every frame. Nothing is copied: a window is rows of the tracks table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.data.tracks import Tracks

KeptPeople = Literal["complete", "present"]


@dataclass(frozen=True)
class WindowCounts:
    """Windows and people kept and dropped, for the line that every run prints.

    Each person seen at the last observed step of a window is counted once for it, as one of ``people``,
    ``dropped_partial`` and ``dropped_lone``.

    Attributes:
        windows: Windows kept.
        people: People in them.
        dropped_partial: People not seen in enough of the window (see `cut_windows`).
        dropped_lone: People with too few others beside them.
    """

    windows: int = 0
    people: int = 0
    dropped_lone: int = 0
    dropped_partial: int = 0

    def __add__(self, other: WindowCounts) -> WindowCounts:
        """Return the counts of two recordings together."""
        return WindowCounts(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def __str__(self) -> str:
        """Return the line that every run prints."""
        return (
            f"{self.windows} windows with {self.people} people (counted once per window); left out: "
            f"{self.dropped_partial} seen only in part of a window, {self.dropped_lone} with too few others"
        )


@dataclass(frozen=True)
class Windows:
    """Windows of one recording.

    Attributes:
        rows: Rows of the tracks table (W, L) for each person of each window, -1 where they are not seen.
        end: The last row of that person's track (W,).
        offsets: Where each window's people start in ``rows`` (S + 1,).
        counts: Kept and dropped windows and people.
    """

    rows: np.ndarray
    end: np.ndarray
    offsets: np.ndarray
    counts: WindowCounts


def cut_windows(
    tracks: Tracks, obs_len: int, pred_len: int, people: KeptPeople = "complete", min_people: int = 2
) -> Windows:
    """Return all windows of ``obs_len + pred_len`` frames, stride 1, people sorted by number.

    ``people``: ``complete`` keeps people seen in all frames of a window (Social GAN), ``present`` those seen
    in the last observed frame and in one before it. A window with fewer than ``min_people`` is dropped (2 in
    Social GAN, whose own option says 1).
    """
    length = obs_len + pred_len
    frames, step = np.unique(tracks.frame, return_inverse=True)
    person = np.unique(tracks.agent, return_inverse=True)[1]
    start = step - (obs_len - 1)
    here = np.flatnonzero((start >= 0) & (start + length <= len(frames)))
    if people == "complete":
        # the table is sorted, so L rows of one person that span L steps have none missing
        first, last = here - (obs_len - 1), here + pred_len
        keep = (first >= 0) & (last < len(step))
        first, last = first[keep], last[keep]
        keep[keep] = (person[first] == person[last]) & (step[last] - step[first] == length - 1)
        rows = here[keep, None] + np.arange(-obs_len + 1, pred_len + 1)
    else:
        rows = _find_rows(person, step, here, obs_len, pred_len)
        keep = rows[:, obs_len - 2] >= 0
        rows = rows[keep]
    partial = len(here) - int(keep.sum())
    here = here[keep]
    window, size = np.unique(start[here], return_inverse=True, return_counts=True)[1:]
    alone = size[window] < min_people
    here, rows, window = here[~alone], rows[~alone], start[here][~alone]
    order = np.lexsort((person[here], window))
    sizes = np.unique(window, return_counts=True)[1]
    last = np.searchsorted(person, person[here[order]], side="right") - 1
    return Windows(
        rows=rows[order].astype(np.int32, copy=False),
        end=last.astype(np.int32),
        offsets=np.concatenate(([0], np.cumsum(sizes))).astype(np.int64),
        counts=WindowCounts(len(sizes), len(order), int(alone.sum()), partial),
    )


def _find_rows(
    person: np.ndarray, step: np.ndarray, here: np.ndarray, obs_len: int, pred_len: int
) -> np.ndarray:
    """Return the rows (W, L) around each of the rows ``here`` (W,), -1 where that person is not seen."""
    # key of (person, step): increasing over the table, so one search finds any person's row at any step
    key = person * (step.max(initial=0) + 1 + obs_len + pred_len) + step
    rows = np.empty((len(here), obs_len + pred_len), dtype=np.int32)
    for column in range(rows.shape[1]):  # one at a time: all at once would take eight times the memory
        wanted = key[here] + column - (obs_len - 1)
        index = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        rows[:, column] = np.where(key[index] == wanted, index, -1)
    return rows


def why_empty(
    recordings: Sequence[Tracks], obs_len: int, pred_len: int, people: KeptPeople, min_people: int
) -> UserError:
    """Return the error for recordings that give no window, with the reason and the way out."""
    length, steps = obs_len + pred_len, [len(np.unique(tracks.frame)) for tracks in recordings]
    recorded = ", ".join(
        f"{tracks.name!r} ({tracks.people} people, {n} steps)"
        for tracks, n in zip(recordings, steps, strict=True)
    )
    if max(steps) < length:
        return UserError(
            f"a window needs obs_len + pred_len = {obs_len} + {pred_len} = {length} steps, but "
            f"there is only {recorded}: record longer, or lower --data.obs_len or --data.pred_len"
        )
    advice = ["--data.keep_people present keeps partly seen people"] * (people == "complete")
    advice += ["--data.min_people 1 keeps lone people"] * (min_people > 1)
    part = "all" if people == "complete" else "enough"
    return UserError(
        f"no window of {length} steps has {min_people} people who are seen in {part} of it: {recorded}; "
        f"{', '.join(advice) or 'record more'}"
    )
