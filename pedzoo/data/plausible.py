"""Whether people in a recording move as people can: wrong seconds and wrong units show in their speed."""

from __future__ import annotations

import sys
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS

FASTEST = 4.0
"""m/s: people of whom half of all steps are faster are no pedestrians."""

FARTHEST = 0.8
"""Seconds between two rows of a person, at most: no more can be made between them."""

STANDS = 0.2
"""m/s: who is slower stands."""

_WALKS = 1.3
_SLOW, _FAST = 0.3, 2.5
"""m/s: crowds whose fast steps, or usual ones, are below or above these have other seconds, most likely."""

WALKED = 2.0
"""Metres: people who get so far do not stand."""

_NARROW = 0.1
"""Metres: two people need more room."""

_RATES = (60, 50, 30, 25, 15, 12.5, 10, 5, 2.5, 1.25)
"""Rows per second that most recordings have."""

_UNITS = {"centimetres": ("cm", 0.01), "millimetres": ("mm", 0.001), "feet": ("ft", 0.3048)}


class Rows(Protocol):
    """What is read here of `pedzoo.data.tracks.Tracks`: N rows, by agent and then by frame."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def agent(self) -> NDArray[np.int64]:
        """Numbers of agents (N,)."""
        ...

    @property
    def frame(self) -> NDArray[np.int64]:
        """Frame numbers (N,)."""
        ...

    @property
    def xy(self) -> NDArray[np.float64]:
        """Places (N, 2), metres."""
        ...

    def __len__(self) -> int: ...


def rows_apart(tracks: Rows) -> float:
    """Return the usual frame numbers between two rows of a person; NaN where nobody has two."""
    gap = np.diff(tracks.frame)[np.diff(tracks.agent) == 0]
    return float(np.median(gap)) if len(gap) else np.nan


def check_walks(tracks: Rows, seconds: float, option: str = "dt") -> None:
    """Refuse tracks of which nobody walks as people do.

    Args:
        tracks: Positions in metres.
        seconds: Between two frame numbers.
        option: The option that has them, for messages.

    Raises:
        UserError: Rows are more than 0.8 s apart, the median speed of steps above 0.2 m/s is above 4 m/s, or
            everybody is within 0.1 m. The message has what is likely right.
    """
    what, apart = f"recording {tracks.name!r}", rows_apart(tracks)
    moved = _speeds(tracks, seconds)
    usual = _usual(moved)
    likely = _likely(moved, apart, seconds)
    if apart * seconds > FARTHEST + 1e-6:
        remedy = f"{option} {likely:.3g} is likely" if likely else "record more rows"
        raise UserError(
            f"{what}: rows of a person are {apart:g} frame numbers apart, {apart * seconds:.3g} s with "
            f"{option} {seconds:.3g}, expected at most {FARTHEST:g} s: {remedy}"
        )
    if usual > FASTEST:
        unit = next((u for u in _UNITS if 0.5 < usual * _UNITS[u][1] < 2.5), None)
        turned = _swapped(tracks)
        remedies = [f"{option} {likely:.3g}"] if likely else []
        if unit:
            name, factor = _UNITS[unit]
            remedies += [f"{unit} (name the columns x_{name} and y_{name}, a factor of {factor:g})"]
        remedies += ["a first line that names the columns: they look like agent, frame, x, y"] * turned
        remedies += ["a homography from pixels to metres"]
        raise UserError(
            f"{what}: people move at {usual:.3g} m/s (median of those who move) with {option} {seconds:.3g}, "
            f"expected at most {FASTEST:g}: likely right are {', or '.join(remedies)}"
        )
    _check_extent(tracks, what)


def _check_extent(tracks: Rows, what: str) -> None:
    extent = float(np.ptp(tracks.xy, axis=0).max()) if len(tracks) else 0.0
    if not 0 < extent < _NARROW:
        return
    steps = np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1).sum()
    if len(np.unique(tracks.agent)) > 1 or steps < 3 * np.linalg.norm(tracks.xy[-1] - tracks.xy[0]):
        raise UserError(
            f"{what}: everybody is within {extent:.2g} m, expected metres: degrees and kilometres need a "
            "projection or a factor (--data.homography)"
        )


def doubts(tracks: Rows, seconds: float, option: str) -> list[str]:
    """Return what is unusual of tracks that `check_walks` takes: usual speeds, and single fast steps."""
    moved = _speeds(tracks, seconds)
    if not (moved > 0).any():
        return []
    result, far = [], distance(tracks)
    usual, high = _usual(moved), brisk(tracks, seconds)
    if usual > _FAST or (high < _SLOW and far > WALKED):
        how = (
            f"move at {usual:.2g} m/s"
            if usual > _FAST
            else f"get {far:.2g} m far at less than {high:.2g} m/s"
        )
        likely = _likely(moved, rows_apart(tracks), seconds)
        hint = f": is it {likely:.3g}?" if likely else ""
        result.append(f"people {how} with {option} {seconds:.3g}{hint}")
    if fast := int((moved > FASTEST).sum()):
        result.append(
            f"{fast} of {len(moved)} steps are faster than {FASTEST:g} m/s (up to {moved.max():.1f}): are "
            "these people on foot, each with one number?"
        )
    return result


@cache
def say(line: str) -> None:
    """Print a line about a file on stderr, once in a process."""
    print(f"pedzoo: {line}", file=sys.stderr)


def _swapped(tracks: Rows) -> bool:
    """Return whether frames and agents look as if they had changed places."""
    order = np.lexsort((tracks.agent, tracks.frame))
    same = np.diff(tracks.frame[order]) == 0
    if not same.any():
        return False
    swapped = np.linalg.norm(np.diff(tracks.xy[order], axis=0), axis=1)[same]
    own = np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1)[np.diff(tracks.agent) == 0]
    return bool(len(own) and np.median(swapped) < 0.5 * np.median(own))


def brisk(tracks: Rows, seconds: float) -> float:
    """Return the speed that a tenth of all steps exceed, 0 where nobody has two rows."""
    moved = _speeds(tracks, seconds)
    return float(np.percentile(moved, 90)) if len(moved) else 0.0


def _usual(moved: np.ndarray) -> float:
    """Return the median of the speeds of those who move."""
    return float(np.median(moved[moved > STANDS])) if (moved > STANDS).any() else 0.0


def distance(tracks: Rows) -> float:
    """Return how far half of all people get at least, from their first to their last place."""
    first = np.flatnonzero(np.diff(tracks.agent, prepend=tracks.agent[0] - 1))
    last = np.concatenate((first[1:], [len(tracks)])) - 1
    return float(np.median(np.linalg.norm(tracks.xy[last] - tracks.xy[first], axis=1)))


def _speeds(tracks: Rows, seconds: float) -> np.ndarray:
    """Return speeds (M,) over rows about 0.4 s apart, so that jitter of single rows does not count."""
    apart = rows_apart(tracks) * seconds
    rows = max(1, round(STEP_SECONDS / apart)) if apart > 0 else 1
    for many in (rows, 1):  # where nobody is seen so long, from row to row
        same = tracks.agent[many:] == tracks.agent[:-many]
        if same.any():
            moved = np.linalg.norm(tracks.xy[many:] - tracks.xy[:-many], axis=1)[same]
            return moved / ((tracks.frame[many:] - tracks.frame[:-many])[same] * seconds)
    return np.zeros(0)


def _likely(moved: np.ndarray, apart: float, seconds: float) -> float | None:
    """Return the seconds between frame numbers with which people walk as usual; None for no usual rate."""
    fast = moved[moved > 0.25 * np.percentile(moved, 75)] if len(moved) else moved
    if not len(fast) or not np.median(fast) > 0:
        return None
    between = apart * seconds * float(np.median(fast)) / _WALKS
    if not 1 / (1.3 * _RATES[0]) < between < 1.3 / _RATES[-1]:
        return None
    if abs(np.log(between / (apart * seconds))) < 0.3:  # they do so already
        return None
    if abs(np.log(between / seconds)) < 0.4 and np.isclose(1 / seconds, _RATES, rtol=0.01).any():
        return seconds / apart  # it was given from row to row
    return 1 / min(_RATES, key=lambda rate: abs(np.log(rate * between))) / apart
