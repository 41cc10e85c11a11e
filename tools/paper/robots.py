"""Among whom should a robot learn? Robots trained among each kind of people, tested among all others."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from matplotlib.figure import Figure

from pedzoo.eval.cards import only
from pedzoo.eval.results import ResultTable
from pedzoo.viz.plots import write_figure
from tools.paper.base import Walked
from tools.paper.suites import PLACES, REACTING, RECORDED, Transfer
from tools.zoo.robots import PEOPLE, SEEDS

COLUMNS: Sequence[tuple[str, str]] = (
    *((place, kind) for place in PLACES for kind in PEOPLE),
    *((place, REACTING) for place in RECORDED),
)
"""Places and kinds of people, as columns."""

SHOWN = {
    "success": ("success", 2),
    "collision_person": ("share of robots that touch a person", 2),
    "stl": ("STL: success, weighted by the time that the way takes alone", 2),
    "delay_s": ("delay of people because of the robot, seconds", 2),
}
"""Metrics of the tables, with digits."""


class RobotTransfer(Walked):
    """Robots trained among each kind of people x people whom they are tested among."""

    title = "Robots: trained among some people, tested among others"
    stem = "ROBOTS"
    suites = ("transfer",)
    models = tuple(
        f"robot_ppo.{kind}{f'-seed{seed}' if seed else ''}" for kind in PEOPLE for seed in range(SEEDS)
    )
    baselines = ("straight", "orca", "sampling", "approach_net_goal_map.indoor")

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        kinds = "; ".join(f"{kind}: `{people}`" for kind, people in PEOPLE.items())
        everywhere = {**PLACES, **RECORDED}
        places = "; ".join(f"{name}: {title}, `{scene}`" for name, (title, scene, _) in everywhere.items())
        return [
            f"people: {kinds}",
            f"places: {places}",
            f"`robot_ppo.KIND` learned among people of that kind; mean [least, largest] of {SEEDS} trainings",
            "orca, sampling and the walker see the true state of all; learned robots see 5 m of "
            "lidar and the people around. orca and approach_net_goal_map.indoor drive as themselves",
            f"recorded people who react are moved by `{PEOPLE[REACTING]}` from where they are recorded",
        ]

    def report(self) -> dict[str, Any]:
        """Return the report with the metrics of the suite's tables alone: all of them are megabytes."""
        report = super().report()
        for row in (*report["rows"], *report["summary"]):
            row |= {part: only(row[part], Transfer.columns) for part in ("metrics", "ci95")}
        return report

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the answer, and a table of each metric."""
        return transfer_pages(report["rows"])

    def draw(self, folder: Path) -> list[Path]:
        """Draw success as a map of colours: robots as rows, tests as columns."""
        groups = grouped(self.evaluation.report()["rows"])
        if not groups:
            return []
        values = [
            [fmean(_values(rows, "success", column) or [math.nan]) for column in COLUMNS]
            for rows in groups.values()
        ]
        figure = Figure(figsize=(0.62 * len(COLUMNS) + 2.6, 0.42 * len(groups) + 2.2), layout="constrained")
        axes = figure.subplots()
        image = axes.imshow(values, vmin=0.5, vmax=1, cmap="viridis", aspect="auto")
        axes.set_yticks(range(len(groups)), list(groups))
        axes.set_xticks(
            range(len(COLUMNS)), [f"{place}: {kind}" for place, kind in COLUMNS], rotation=50, ha="right"
        )
        for y, row in enumerate(values):
            for x, value in enumerate(row):
                colour = "black" if value > 0.8 else "white"
                axes.text(x, y, f"{value:.2f}", ha="center", va="center", fontsize=8, color=colour)
        axes.set_title("success; mean over trainings")
        figure.colorbar(image, ax=axes, shrink=0.8)
        write_figure(figure, path := folder / f"{self.stem}.png", dpi=130)
        return [path]


def transfer_pages(rows: Sequence[Mapping[str, Any]]) -> list[ResultTable]:
    """Return the answer, and a table of each metric; nothing where no robot has been tested everywhere."""
    groups = grouped(rows)
    if not groups:
        return []
    tables, head = [_answer(groups)], ["robot", *(f"{place}\n{kind}" for place, kind in COLUMNS)]
    for key, (title, digits) in SHOWN.items():
        cells = {
            name: [_spread(_values(tested, key, one), digits) for one in COLUMNS]
            for name, tested in groups.items()
        }
        tables.append(ResultTable(title, head, [[name, *row] for name, row in cells.items()], 1))
    return tables


Group = Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]
"""Rows of all trainings of a robot by place and kind of people."""


def grouped(rows: Sequence[Mapping[str, Any]]) -> dict[str, Group]:
    """Return rows by robot, all seeds of one training together, where each has been tested everywhere."""
    result: dict[str, dict[tuple[str, str], list[Mapping[str, Any]]]] = {}
    for row in rows:
        where = row["case"]["place"], row["case"]["people"]
        result.setdefault(re.sub(r"-seed\d+$", "", row["name"]), {}).setdefault(where, []).append(row)
    return {name: cases for name, cases in result.items() if all(column in cases for column in COLUMNS)}


def _values(rows: Group, key: str, column: tuple[str, str]) -> list[float]:
    return [row["metrics"][key] for row in rows[column] if key in row["metrics"]]


def _spread(values: Sequence[float], digits: int) -> str:
    """Return the mean of some trainings, and the least and the largest where there are several."""
    if not values:
        return "-"
    text = f"{sum(values) / len(values):.{digits}f}"
    return text if len(values) == 1 else f"{text} [{min(values):.{digits}f}, {max(values):.{digits}f}]"


def _answer(groups: Mapping[str, Group]) -> ResultTable:
    """Return the mean over all kinds of people in each place, the best robot first."""
    places = [*PLACES, *RECORDED]

    def means(rows: Group, key: str) -> list[list[float]]:
        """Return the mean over kinds in each place, of every training."""
        by_place = [[_values(rows, key, one) for one in COLUMNS if one[0] == place] for place in places]
        return [[fmean(training) for training in zip(*kinds, strict=False)] for kinds in by_place]

    body = []
    for name, rows in groups.items():
        by_place, touches = means(rows, "success"), means(rows, "collision_person")
        overall = [[fmean(training) for training in zip(*one, strict=False)] for one in (by_place, touches)]
        body.append([name, *(_spread(one, 3) for one in overall), *(_spread(one, 2) for one in by_place)])
    body.sort(key=lambda line: -float(line[1].split()[0]))
    title = "Among whom should a robot learn? Success, mean over all kinds of people"
    return ResultTable(title, ["robot", "success everywhere", "touches a person", *places], body, 1)
