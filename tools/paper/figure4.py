"""Figure 4: two people at a narrow door, the paper's controllers and ours, equal and unequal speeds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.results import ResultTable, cell, pages
from pedzoo.eval.rollout import rollout
from pedzoo.viz.plots import write_figure
from pedzoo.viz.trajectories import draw_episode, legend, meeting_and_end
from tools.paper.base import Walked
from tools.paper.meetings import OUTCOMES
from tools.paper.published import FIGURE_4
from tools.paper.suites import NARROW_DOORS, SPEED_RATIO

SPEEDS = ("equal", "unequal")
UNSEEN = "orca:radius=0.5,walls=false"
"""The same disk where walls are no obstacle: what blocks it then is mutual avoidance alone."""

WINDOW = (-4.0, 4.0), (-1.6, 1.6)
"""Metres that a panel shows, the door in the middle."""

PANEL = (3.4, 1.6)
"""Inches."""

RARE = 0.05
"""Share of episodes below which the first table leaves an outcome out."""


class Figure4(Walked):
    """ORCA, SGAN, SGAN+goal+map and the same in the loop; walls unseen and alone: what it is that blocks."""

    title = "Figure 4: two people at a narrow door"
    stem = "FIGURE4"
    suites = ("figure4",)
    models = ("sgan.eth_ucy", "sgan_goal_map.eth_ucy", "sgan_goal_map.indoor")
    baselines = ("orca:radius=0.5", UNSEEN, "orca:radius=0.1", "go_to_goal")

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        return [
            "door 0.85 m wide in a wall of 0.15 m; people come head-on at 1.3 m/s (unequal: the one from the"
            f" right at {SPEED_RATIO} of that), starts jittered by 0.1 m, 2.5 m from the wall when the policy"
            " takes over; the paper gives no measures",
            "radius 0.5, geometry or avoidance? With walls seen it is geometry: a disk 1.0 m wide does not"
            f" fit through 0.85 m, not even alone. With walls unseen (`{UNSEEN}`; iGibson's ORCA sees none)"
            " it gets through alone: what blocks two of them then is their mutual avoidance",
            "a circle's radius is half the least distance; bodies touch at 0.3 m, and ORCA of radius 0.1"
            " keeps 0.2 m. The first table leaves out outcomes of less than"
            f" {RARE:.0%} of episodes; the others have all of them, with intervals",
            "the picture (metres): the first episode of each, at equal and unequal speeds, when most have met"
            " and when all episodes are over. A person who walked out of a panel did not find the door",
        ]

    def printed(self) -> dict[str, Any]:
        """Return what the paper has printed."""
        return dict(FIGURE_4)

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the paper beside ours, and every metric of the three cases."""
        if not report["rows"]:
            return []
        cases = {case: self.case_rows(report, speeds=case) for case in (*SPEEDS, "alone")}
        head = ["controller", "the paper shows"]
        for speeds in SPEEDS:
            head += [f"{speeds} speeds: outcomes", "half the least distance, m"]
        body = []
        for name in dict.fromkeys(row["name"] for row in report["rows"]):
            line = [name, FIGURE_4.get(name, "-")]
            for speeds in SPEEDS:
                row = cases[speeds].get(name)
                least = row["metrics"].get("least_distance_m") if row else None
                line += [outcome(row), "-" if least is None else f"{least / 2:.2f}"]
            alone = cases["alone"].get(name)
            body.append([*line, cell(alone, "success") if alone else "-"])
        beside = ResultTable("The paper beside ours", [*head, "alone: gets through"], body, 1)
        return [beside, *pages(report, self.evaluation.shown)[1:]]

    def draw(self, folder: Path) -> list[Path]:
        """Draw the first episode of each, equal and unequal speeds, at the same two times in every row."""
        names = [name for name in (*self.baselines, *self.policies) if name != "go_to_goal"]
        rows, columns = len(names), 2 * len(SPEEDS)
        figure = Figure(figsize=(columns * PANEL[0], rows * PANEL[1] + 0.4), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        unit = self.evaluation.units[0]
        for number, speeds in enumerate(SPEEDS):
            walked = []
            for name in names:
                result, env = rollout(name, NARROW_DOORS[speeds], unit.case.physics, 1, unit.seeds[0])
                env.physics.close()
                walked.append(PolicyRollout(name, result, env))
            for place, point in enumerate(meeting_and_end(walked)):
                for axes, one in zip(grid[:, 2 * number + place], walked, strict=True):
                    draw_episode(axes, one, 0, point)
                    axes.set_title(f"{speeds} speeds, {axes.get_title()}", fontsize=8)
                    axes.set(xlim=WINDOW[0], ylim=WINDOW[1])
                    axes.tick_params(labelsize=7)
        for row, name in zip(grid, names, strict=True):
            row[0].set_ylabel(name.replace(":", "\n", 1).replace(",", "\n"), fontsize=8)
        figure.legend(handles=legend(), loc="outside lower center", ncols=5, frameon=False, fontsize=8)
        write_figure(figure, path := folder / f"{self.stem}.png", dpi=120)
        return [path]


def outcome(row: Mapping[str, Any] | None) -> str:
    """Return the outcomes of a case that are not rare, and their shares, the most frequent one first."""
    if row is None:
        return "-"
    shares = {name: row["metrics"][f"outcome_{name}"] for name in OUTCOMES}
    often = sorted((name for name in OUTCOMES if shares[name] >= RARE), key=lambda name: -shares[name])
    return ", ".join(f"{name} {shares[name]:.2f}" for name in often)
