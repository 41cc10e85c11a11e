"""Table II: total steps, goals per person and steps per goal from goal to goal, beside baselines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from pedzoo.core.types import STEP_SECONDS
from pedzoo.eval.results import ResultTable, cell
from pedzoo.eval.suites.scenes import CELLS
from tools.paper.base import Walked, interval_text
from tools.paper.published import DEFAULT_STEPS_PER_GOAL, IGIBSON_STEP, TABLE_2_GOALS, TABLE_2_STEPS
from tools.paper.suites import SPEEDS

STEPS = (IGIBSON_STEP, STEP_SECONDS)
"""Seconds of a step of iGibson, and of a decision of a learned model."""

PAPER = "the paper's model (one run; which step is not said)"


class Shown(NamedTuple):
    """A table of a metric, which is in seconds where it is shown ``in_steps``."""

    title: str
    key: str
    in_steps: bool = False


_TWO = "steps of 0.1 s, below of 0.4 s"
SHOWN = (
    Shown("episodes in which all people reach all goals in time", "episode_success"),
    Shown(f"total steps until all have, mean of these episodes ({_TWO})", "time_s", True),
    Shown(f"steps per goal in these ({_TWO}), and by the default of 100", "seconds_per_goal", True),
    Shown("goals per person, all episodes", "goals_per_person"),
    Shown("people who reach all goals in time", "success"),
    Shown("touches of others per person and minute", "agent_contacts_per_min"),
    Shown("touches of walls per person and minute", "wall_contacts_per_min"),
)


class Table2(Walked):
    """The five cells, n people with k goals each, at two speeds."""

    title = "Table II: from goal to goal"
    stem = "TABLE2"
    suites = ("table2",)
    models = ("sgan_goal_map.indoor", "sgan_goal_map.eth_ucy", "sgan_goal.eth_ucy")
    baselines = (
        *("go_to_goal", "orca:radius=0.2", "orca:radius=0.3", "orca:radius=0.5"),
        *("orca:preset=igibson,walls=false", "social_force:preset=indoor"),
    )

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        steps = " and ".join(f"{speed} m/s" for speed in SPEEDS)
        return [
            f"floor plans: {self.evaluation.units[0].case.shares} (of several every episode draws one)",
            f"speeds: {steps} (the first as people walk, N(1.3, 0.2); the second as in iGibson);"
            " a person who has reached all goals walks on to others until all have",
            "a step: iGibson's of 0.1 s, and 0.4 s, in which a learned model decides; the paper does not say"
            " which its steps are. Steps depend on building and speed: compare them within a table",
            "steps per goal: steps that all people walk by the goals that they reach, in episodes in which"
            " all people reach all goals in time; the paper's total steps by the goals that all reach"
            " at least (5 of 5/3, as it lists) are an upper bound of its own",
            "`orca:preset=igibson,walls=false` is iGibson's: radius 0.5, walls unseen. Where walls are seen"
            " such a disk fits through no door below 1 m (see FIGURE4.md)",
        ]

    def printed(self) -> dict[str, Any]:
        """Return what the paper has printed."""
        steps = {f"{people}/{goals}": number for (people, goals), number in TABLE_2_STEPS.items()}
        return {"total_steps": steps, "default_steps_per_goal": DEFAULT_STEPS_PER_GOAL}

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return each of `SHOWN` at both speeds: policies as rows, cells as columns."""
        return [self._page(report, speed, shown) for speed in SPEEDS for shown in SHOWN]

    def _page(self, report: Mapping[str, Any], speed: str, shown: Shown) -> ResultTable:
        printed = [_printed(shown.key, *cell) for cell in CELLS]
        body = [[PAPER, *printed]] if all(printed) else []
        columns = [
            self.case_rows(report, speed=speed, people=str(people), goals=str(goals))
            for people, goals in CELLS
        ]
        for name in dict.fromkeys(row["name"] for row in report["rows"]):
            body.append([name, *(_cell(column.get(name), shown) for column in columns)])
        head = ["people/goals", *(f"{people}/{goals}" for people, goals in CELLS)]
        return ResultTable(f"{speed} m/s: {shown.title}", head, body, 1)


def _cell(row: Mapping[str, Any] | None, shown: Shown) -> str:
    if row is None or shown.key not in row["metrics"]:
        return "-"
    if not shown.in_steps:
        return cell(row, shown.key)
    value, ends, lines = row["metrics"][shown.key], row["ci95"].get(shown.key, ()), []
    for step in STEPS:
        text = f"{value / step:.0f} {interval_text([end / step for end in ends], 0)}"
        share = f" ({value / step / DEFAULT_STEPS_PER_GOAL:.0%})"
        lines.append(text.strip() + share * (shown.key == "seconds_per_goal"))
    return "\n".join(lines)


def steps_per_goal_at_most(people: int, goals: int) -> float:
    """Return the paper's total steps by the goals that every person reaches at least: some reach more."""
    return TABLE_2_STEPS[people, goals] / TABLE_2_GOALS[people, goals]


def _printed(key: str, people: int, goals: int) -> str:
    """Return a cell of the paper's own row, '' for what it has not."""
    steps = steps_per_goal_at_most(people, goals)
    return {
        "time_s": str(TABLE_2_STEPS[people, goals]),
        "seconds_per_goal": f"at most {steps:.0f} ({steps / DEFAULT_STEPS_PER_GOAL:.0%})",
        "goals_per_person": f"at least {TABLE_2_GOALS[people, goals]}",
    }.get(key, "")
