"""Recorded people as one table: frame, agent, x, y."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pedzoo.core.errors import UserError
from pedzoo.core.size_limits import LONGEST_RECORDING, MOST_POSITIONS, check_limit
from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.columns import COLUMNS, PLAIN, Source
from pedzoo.data.file_forms import contents_of
from pedzoo.data.plausible import check_walks


@dataclass(frozen=True)
class Tracks:
    """One recording, sorted by agent, then by frame.

    Attributes:
        name: For messages: the recording's file stem.
        frame: Frame numbers (N,) int64.
        agent: Agent numbers (N,) int64.
        xy: Positions (N, 2) float64, metres in the world frame.
        source: What the file said of itself, with the seconds between its frame numbers; see `Source`.
    """

    name: str
    frame: np.ndarray
    agent: np.ndarray
    xy: np.ndarray
    source: Source = PLAIN

    @classmethod
    def from_table(
        cls, name: str, table: np.ndarray, place: Callable[[int], str] = lambda row: f"row {row + 1}"
    ) -> Tracks:
        """Return the tracks of rows (N, 4) of frame, agent, x, y in any order.

        Messages have the recording's ``name``, and ``place`` says where in its source a row is.

        Raises:
            UserError: No rows; a NaN or infinite value; a frame or agent that is not a whole number; an agent
                twice in a frame.
        """
        if len(table) == 0:
            raise UserError(f"recording {name!r} is empty: expected rows of {', '.join(COLUMNS)}")

        def refuse(row: int, why: str) -> UserError:
            values = " ".join(f"{value:g}" for value in table[row])
            return UserError(f"recording {name!r}, {place(row)} ({values}): {why}")

        bad = np.flatnonzero(~np.isfinite(table).all(1))
        if len(bad):
            raise refuse(int(bad[0]), "a value is not finite; leave out the rows of people who are not seen")
        whole = np.round(table[:, :2])
        bad = np.flatnonzero(((whole != table[:, :2]) | (np.abs(whole) > 2**53)).any(1))
        if len(bad):
            raise refuse(
                bad[0], "frame and agent must be whole numbers (of times in seconds: round(time / dt))"
            )
        order = np.lexsort((whole[:, 0], whole[:, 1]))
        frame, agent = whole[order].astype(np.int64).T
        twice = np.flatnonzero((np.diff(agent) == 0) & (np.diff(frame) == 0))
        if len(twice):
            i = int(twice[0]) + 1
            raise refuse(int(order[i]), f"agent {agent[i]} is twice in frame {frame[i]}; expected once")
        return cls(name, frame, agent, table[order, 2:])

    @classmethod
    def read(cls, path: str | Path) -> Tracks:
        """Return the tracks of a file: text in many forms, or SQLite of JuPedSim.

        Raises:
            UserError: No such file, text in a number's place, a missing column, or what `from_table` refuses.
        """
        path = Path(path)
        if not path.is_file():
            raise UserError(f"no recording at {str(path)!r}: expected a file of rows {', '.join(COLUMNS)}")
        try:
            table, place, source = contents_of(path)
        except UnicodeError as error:
            why = getattr(error, "reason", error)
            raise UserError(f"recording {str(path)!r} is not a text file in UTF-8 ({why})") from error
        return replace(cls.from_table(str(path), table, place), name=path.stem, source=source)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.frame)

    @property
    def people(self) -> int:
        """The number of agents."""
        return len(np.unique(self.agent))

    def through(self, homography: np.ndarray) -> Tracks:
        """Return the tracks with positions mapped by a homography (3, 3), image (x, y, 1) to world metres.

        Raises:
            UserError: It maps a position to infinity.
        """
        mapped = np.column_stack((self.xy, np.ones(len(self)))) @ homography.T
        if not mapped[:, 2].all():
            x, y = self.xy[np.flatnonzero(mapped[:, 2] == 0)[0]]
            raise UserError(f"the homography maps ({x:g}, {y:g}) of recording {self.name!r} to infinity")
        return replace(self, xy=mapped[:, :2] / mapped[:, 2:])

    def rounded(self, decimals: int) -> Tracks:
        """Return the tracks with positions rounded, as Social GAN does (4) when it loads a file."""
        return replace(self, xy=np.around(self.xy, decimals))

    def resampled(self, seconds_per_frame: float, step: float = STEP_SECONDS, option: str = "dt") -> Tracks:
        """Return the tracks at every ``step`` seconds; frame k is k x step after the recording's first row.

        Positions are interpolated linearly between two rows of an agent. Where an agent was not seen for
        more than two of their usual intervals (and more than one step), the track ends and continues under a
        new agent number, so that no rows are invented in a hole. Rows one step apart already stay bit-equal.

        Raises:
            UserError: It lasts longer than any recording, has more rows than are read, or nobody in it moves
                as people do, see `check_walks`; ``option`` is what has the seconds, for the message.
        """
        time = (self.frame - self.frame.min()) * seconds_per_frame
        what = f"recording {self.name!r} at {seconds_per_frame:g} s per frame number"
        remedy = "give the seconds between consecutive frame numbers (1e-9 for nanoseconds)"
        check_limit(time.max(), LONGEST_RECORDING, what, "seconds", remedy)
        gap, same = np.diff(time), np.diff(self.agent) == 0
        on_grid = np.round(time / step)
        if np.allclose(on_grid * step, time, rtol=0, atol=1e-6) and (np.diff(on_grid)[same] == 1).all():
            check_walks(self, seconds_per_frame, option)
            return replace(self, frame=on_grid.astype(np.int64), source=PLAIN)
        usual = np.median(gap[same]) if same.any() else step
        breaks = ~same | (gap > max(2 * usual, step) + 1e-6)
        piece = np.concatenate(([0], np.cumsum(breaks)))
        starts = np.flatnonzero(np.concatenate(([True], breaks)))
        ends = np.concatenate((starts[1:], [len(self)])) - 1
        first = np.ceil(time[starts] / step - 1e-6).astype(np.int64)
        count = np.maximum(np.floor(time[ends] / step + 1e-6).astype(np.int64) - first + 1, 0)
        remedy += ", or cut it in time"
        check_limit(count.sum(), MOST_POSITIONS, what, f"rows {step:g} s apart", remedy)
        check_walks(self, seconds_per_frame, option)
        of_piece = np.repeat(np.arange(len(starts)), count)
        frame = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[of_piece]
        wanted = np.clip(frame * step, time[starts][of_piece], time[ends][of_piece])
        # one interpolation for all people: an offset for each piece makes time increase over the whole table
        span = time.max() + step
        xy = np.column_stack(
            [np.interp(wanted + of_piece * span, time + piece * span, self.xy[:, axis]) for axis in (0, 1)]
        )
        agent = _piece_agents(self.agent[starts])[of_piece]
        order = np.lexsort((frame, agent))
        return Tracks(self.name, frame[order], agent[order], xy[order])


def _piece_agents(agent: np.ndarray) -> np.ndarray:
    """Return an agent number for each piece: the agent's own for the first, a fresh one for later pieces."""
    repeated = np.concatenate(([False], agent[1:] == agent[:-1]))
    numbers = agent.copy()
    numbers[repeated] = agent.max() + 1 + np.arange(repeated.sum())
    return numbers
