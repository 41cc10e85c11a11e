"""Recorded people as one table: frame, agent, x, y.

Two text forms are read: Social GAN's (no header, whitespace, ``frame ped x y``) and CSV with a header
that names at least ``frame``, ``agent``, ``x`` and ``y`` in any order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pedzoo.errors import UserError
from pedzoo.types import STEP_SECONDS

COLUMNS = ("frame", "agent", "x", "y")
ALIASES = {"agent": ("agent", "ped", "id", "track_id"), "frame": ("frame", "frame_id")}


@dataclass(frozen=True)
class Tracks:
    """One recording, sorted by agent, then by frame.

    Attributes:
        name: For messages: the recording's file stem.
        frame: Frame numbers (N,) int64.
        agent: Agent numbers (N,) int64.
        xy: Positions (N, 2) float64, metres in the world frame.
    """

    name: str
    frame: np.ndarray
    agent: np.ndarray
    xy: np.ndarray

    @classmethod
    def from_table(cls, name: str, table: np.ndarray) -> Tracks:
        """Return the tracks of rows (N, 4) of frame, agent, x, y in any order.

        Raises:
            UserError: No rows; a NaN or infinite value; a frame or agent that is not a whole number; an
                agent twice in a frame.
        """
        if len(table) == 0:
            raise UserError(f"recording {name!r} is empty: expected rows of {', '.join(COLUMNS)}")
        bad = np.flatnonzero(~np.isfinite(table).all(1))
        if len(bad):
            raise UserError(
                f"recording {name!r}, row {bad[0] + 1}: {_row(table[bad[0]])} has a value that is not finite; "
                "leave out the rows of people who are not seen"
            )
        whole = np.round(table[:, :2])
        bad = np.flatnonzero((whole != table[:, :2]).any(1))
        if len(bad):
            raise UserError(
                f"recording {name!r}, row {bad[0] + 1}: {_row(table[bad[0]])}: "
                "frame and agent must be whole numbers (columns: frame, agent, x, y)"
            )
        order = np.lexsort((whole[:, 0], whole[:, 1]))
        frame, agent = whole[order].astype(np.int64).T
        twice = np.flatnonzero((np.diff(agent) == 0) & (np.diff(frame) == 0))
        if len(twice):
            i = twice[0]
            raise UserError(
                f"recording {name!r}: agent {agent[i]} is twice in frame {frame[i]}; every (frame, agent) may occur once"
            )
        return cls(name, frame, agent, table[order, 2:])

    @classmethod
    def read(cls, path: str | Path) -> Tracks:
        """Return the tracks of a text file in either form.

        Raises:
            UserError: No such file, text in a number's place, a missing column, or what `from_table` refuses.
        """
        path = Path(path)
        if not path.is_file():
            raise UserError(f"no recording at {str(path)!r}: expected a file of rows frame, agent, x, y")
        with path.open() as file:
            head = file.readline()
        options = _csv_options(path, head) if any(c.isalpha() for c in head.lower().replace("e", "")) else {}
        if not head.strip():
            raise UserError(f"recording {str(path)!r} is empty: expected rows of {', '.join(COLUMNS)}")
        try:
            table = np.loadtxt(path, ndmin=2, **options)
        except ValueError as error:
            raise UserError(f"recording {str(path)!r}: {error} (expected numbers: {', '.join(COLUMNS)})") from error
        if table.size and table.shape[1] != 4:
            raise UserError(
                f"recording {str(path)!r} has {table.shape[1]} columns: expected the 4 of frame, agent, x, y, "
                "or a CSV whose header names them"
            )
        return cls.from_table(path.stem, table)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.frame)

    @property
    def people(self) -> int:
        """The number of agents."""
        return len(np.unique(self.agent))

    def through(self, homography: np.ndarray) -> Tracks:
        """Return the tracks with positions mapped by a homography (3, 3), image (x, y, 1) to world metres."""
        mapped = np.column_stack((self.xy, np.ones(len(self)))) @ homography.T
        return replace(self, xy=mapped[:, :2] / mapped[:, 2:])

    def rounded(self, decimals: int) -> Tracks:
        """Return the tracks with positions rounded, as Social GAN does (4) when it loads a file."""
        return replace(self, xy=np.around(self.xy, decimals))

    def resampled(self, seconds_per_frame: float, step: float = STEP_SECONDS) -> Tracks:
        """Return the tracks at every ``step`` seconds of real time; frame k is the time k x step.

        Positions are interpolated linearly between two rows of an agent. Where an agent was not seen for
        more than two of their usual intervals (and more than one step), the track ends there and goes on
        under a new agent number, so that nobody is invented in a hole.
        """
        time = self.frame * seconds_per_frame
        if np.array_equal(np.round(time / step), time / step) and len(np.unique(np.diff(np.unique(time)))) <= 1:
            return replace(self, frame=np.round(time / step).astype(np.int64))
        gap, same = np.diff(time), np.diff(self.agent) == 0
        usual = np.median(gap[same]) if same.any() else step
        breaks = ~same | (gap > max(2 * usual, step) + 1e-9)
        piece = np.concatenate(([0], np.cumsum(breaks)))
        starts = np.flatnonzero(np.concatenate(([True], breaks)))
        ends = np.concatenate((starts[1:], [len(self)])) - 1
        first = np.ceil(time[starts] / step - 1e-6).astype(np.int64)
        count = np.maximum(np.floor(time[ends] / step + 1e-6).astype(np.int64) - first + 1, 0)
        of_piece = np.repeat(np.arange(len(starts)), count)
        frame = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[of_piece]
        # one searchsorted for all people: time is made increasing over the table by an offset for each piece
        span = time.max() - time.min() + 2 * step
        known, wanted = time + piece * span, frame * step + of_piece * span
        xy = np.column_stack([np.interp(wanted, known, self.xy[:, axis]) for axis in (0, 1)])
        return Tracks(self.name, frame, _piece_agents(self.agent[starts])[of_piece], xy)


def _piece_agents(agent: np.ndarray) -> np.ndarray:
    """Return an agent number for each piece: the agent's own for the first, a fresh one for later pieces."""
    repeated = np.concatenate(([False], agent[1:] == agent[:-1]))
    numbers = agent.copy()
    numbers[repeated] = agent.max() + 1 + np.arange(repeated.sum())
    return numbers


def _csv_options(path: Path, head: str) -> dict:
    names = [name.strip().strip('"').lower() for name in head.split(",")]
    columns = []
    for column in COLUMNS:
        found = [names.index(alias) for alias in ALIASES.get(column, (column,)) if alias in names]
        if not found:
            raise UserError(
                f"recording {str(path)!r} has no column {column!r}: its header is {head.strip()!r}, "
                f"expected {','.join(COLUMNS)} (any order, more columns are ignored)"
            )
        columns.append(found[0])
    return {"delimiter": ",", "skiprows": 1, "usecols": columns}


def _row(values: np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in values)
