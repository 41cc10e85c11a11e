"""How jobs are handed out to workers. Without heavy imports: a Ray cluster gives it a process of its own."""

from __future__ import annotations

from collections.abc import Hashable, MutableSequence, Sequence
from contextlib import AbstractContextManager
from typing import Any


class Shares:
    """Which job a worker does next: nobody waits while there is work, and jobs of a group stay together.

    A worker goes on with its group. When that is finished it begins the first group that nobody has
    begun, and when there is none it helps with the one that has most left: it then prepares once more what
    the group shares, which is better than watching.
    """

    def __init__(
        self, groups: Sequence[Sequence[int]], begun: MutableSequence[int], lock: AbstractContextManager[Any]
    ) -> None:
        """Hand out the jobs of ``groups``.

        Args:
            groups: Numbers of the jobs of each group.
            begun: How many of each group have been handed out; shared by those who take, all 0 at first.
            lock: Held while one of them takes.
        """
        self.groups = groups
        self.begun = begun
        self.lock = lock

    def take(self, group: int | None) -> tuple[int, int] | None:
        """Return the next job of a worker whose last one was of ``group``, and the job's group.

        Returns:
            None where all have been handed out.
        """
        with self.lock:
            left = [len(jobs) - begun for jobs, begun in zip(self.groups, self.begun, strict=True)]
            if group is None or not left[group]:
                untouched = (number for number, begun in enumerate(self.begun) if not begun)
                group = next(untouched, max(range(len(left)), key=left.__getitem__))
            if not left[group]:
                return None
            self.begun[group] += 1
            return self.groups[group][self.begun[group] - 1], group


def grouped(keys: Sequence[Hashable]) -> list[list[int]]:
    """Return the numbers of the jobs of each key, in the order in which the keys are first seen."""
    groups: dict[Hashable, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return list(groups.values())
