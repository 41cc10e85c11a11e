"""Figure 4: two people at a narrow door: the paper's four panels as the paper ran them, and ours below."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, cast

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pedzoo.eval.comparison import PolicyRollout
from pedzoo.eval.results import ResultTable, cell, pages
from pedzoo.eval.rollout import rollout
from pedzoo.viz.plots import write_figure
from pedzoo.viz.trajectories import draw_episode, legend, meeting_and_end
from tools.paper.base import Walked
from tools.paper.meetings import OUTCOMES, PAPERS_OUTCOMES
from tools.paper.method import APPROACH, CHANGES, IN_LOOP, LAYER, NOTES, PAPER
from tools.paper.published import FIGURE_4
from tools.paper.suites import SPEED_RATIO, SPEEDS

TWO = ("unequal", "equal")
"""Speeds of two people: the paper tells of a faster and a slower one."""

WIDE = "orca:preset=igibson,walls=false"
"""iGibson's ORCA: radius 0.5, all people are neighbours, walls are none."""

NARROW = "orca:preset=igibson,radius=0.1,walls=false"


class Panel(NamedTuple):
    """A controller, and what the paper shows of it."""

    label: str
    shows: str


PANELS = {
    WIDE: Panel("(b) ORCA, radius 0.5", FIGURE_4["orca 0.5"]),
    NARROW: Panel("(c) ORCA, radius 0.1", FIGURE_4["orca 0.1"]),
    PAPER: Panel("(d) modified SGAN", FIGURE_4["learned"]),
}
"""The paper's panels; (a) is the scene."""

WINDOW = (-4.0, 4.0), (-1.6, 1.6)
"""Metres that a panel shows, the door in the middle."""

PANEL = (3.4, 1.6)
"""Inches."""

RARE = 0.05
"""Share of episodes below which the first tables leave an outcome out."""


class Figure4(Walked):
    """ORCA and the paper's network as in the paper; the network in the loop, with the layer, and others."""

    title = "Figure 4: two people at a narrow door"
    stem = "FIGURE4"
    suites = ("figure4",)
    models = (PAPER, IN_LOOP, LAYER, APPROACH)
    baselines = (WIDE, NARROW, "orca:radius=0.5", "go_to_goal")

    def notes(self) -> list[str]:
        """Return what has to be known to read the numbers."""
        return [
            *NOTES,
            "door 0.85 m wide in a wall of 0.15 m; people come head-on, at iGibson's 0.5 m/s and at 1.3 m/s"
            f" (unequal: the one from the right at {SPEED_RATIO} of that), starts jittered by 0.1 m, 2.5 m"
            " from the wall when the policy takes over; the paper gives no measures",
            "as the paper shows: both pass the door and arrive; no contact with people or walls; one slows"
            " down, exactly one of the two to less than half of the preferred speed before the door. The"
            " paper shows one episode of each panel; here are shares of episodes",
            f"radius 0.5, geometry or avoidance? iGibson's ORCA sees no walls (`{WIDE}`): alone it gets"
            " through, and what blocks two is their mutual avoidance. Where it sees them"
            " (`orca:radius=0.5`) a disk 1.0 m wide does not fit through 0.85 m, not even alone",
            "ORCA draws noise of 0.02 m/s on preferred velocities, which resolves some of the ties that exact"
            " symmetry would keep",
            "a circle's radius is half the least distance; bodies touch at 0.3 m, and ORCA of radius 0.1"
            " keeps 0.2 m. The first tables leave out outcomes of less than"
            f" {RARE:.0%} of episodes; the others have all of them, with intervals",
            "the picture (metres): the first episode of each at unequal speeds and 0.5 m/s, when most have"
            " met and when all episodes are over. A person who walked out of a panel did not find the door",
        ]

    def printed(self) -> dict[str, Any]:
        """Return what the paper says."""
        return {name: panel.shows for name, panel in PANELS.items()}

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the paper beside ours at each speed, and every metric of all cases."""
        beside = (self._beside(report, speed, speeds) for speed, speeds in product(SPEEDS, TWO))
        return [*(page for page in beside if page.rows), *pages(report, self.evaluation.shown)[1:]]

    @property
    def _order(self) -> list[str]:
        """The names of all rows, the paper's panels first."""
        names = [*self.baselines, *self.policies]
        return [*(name for name in PANELS if name in names), *(name for name in names if name not in PANELS)]

    def _beside(self, report: Mapping[str, Any], speed: str, speeds: str) -> ResultTable:
        rows, alone = (self.case_rows(report, speed=speed, speeds=one) for one in (speeds, "alone"))
        body = []
        for name in self._order:
            if (row := rows.get(name)) is None:
                continue
            least = row["metrics"].get("least_distance_m")
            numbers = [outcome(row), *(cell(row, key) for key in PAPERS_OUTCOMES)]
            numbers += ["-" if least is None else f"{least / 2:.2f}"]
            numbers += [cell(alone[name], "success") if name in alone else "-"]
            body.append([f"{label_of(name)}\n{name}", shows(name), *numbers])
        head = ["controller", "the paper shows", "outcomes", "both pass", "no contact", "one slows down"]
        head += ["all three", "half the least distance, m", "alone: gets through"]
        return ResultTable(f"{speed} m/s, {speeds} speeds: the paper beside ours", head, body, 1)

    def draw(self, folder: Path) -> list[Path]:
        """Draw the paper's four panels, and ours below a line: when people have met, and at the end."""
        unit = next(one for one in self.evaluation.units if one.case.case["speeds"] == TWO[0])
        case, walked = unit.case, dict[str, PolicyRollout]()
        ours = [name for name in (*self.policies, *self.baselines) if name not in PANELS]
        for name in [*(name for name in self._order if name in PANELS), *ours[:4]]:
            how: dict[str, Any] = {"planner": case.planner, "warm_start": case.warm_start}
            result, env = rollout(name, case.scenario, case.physics, 1, unit.seeds[0], **how)
            env.physics.close()
            walked[name] = PolicyRollout(name, result, env)
        figure = Figure(figsize=(4 * PANEL[0], 4 * PANEL[1] + 1.6), layout="constrained")
        figure.legend(handles=legend(), loc="outside lower center", ncols=5, frameon=False, fontsize=8)
        papers, below = cast("Any", figure.subfigures(2, 1))
        below.add_artist(
            Line2D([0.01, 0.99], [1, 1], transform=below.transSubfigure, color="black", linewidth=1.5)
        )
        moments = meeting_and_end([*walked.values()])
        for part, title in ((papers, "The paper's panels"), (below, "Ours, and rules")):
            part.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
            grid = part.subplots(2, 4, sharex=True, sharey=True)
            names = [name for name in walked if (name in PANELS) == (part is papers)]
            if part is papers and walked:
                draw_episode(grid[0, 0], next(iter(walked.values())), 0, 0)
                grid[0, 0].set_title("(a) the scene", fontsize=8)
            for column, name in enumerate(names, start=int(part is papers)):
                for axes, point in zip(grid[:, column], moments, strict=True):
                    draw_episode(axes, walked[name], 0, point)
                    axes.set_title(axes.get_title(), fontsize=8)
                first = grid[0, column]
                said = PANELS[name].label if name in PANELS else name
                first.set_title(f"{said}\n{first.get_title()}", fontsize=8)
            for axes in grid.flat:
                axes.set(xlim=WINDOW[0], ylim=WINDOW[1])
                axes.tick_params(labelsize=7)
                axes.set_visible(axes.has_data())
        write_figure(figure, path := folder / f"{self.stem}.png", dpi=120)
        return [path]


def label_of(name: str) -> str:
    """Return which of the paper's panels a policy is, or that it is ours, or a rule."""
    if name in PANELS:
        return PANELS[name].label
    return "rule" if name in Figure4.baselines else "ours"


def shows(name: str) -> str:
    """Return the paper's words on a panel; what ours changes in the paper's method, or nothing."""
    return f"“{PANELS[name].shows}”" if name in PANELS else CHANGES.get(name, "-")


def outcome(row: Mapping[str, Any] | None) -> str:
    """Return the outcomes of a case that are not rare, and their shares, the most frequent one first."""
    if row is None:
        return "-"
    shares = {name: row["metrics"][f"outcome_{name}"] for name in OUTCOMES}
    often = sorted((name for name in OUTCOMES if shares[name] >= RARE), key=lambda name: -shares[name])
    return ", ".join(f"{name} {shares[name]:.2f}" for name in often)
