"""Sliding windows over recorded people, cut exactly as Social GAN cuts them, or keeping everybody.

A window is a run of consecutive *distinct* frames of a file (holes in the frame numbers are not
looked at), one for every frame. Nothing is copied: a window is rows of the tracks table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pedzoo.data.tracks import Tracks
from pedzoo.errors import UserError

People = Literal["complete", "present"]


@dataclass(frozen=True)
class Counts:
    """Windows and people kept and dropped, for the line that every run prints."""

    windows: int = 0
    people: int = 0
    dropped_lone: int = 0
    dropped_partial: int = 0

    def __add__(self, other: Counts) -> Counts:
        """Return the counts of two recordings together."""
        return Counts(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def __str__(self) -> str:
        """Return the line that every run prints."""
        return (
            f"{self.windows} windows with {self.people} people; dropped {self.dropped_lone} alone in a window "
            f"and {self.dropped_partial} partly present"
        )


@dataclass(frozen=True)
class Windows:
    """Windows of one recording.

    Attributes:
        rows: Rows of the tracks table (W, L) for each person of each window, -1 where they are not seen.
        end: The last row of that person's track (W,).
        offsets: Where each window's people start in ``rows`` (S + 1,).
        counts: What was kept and dropped.
    """

    rows: np.ndarray
    end: np.ndarray
    offsets: np.ndarray
    counts: Counts


def cut_windows(
    tracks: Tracks, obs_len: int, pred_len: int, people: People = "complete", min_people: int = 2
) -> Windows:
    """Return all windows of ``obs_len + pred_len`` frames, stride 1, people sorted by number.

    Args:
        tracks: The recording.
        obs_len: Observed steps.
        pred_len: Predicted steps.
        people: ``complete`` keeps the people who are seen in all frames of a window (Social GAN);
            ``present`` keeps everybody who is seen in the last observed frame and in one before it.
        min_people: A window with fewer of them is dropped (2 in Social GAN, whose own option says 1).
    """
    length = obs_len + pred_len
    frames, step = np.unique(tracks.frame, return_inverse=True)
    person = np.unique(tracks.agent, return_inverse=True)[1]
    # key of (person, step): increasing over the table, so one search finds any person's row at any step
    key = person * (len(frames) + length) + step
    start = step - (obs_len - 1)
    here = np.flatnonzero((start >= 0) & (start + length <= len(frames)))
    wanted = key[here, None] + np.arange(length) - (obs_len - 1)
    rows = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
    rows[key[rows] != wanted] = -1
    keep = (rows >= 0).all(1) if people == "complete" else rows[:, obs_len - 2] >= 0
    partial = len(here) - int(keep.sum())
    here, rows = here[keep], rows[keep]
    window, size = np.unique(start[here], return_inverse=True, return_counts=True)[1:]
    alone = size[window] < min_people
    here, rows, window = here[~alone], rows[~alone], start[here][~alone]
    order = np.lexsort((person[here], window))
    sizes = np.unique(window, return_counts=True)[1]
    last = np.searchsorted(person, person[here[order]], side="right") - 1
    return Windows(
        rows=rows[order].astype(np.int32),
        end=last.astype(np.int32),
        offsets=np.concatenate(([0], np.cumsum(sizes))).astype(np.int64),
        counts=Counts(len(sizes), len(order), int(alone.sum()), partial),
    )


def why_empty(tracks: Tracks, obs_len: int, pred_len: int, people: People) -> UserError:
    """Return the error for a recording that gives no window, with the reason and the way out."""
    steps, length = len(np.unique(tracks.frame)), obs_len + pred_len
    if steps < length:
        return UserError(
            f"recording {tracks.name!r} has {steps} steps, but a window needs obs_len + pred_len = "
            f"{obs_len} + {pred_len} = {length}: record longer, or set --data.obs_len / --data.pred_len"
        )
    hint = "" if people == "present" else "; --data.people present --data.min_people 1 keeps lone and partly seen people"
    return UserError(
        f"recording {tracks.name!r} ({tracks.people} people, {steps} steps) has no window of {length} steps with "
        f"enough people{hint}"
    )
