"""Table II: the paper's method as the paper ran it, then ours: what each change does, beside rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.eval.results import ResultTable, cell
from pedzoo.eval.suites.scenes import CELLS
from tools.paper.base import Walked, interval_text
from tools.paper.method import CHANGES, NOTES, PAPERS_WORLD, WORLDS
from tools.paper.published import DEFAULT_STEPS_PER_GOAL, IGIBSON_STEP, TABLE_2_PARITY, TABLE_2_STEPS
from tools.paper.suites import SPEEDS

STEPS = (IGIBSON_STEP, STEP_SECONDS)
"""Seconds of a step of iGibson, and of a decision of a learned model."""

PRINTED = "the paper's model (one run; which step is not said)"


class Shown(NamedTuple):
    """A table of a metric, which is in seconds where it is shown ``in_steps``."""

    title: str
    key: str
    in_steps: bool = False


_TWO = "steps of 0.1 s, below of 0.4 s"
SHOWN = (
    Shown("people who reach all goals in time", "success"),
    Shown("episodes in which all people reach all goals in time", "episode_success"),
    Shown(f"total steps until all have, mean of these episodes ({_TWO})", "time_s", True),
    Shown(f"steps per goal in these ({_TWO}), and by the default of 100", "seconds_per_goal", True),
    Shown("goals per person, all episodes", "goals_per_person"),
    Shown("touches of walls per person and minute", "wall_contacts_per_min"),
    Shown("touches of others per person and minute", "agent_contacts_per_min"),
)
MEANS = {
    "people who reach all goals": "success",
    "episodes in which all do": "episode_success",
    "touches of walls per person and minute": "wall_contacts_per_min",
    "touches of people": "agent_contacts_per_min",
}
"""Columns of the tables that compare changes."""


class Table2(Walked):
    """The five cells, n people with k goals each, at two speeds."""

    title = "Table II: from goal to goal"
    stem = "TABLE2"
    suites = ("table2",)
    models = tuple(CHANGES)
    baselines = (
        *("go_to_goal", "orca:radius=0.2", "orca:radius=0.3", "orca:radius=0.5"),
        *("orca:preset=igibson,walls=false", "social_force:preset=indoor"),
    )

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        steps = " and ".join(f"{speed} m/s" for speed in SPEEDS)
        return [
            *NOTES,
            "total steps and parity (`person: goals reached`) are of one run, as in the paper: of all runs of"
            " a cell the middle one by total steps, unfinished ones last. Other columns are of all runs",
            f"floor plans: {self.evaluation.units[0].case.shares} (of several every episode draws one)",
            f"speeds: {steps} (the first as in iGibson; the second as people walk, N(1.3, 0.2));"
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
        steps, parity = (
            {f"{people}/{goals}": value for (people, goals), value in table.items()}
            for table in (TABLE_2_STEPS, TABLE_2_PARITY)
        )
        return {"total_steps": steps, "parity": parity, "default_steps_per_goal": DEFAULT_STEPS_PER_GOAL}

    def kept(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the report keeps of a row: of what each person did, one run."""
        return super().kept(row) | {"run": middle_run(row["per_agent"])}

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the paper's table, what each change does, and each of `SHOWN` at both speeds."""
        first = [self._papers(report), *(self._changes(report, speed) for speed in SPEEDS)]
        result = [*first, *(self._page(report, speed, shown) for speed in SPEEDS for shown in SHOWN)]
        return [page for page in result if page.rows]

    def _papers(self, report: Mapping[str, Any]) -> ResultTable:
        """Return Table II as the paper has it, of the first policy."""
        name, body = self.policies[0] if self.policies else "", []
        for speed in SPEEDS:
            for people, goals in CELLS:
                case = {"world": PAPERS_WORLD, "speed": speed, "people": str(people), "goals": str(goals)}
                row = self.case_rows(report, **case).get(name)
                if row is None:
                    continue
                episode = f"{row['run']['seed']}/{row['run']['episode']}"
                contacts = (cell(row, f"{what}_contacts_per_min") for what in ("wall", "agent"))
                printed = TABLE_2_STEPS[people, goals], parity_text(TABLE_2_PARITY[people, goals])
                ours = episode, *run_text(row["run"]), cell(row, "success"), *contacts
                body.append([f"{people}/{goals}", speed, *ours, *map(str, printed)])
        head = ["people/goals", "m/s", "seed/episode", "Total Time Steps", "Parity", *MEANS]
        head.remove("episodes in which all do")
        head += ["the paper: Total Time Steps", "the paper: Parity"]
        return ResultTable(f"The paper's method: {name}", head, body, 2)

    def _changes(self, report: Mapping[str, Any], speed: str) -> ResultTable:
        body = []
        for row in sorted(report["summary"], key=lambda row: row["name"] in self.baselines):  # rules below
            of_speed, world = row["table"].split(", ", 1)
            if of_speed.endswith(f" {speed} m/s"):
                what = WORLDS[world].changes if world != PAPERS_WORLD else self._says(row["name"])
                body.append([row["name"], what, *(cell(row, key) for key in MEANS.values())])
        title = f"{speed} m/s: ours, one change in each row, and rules; mean of the five settings"
        return ResultTable(title, ["policy", "what it changes", *MEANS], body, 2)

    def _says(self, name: str) -> str:
        rule = "a rule in place of the network" if name in self.baselines else "another policy"
        return CHANGES.get(name, rule)

    def _page(self, report: Mapping[str, Any], speed: str, shown: Shown) -> ResultTable:
        printed = [_printed(shown.key, *cell) for cell in CELLS]
        body = [[PRINTED, *printed]] if all(printed) else []
        rows = {(row["name"], row["case"]["world"]): None for row in report["rows"]}
        for name, world in rows:
            line = [name if world == PAPERS_WORLD else f"{name} ({world})"]
            for people, goals in CELLS:
                case = {"world": world, "speed": speed, "people": str(people), "goals": str(goals)}
                line.append(_cell(self.case_rows(report, **case).get(name), shown))
            body.append(line)
        head = ["people/goals", *(f"{people}/{goals}" for people, goals in CELLS)]
        return ResultTable(f"{speed} m/s: {shown.title}", head, body, 1)


def middle_run(per_agent: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one episode: the middle one by how long all people took, of an even number the one before.

    ``seed`` and ``episode`` name it; ``steps`` of 0.1 s are until all had reached all goals, None where not
    all did: such episodes are the longest. ``goals`` are those that each person reached.
    """
    runs: dict[tuple[int, int], list[Mapping[str, Any]]] = {}
    for person in per_agent:
        runs.setdefault((person["seed"], person["episode"]), []).append(person)

    def seconds(run: tuple[int, int]) -> float:
        return max(inf if one["time_s"] is None else one["time_s"] for one in runs[run])

    middle = sorted(runs, key=lambda run: (seconds(run), run))[(len(runs) - 1) // 2]
    people, took = sorted(runs[middle], key=lambda one: one["agent"]), seconds(middle)
    return {
        "seed": middle[0],
        "episode": middle[1],
        "steps": None if took == inf else round(took / TRACE_SECONDS),
        "goals": [one["goals"] for one in people],
    }


def run_text(run: Mapping[str, Any]) -> tuple[str, str]:
    """Return the total steps of `middle_run`, and its parity line."""
    steps = "not all reach all goals" if run["steps"] is None else str(run["steps"])
    return steps, parity_text(run["goals"])


def parity_text(goals: Sequence[int]) -> str:
    """Return goals of people as the paper's Table II has them, ``0: 3, 1: 3``."""
    return ", ".join(f"{person}: {count}" for person, count in enumerate(goals))


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
    return TABLE_2_STEPS[people, goals] / min(TABLE_2_PARITY[people, goals])


def _printed(key: str, people: int, goals: int) -> str:
    """Return a cell of the paper's own row, '' for what it has not."""
    steps = steps_per_goal_at_most(people, goals)
    return {
        "time_s": str(TABLE_2_STEPS[people, goals]),
        "seconds_per_goal": f"at most {steps:.0f} ({steps / DEFAULT_STEPS_PER_GOAL:.0%})",
        "goals_per_person": f"at least {min(TABLE_2_PARITY[people, goals])}",
    }.get(key, "")
