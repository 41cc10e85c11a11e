"""The turns and the table of ``before_after.py``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from pedzoo.bench.figures import Measured, Row, Verdict
from pedzoo.bench.peer import PeerCase
from pedzoo.bench.turns import ratio
from pedzoo.errors import UserError

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
WIDTH = 200
"""Columns of the table where the terminal has fewer."""


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
        for turn in range(turns):
            for one in reversed(block) if turn % 2 else block:
                if one.title in failed:
                    continue
                tell(f"turn {turn + 1} of {turns}, {one.title}")
                try:
                    one.speeds.append(one.case.side(seconds))
                except UserError as error:
                    failed[one.title] = str(error)
                    tell(f"{one.title}: {error}")
        every += [one for one in block if one.title not in failed]
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
    return Row(row.section, row.name, row.case, metrics, bars)


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
    found: dict[str, dict[str, Measured]] = {}
    for held in timed:
        for free in timed:
            if (free.who, free.case.name, free.size) == (held.who, held.case.name + UNHELD, held.size):
                pairs = zip(held.speeds, free.speeds, strict=True)
                percent = [100 * (1 - with_it / without) for with_it, without in pairs]
                found.setdefault(held.size, {})[f"{held.who}_percent"] = Measured.of(percent)
    return [
        Row("before_after", SHARE, {"size": size}, metrics, bars)
        for size, metrics in found.items()
        for row in [Row("before_after", SHARE, {"size": size}, metrics)]
        for bars in [[row.below("after_percent", SHARE_BAR)] if "after_percent" in metrics else []]
    ]


def peer(one: Timed) -> Row:
    """Return the row of another program."""
    metrics = {"agent_steps_per_s": one.speed, "step_ms": one.milliseconds}
    case = {"size": one.size, "step_s": one.case.step_seconds}
    return Row("peer", one.case.title, case, metrics, (), one.case.note)


def print_rows(found: Sequence[Row], report: dict[str, Any]) -> None:
    """Print tables of both sides and of the peers, and what the numbers mean."""
    console, protocol = Console(), report["protocol"]
    console.width = max(console.width, WIDTH)  # a cell that is cut would say nothing
    table = Table(title=f"{protocol['before']} (before) and {protocol['after']} (after)", box=SIMPLE)
    for column in ("", "size", "physics", "before/s", "after/s", "before ms", "after ms", "ratio", "bar"):
        table.add_column(
            column, justify="left" if column in ("", "physics", "bar") else "right", no_wrap=True
        )
    for row in found:
        if row.section == "before_after":
            unit = "percent" if row.name == SHARE else "agent_steps_per_s"
            cells = [f"{side}_{metric}" for metric in (unit, "ms") for side in SIDES]
            told = [text(row.metrics.get(cell), cell) for cell in (*cells, "times_before")]
            case = row.case
            table.add_row(row.name, case["size"], case.get("physics", ""), *told, verdict(row.bars))
    console.print(table)
    others, notes = Table(title="peers", box=SIMPLE), {}
    for column in ("program", "size", "agent-steps/s", "ms", "step s"):
        others.add_column(column, justify="left" if column == "program" else "right", no_wrap=True)
    for row in found:
        if row.section == "peer":
            told = [text(row.metrics[metric], metric) for metric in ("agent_steps_per_s", "step_ms")]
            others.add_row(row.name, row.case["size"], *told, f"{row.case['step_s']:g}")
            notes[row.name] = row.note
    if notes:
        console.print(others)
    lines = [f"{name}: {note}" for name, note in notes.items()]
    lines += [
        f"Agent-steps per second on one thread: medians of {protocol['turns']} turns of at least "
        f"{protocol['seconds_per_turn']:g} s, {protocol['clock']}; in brackets: quartiles."
    ]
    lines += [f"left out: {title}: {why}" for title, why in report["failed"].items()]
    print("\n".join(lines))


def text(value: Measured | None, metric: str) -> str:
    """Return a value with its quartiles, as a table has it."""
    if value is None:
        return ""
    if metric.endswith("_per_s"):
        return f"{value.value:,.0f} [{value.low:,.0f}-{value.high:,.0f}]"
    if metric.endswith("percent"):
        return f"{value.value:.0f} % [{value.low:.0f}-{value.high:.0f}]"
    if metric.startswith("times"):
        return f"{value.value:.2f} [{value.low:.2f}-{value.high:.2f}]"
    return f"{value.value:.3g}"


def verdict(bars: Sequence[Verdict]) -> str:
    """Return what was asked for and whether it is so."""
    return "; ".join(str(bar).replace("times_before ", "").replace("after_percent ", "") for bar in bars)
