"""The turns and the rows of ``before_after.py``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from tools.bench.figures import Measured, Row
from tools.bench.peer import PeerCase
from tools.bench.turns import in_turns, ratio

SIDES = ("before", "after")
SHARE = "safety layer's share of the steps"
UNHELD = ":safety=false"

ENVIRONMENT_BARS = {
    "torch": {"1 x 5": 2.5, "64 x 5": 3.0, "1024 x 5": 1.4},
    "compiled": {"1 x 5": 5.0, "64 x 5": 5.0, "1024 x 5": 3.0},
}
"""The least ratios that issue 19 asks of the bare environment, by physics and size."""

POLICY_BAR, CONTROLLER_BAR, SHARE_BAR = 1.5, 2.0, 25.0
POLICY_SIZE = "64 x 5"


class Timed(NamedTuple):
    """What one case did in its turns.

    Attributes:
        who: ``before``, ``after``, or a peer's name.
        case: What was timed.
        speeds: Agent-steps per second of each turn.
    """

    who: str
    case: PeerCase
    speeds: list[float]

    @property
    def size(self) -> str:
        """Scenes and agents of each, as tables have it."""
        return f"{self.case.scenes} x {self.case.people}"

    @property
    def title(self) -> str:
        """What messages call it."""
        physics = f" [{self.case.note}]" if self.who in SIDES and self.case.note else ""
        return f"{self.who}: {self.case.name}{physics}, {self.size}"

    @property
    def speed(self) -> Measured:
        """Agent-steps per second."""
        return Measured.of(self.speeds)

    @property
    def milliseconds(self) -> Measured:
        """Of one step of all scenes."""
        return Measured.of([1e3 * self.case.scenes * self.case.people / speed for speed in self.speeds])


def measure(
    cases: Sequence[tuple[str, PeerCase]], turns: int, seconds: float, tell: Callable[[str], None]
) -> tuple[list[Timed], dict[str, str]]:
    """Time cases in turns: all of one size take part in each turn, every second turn goes backwards.

    Args:
        cases: The side or peer of each case, and the case; ``before`` comes first.
        turns: How often each is timed.
        seconds: At least, in each turn.
        tell: Gets the number of the turn and what is timed.

    Returns:
        What was timed, and the errors of cases that are left out, by title.
    """
    every: list[Timed] = []
    failed: dict[str, str] = {}
    for size in dict.fromkeys((case.scenes, case.people) for _, case in cases):
        same = [Timed(who, case, []) for who, case in cases if (case.scenes, case.people) == size]
        # Sorting keeps the order of equal names: both sides of a comparison are neighbours.
        block = sorted(same, key=lambda one: ("" if one.who in SIDES else one.who, one.case.name))
        speeds = in_turns({one.title: one.case.side for one in block}, turns, seconds, tell, failed)
        every += [one._replace(speeds=speeds[one.title]) for one in block if one.title not in failed]
    return every, failed


def rows(timed: Sequence[Timed]) -> list[Row]:
    """Return rows: cases of the side ``after``, the safety layer's shares, and peers."""
    compared = [compare(one, timed) for one in timed if one.who == "after"]
    return [*compared, *shares(timed), *(peer(one) for one in timed if one.who not in SIDES)]


def compare(after: Timed, timed: Sequence[Timed]) -> Row:
    """Return a case beside the same one before: with the same physics, else with the first there is."""
    metrics = {"after_agent_steps_per_s": after.speed, "after_ms": after.milliseconds}
    rivals = [
        one
        for one in timed
        if one.who == "before" and (one.case.name, one.size) == (after.case.name, after.size)
    ]
    rivals.sort(key=lambda one: one.case.note != after.case.note)
    if rivals:
        before = rivals[0]
        metrics = {"before_agent_steps_per_s": before.speed, "before_ms": before.milliseconds, **metrics}
        metrics["times_before"] = ratio(after.speeds, before.speeds)
    case = {"size": after.size, "physics": after.case.note, "step_s": after.case.step_seconds}
    row = Row("before_after", after.case.name, case, metrics)
    bar = least(after)
    bars = [row.at_least("times_before", bar)] if bar and rivals else []
    return replace(row, bars=bars)


def least(after: Timed) -> float | None:
    """Return the ratio that is asked of a case; None where none is."""
    name = after.case.name
    if name == "env go_to_goal":
        return ENVIRONMENT_BARS.get(after.case.note, {}).get(after.size)
    if name.startswith("controller"):
        return CONTROLLER_BAR
    return POLICY_BAR if after.size == POLICY_SIZE and UNHELD not in name else None


def shares(timed: Sequence[Timed]) -> list[Row]:
    """Return which share of its steps a policy with a safety layer spends there: 1 - with / without."""
    result: dict[str, dict[str, Measured]] = {}
    for held in timed:
        for free in timed:
            if (free.who, free.case.name, free.size) == (held.who, held.case.name + UNHELD, held.size):
                pairs = zip(held.speeds, free.speeds, strict=True)
                percent = [100 * (1 - with_it / without) for with_it, without in pairs]
                result.setdefault(held.size, {})[f"{held.who}_percent"] = Measured.of(percent)
    rows = [Row("before_after", SHARE, {"size": size}, metrics) for size, metrics in result.items()]
    return [
        replace(row, bars=[row.below("after_percent", SHARE_BAR)] if "after_percent" in row.metrics else [])
        for row in rows
    ]


def peer(one: Timed) -> Row:
    """Return the row of another program."""
    metrics = {"agent_steps_per_s": one.speed, "step_ms": one.milliseconds}
    case = {"size": one.size, "step_s": one.case.step_seconds}
    return Row("peer", one.case.title, case, metrics, (), one.case.note)
