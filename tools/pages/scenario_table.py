"""Walk through every scenario with ORCA and social force.

Makes checkpoints/results/SCENARIOS.md and a picture.

    python tools/pages/scenario_table.py
    python tools/pages/scenario_table.py door --policies go_to_goal    # prints, unless --out and --picture

Every scenario of the registry with its defaults, and encounters with crowds of 20 and 50 people as far as
they take them (of 50 people half as many episodes). Policies of one row see the same scenes. The page ends
with what fails, and why; those of other scenarios, policies, episodes or physics do not.
"""

from __future__ import annotations

import argparse
import os
import pickle
import shlex
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib.figure import Figure
from PIL import Image

from pedzoo.cli.progress import progress_bar
from pedzoo.core.machine import versions
from pedzoo.core.paths import shipped, write_atomically
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import parse
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout, row
from pedzoo.eval.results import markdown_table
from pedzoo.eval.rollout import rollout
from pedzoo.metrics.arrival import arrived_in_time, deadlocked
from pedzoo.metrics.statistics import wilson
from pedzoo.sim.scenarios._lanes import Encounter
from pedzoo.sim.scenarios.replay import Replay
from pedzoo.viz.trajectories import draw_episode

POLICIES = ("orca:radius=0.3", "social_force", "social_force:preset=indoor")
CROWDS = (20, 50)
LARGE = "people=50"
VARIANTS = ("intersection:people=4", "parallel:opposite=true", "parallel:opposite=true,people=20")
"""Beside the defaults and the crowds."""

CHOICES = "scenarios", "policies", "episodes", "physics"
"""Options without which the whole page is made."""

PANEL = (2.5, 1.75)
"""Inches of a panel of the picture."""


class TableRow(NamedTuple):
    """One row of the table."""

    scenario: str
    policy: str
    physics: str
    episodes: int


class RowResult(NamedTuple):
    """What came of it: numbers, their 95 % intervals, and the first episode."""

    people: int
    metrics: dict[str, float]
    ci95: dict[str, tuple[float, float]]
    first: PolicyRollout


def main() -> None:
    """Walk everything, write or print the page and draw the picture."""
    parser = arguments()
    options = parser.parse_args()
    whole = all(getattr(options, key) == parser.get_default(key) for key in CHOICES)
    if whole:
        options.out = options.out or shipped("checkpoints") / "results" / "SCENARIOS.md"
        options.picture = options.picture or shipped("checkpoints") / "results" / "scenarios_walked.png"
    result = walked(options)
    text = page(options, result, FAILURES.read_text() if whole else "")
    write_atomically(options.out, text.encode()) if options.out else print(text)
    if options.picture:
        write_atomically(options.picture, picture(result))


def arguments() -> argparse.ArgumentParser:
    """Return the parser."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("scenarios", nargs="*", default=[], help="names with settings; none: all, and crowds")
    parser.add_argument("--policies", nargs="+", default=list(POLICIES))
    parser.add_argument("--episodes", type=int, default=20, help="seeds per row")
    parser.add_argument("--physics", default="compiled", help="a backend, or file.py:Class")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument(
        "--out", type=Path, help="page (default: in checkpoints/results if whole, else printed)"
    )
    parser.add_argument(
        "--picture", type=Path, help="picture (default: in checkpoints/results if whole, else none)"
    )
    return parser


def walked(options: argparse.Namespace) -> dict[TableRow, RowResult]:
    """Walk everything, and print a line of each."""
    scenarios = options.scenarios or every_scenario()
    cases = [
        TableRow(one, policy, options.physics, options.episodes // (1 + one.endswith(LARGE)))
        for one in scenarios
        for policy in options.policies
    ]
    result: dict[TableRow, RowResult] = {}
    workers = ProcessPoolExecutor(options.workers, initializer=torch.set_num_threads, initargs=(1,))
    with workers as pool, progress_bar() as progress:
        for done, (case, data) in enumerate(zip(cases, pool.map(measured, cases), strict=True), start=1):
            one = result[case] = pickle.loads(data)
            print(case.scenario, case.policy, *(cell(one, key) for key in COLUMNS), sep=" | ", flush=True)
            progress("scenarios x policies", done, len(cases))
    return result


def every_scenario() -> list[str]:
    """Return all scenarios with their defaults, then their variants and crowds."""
    # a replay has people who come and go, and tables of its own: pedzoo evaluate --suite replay
    names = [name for name in SCENARIOS.names() if not issubclass(SCENARIOS.get(name), Replay)]
    result = []
    for name in names:
        result += [name, *(one for one in VARIANTS if parse(one).name == name)]
        if issubclass(cls := SCENARIOS.get(name), Encounter):
            result += [f"{name}:people={people}" for people in CROWDS if people <= cls.most]
    return result


def measured(case: TableRow) -> bytes:
    """Return a pickled `RowResult`: tensors that processes share would need a file handle each."""
    result, env = rollout(case.policy, case.scenario, case.physics, case.episodes)
    env.physics.close()
    actual = row(case.policy, result)
    metrics, intervals = dict(actual["metrics"]), dict(actual["ci95"])
    arrived = arrived_in_time(result.reached, result.goals, result.overdue, result.failed, result.mask)
    stuck = deadlocked(result.trace, result.goal, result.scored) & ~arrived
    metrics["stuck"] = float(stuck.sum() / result.mask.sum())
    intervals["stuck"] = wilson(metrics["stuck"], case.episodes)
    first = PolicyRollout(case.policy, result.episodes(slice(1)), env)
    return pickle.dumps(RowResult(result.mask.shape[1], metrics, intervals, first))


COLUMNS = {
    "success": ("people who arrive", 100, "{:.0f}", " %"),
    "episode_success": ("episodes: all do", 100, "{:.0f}", " %"),
    "stuck": ("stuck", 100, "{:.0f}", " %"),
    "agent_contacts_per_min": ("people touched, events per min", 1, "{:.2f}", ""),
    "wall_contacts_per_min": ("walls touched, events per min", 1, "{:.2f}", ""),
    "time_ratio": ("time ratio", 1, "{:.2f}", ""),
}


def page(options: argparse.Namespace, result: dict[TableRow, RowResult], conclusions: str) -> str:
    """Return the page; the picture is beside it, if there is one."""
    made, rows = versions(), []
    call = shlex.join(["python", "tools/pages/scenario_table.py", *sys.argv[1:]])
    title = "Scenarios, walked by ORCA and social force" if conclusions else "Scenarios"
    for scenario, group in by_scenario(result):
        for number, (case, one) in enumerate(group):
            name = [f"`{scenario}`", one.people, case.episodes] if number == 0 else [""] * 3
            rows.append([*name, case.policy, *(cell(one, key) for key in COLUMNS)])
    names = ["scenario", "people", "episodes", "policy", *(head for head, *_ in COLUMNS.values())]
    lines = [
        f"# {title}\n",
        f"Made by `{call}` with pedzoo {made['pedzoo']}, torch {made['torch']}"
        f", commit {made.get('commit', 'unknown')}: the first episodes of seed 0, physics"
        f" `{options.physics}`, speeds N(1.3, 0.2) m/s, decisions every {TRACE_SECONDS} s, body radius"
        " 0.15 m, warm start with ORCA (radius 0.2). In brackets 95 % intervals: Wilson's over episodes for"
        " shares, Student's t over episodes otherwise.\n",
        markdown_table(names, rows),
        LEGEND,
        conclusions,
        f"![One episode of each](./{options.picture.name})\n" if options.picture else "",
    ]
    return "\n".join(lines)


def by_scenario(result: dict[TableRow, RowResult]) -> Iterator[tuple[str, list[tuple[TableRow, RowResult]]]]:
    """Yield the rows of each scenario."""
    for scenario, group in groupby(result.items(), key=lambda item: item[0].scenario):
        yield scenario, list(group)


def cell(one: RowResult, key: str) -> str:
    """Return a number with its interval; a dash where there is none."""
    _, factor, form, unit = COLUMNS[key]
    if key not in one.metrics:
        return "-"
    text = form.format(factor * one.metrics[key]) + unit
    if key in one.ci95:
        low, high = (form.format(factor * value) for value in one.ci95[key])
        text += f" [{low}, {high}]"
    return text


LEGEND = """
* *stuck*: share of people who do not arrive in time and once moved less than 0.1 m in 5 s, more than 0.5
  m from their goal. The others who do not arrive are late: four times the way's time, at least 20 s.
* *time ratio*: mean of the time until all goals are reached, divided by that of the planned ways at one's
  preferred speed, of those who arrive. It can be a little below 1: planned ways keep off walls.
* *touched*: a touch that lasts counts once, and for both.
"""

CROWD = f":people={CROWDS[0]}"
"""Ends the name of a scenario with a crowd that the picture shows."""

FAILURES = Path(__file__).with_name("scenario_failures.md")
"""What the rows of the whole run show, in words."""


def picture(result: dict[TableRow, RowResult]) -> bytes:
    """Return a PNG: a block for each scenario, its policies beside each other, two blocks in a row.

    First those with a crowd, which stands beside them, then the others.
    """
    shown, others = [], []
    crowds = {case.scenario for case in result if case.scenario.endswith(CROWD)}
    for scenario, group in by_scenario(result):
        if scenario in crowds or f"{scenario}{CROWD}" in crowds:
            shown.append(group)
        elif ":" not in scenario:
            others.append(group)
    blocks = [*shown, *others]
    wide = max(len(group) for group in blocks)
    pairs = min(2, len(blocks))
    rows = -(-len(blocks) // pairs)
    figure = Figure(figsize=(pairs * wide * PANEL[0], rows * PANEL[1]), layout="constrained")
    grid = figure.subplots(rows, pairs * wide, squeeze=False).reshape(-1, wide)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (case, one) in (
        (grid[i, k], item) for i, its in enumerate(blocks) for k, item in enumerate(its)
    ):
        axes.set_axis_on()
        draw_episode(axes, one.first)
        end = axes.get_title()
        axes.set_title(f"{case.scenario}: {end}\n{case.policy}", fontsize=6.5)
        axes.set(xticks=[], yticks=[])
        axes.set_anchor("C")
    data, small = BytesIO(), BytesIO()
    figure.savefig(data, format="png", dpi=130)
    # few colours: a third of the size
    Image.open(data).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return small.getvalue()


if __name__ == "__main__":
    main()
