"""The interface of benchmarks, and their settings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from pedzoo.core.errors import UserError
from tools.bench.figures import Row
from tools.bench.turns import Clock, clock


class NotGivenError(UserError):
    """A benchmark needs something that was not given: it is skipped, unless it was asked for by name."""


@dataclass(frozen=True)
class Settings:
    """How a run measures.

    Attributes:
        seconds: Least time that one side works in one turn.
        turns: How often each side is timed.
        quick: Small cases only.
        threads: Of torch, and of peers.
        sizes: Scenes and people of each, in place of those that a section measures.
        maps: Floor plans, as `pedzoo.maps.plans.load_plan` takes them; none for those of the sections.
        peers: Scripts that time other programs, see `tools.bench.peer`.
        peer_python: The interpreter that runs them.
        sgan: Checkout of the original Social GAN.
        crowdnav: Checkout of CrowdNav, for the peer that runs its gym.
        data: Folder of the ETH/UCY recordings; the variable PEDZOO_DATA if not given.
    """

    seconds: float = 1.0
    turns: int = 5
    quick: bool = False
    threads: int = 1
    sizes: tuple[tuple[int, int], ...] = ()
    maps: tuple[str, ...] = ()
    peers: tuple[Path, ...] = ()
    peer_python: str = ""
    sgan: Path | None = None
    crowdnav: Path | None = None
    data: str | None = None

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            UserError: A number is out of range.
        """
        if not (self.seconds > 0 and self.turns >= 1 and self.threads >= 1):
            raise UserError(
                f"seconds {self.seconds}, turns {self.turns}, threads {self.threads}: expected above 0"
            )
        if any(number < 1 for size in self.sizes for number in size):
            raise UserError(f"sizes {self.sizes}: expected at least one scene and one person in it")

    @property
    def clock(self) -> Clock:
        """What time is measured with."""
        return clock(self.threads)


class Section(ABC):
    """A benchmark: a drop-in whose file and class have its name.

    Attributes:
        takes: Seconds that it took on two cores with ``--quick``, and with the usual turns of 1 s.
        settings: How to measure.
        versions: Of the other programs that took part, by name; filled while `rows` runs.
    """

    takes: ClassVar[tuple[float, float]] = (15.0, 60.0)

    def __init__(self, settings: Settings) -> None:
        """Take the settings."""
        self.settings = settings
        self.versions: dict[str, str] = {}

    @property
    def expected(self) -> float:
        """About how many seconds it takes with its settings, on the machine on which `takes` was measured."""
        quick, usual = self.takes
        return quick if self.settings.quick else usual * self.settings.seconds * self.settings.turns / 5

    @abstractmethod
    def rows(self) -> Iterator[Row]:
        """Measure, and give each row when it is known.

        Raises:
            NotGivenError: Something that it needs was not given.
        """
