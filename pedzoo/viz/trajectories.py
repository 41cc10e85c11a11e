"""Pictures of how people walked: the way so far at some moments around the one at which they meet.

In the manner of Fig. 4 of the paper on iGibson: a star where an agent is, dots where they were at the three
steps of 0.4 s before, time as colour, and the walls.
"""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.geometry import direction_of, move_to_map
from pedzoo.core.paths import write_whole
from pedzoo.core.types import GOAL_RADIUS, TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.sim.physics_parts.camera import person_color
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.state import TRACE_PER_STEP
from pedzoo.viz.plots import draw_floor_plan
from pedzoo.viz.video import check_episode

SUFFIXES = (".png", ".pdf", ".svg")

STEPS_BEFORE = 3
"""Dots behind each star."""

AROUND = (-0.8, 0.0, 0.8)
"""Seconds about the moment of meeting that have a panel each; the end has another one."""

RECENT = 60
"""Trace points before a star that are drawn broad, 6 s; what is older is thin."""

MARGIN = 0.5
"""Metres around people's paths that panels show."""

SHADE = ListedColormap(colormaps["viridis"](np.linspace(0.12, 0.95, 200)), "time")
"""Time along the way; without the darkest end, on which no agent's colour is seen."""

_CLOSE = 0.1
"""Metres: people who stand before each other have met when they first come so close to the least distance."""


def plot_rollouts(walked: Sequence[PolicyRollout], path: str | Path, episode: int = 0) -> None:
    """Draw a row of panels per policy: one episode at four moments, and the ways of all episodes.

    Args:
        walked: What the policies did, all in the same scenario.
        path: ``.png``, ``.pdf`` or ``.svg``; its folder is made where it is missing.
        episode: Number of the episode.

    Raises:
        UserError: No such episode, another suffix, or the file cannot be written.
    """
    check_plot_path(path)
    for one in walked:
        check_episode(one, episode)
    shown = [_Episode(one, episode) for one in walked]
    low = torch.stack([one.low for one in shown]).amin(0) - MARGIN
    high = torch.stack([one.high for one in shown]).amax(0) + MARGIN
    columns = len(AROUND) + 2
    width, height = _panel_size(high - low)
    figure = Figure(figsize=(columns * width + 1.1, len(shown) * (height + 0.9) + 0.4), layout="constrained")
    for part, one in zip(figure.subfigures(len(shown), 1, squeeze=False)[:, 0], shown, strict=True):
        part.suptitle(one.name, x=0.01, ha="left", fontsize=9, fontweight="bold")
        row = part.subplots(1, columns, sharex=True, sharey=True)
        clock = Normalize(0.0, one.length * TRACE_SECONDS)
        for axes, point in zip(row, one.moments, strict=False):
            one.draw(axes, point, clock)
        one.draw_all(row[-1])
        bar = part.colorbar(ScalarMappable(clock, SHADE), ax=list(row), pad=0.01, aspect=12)
        bar.set_label("time, s", fontsize=8)
        bar.ax.tick_params(labelsize=7)
        row[0].set(xlim=(float(low[0]), float(high[0])), ylim=(float(low[1]), float(high[1])))
        row[0].set_ylabel("y, m", fontsize=8)
        for axes in row:
            axes.set_aspect("equal")
            axes.tick_params(labelsize=7)
            axes.set_xlabel("x, m", fontsize=8)
    figure.legend(handles=legend(), loc="outside lower center", ncols=5, frameon=False, fontsize=8)
    data = BytesIO()
    figure.savefig(data, format=Path(path).suffix[1:].lower(), dpi=130)
    try:
        write_whole(Path(path), data.getvalue())
    except OSError as error:
        raise UserError(f"cannot write {str(path)!r}: {error.strerror}") from error


def draw_episode(
    axes: Axes, walked: PolicyRollout, episode: int = 0, until: Literal["meeting", "end"] = "end"
) -> None:
    """Draw the ways of one episode until its end, or until two people meet, with a margin around all of them.

    Raises:
        UserError: No such episode.
    """
    check_episode(walked, episode)
    one = _Episode(walked, episode)
    point = one.length if until == "end" else one.met
    one.draw(axes, point, Normalize(0.0, one.length * TRACE_SECONDS))
    low, high = (one.low - MARGIN).tolist(), (one.high + MARGIN).tolist()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def check_plot_path(path: str | Path) -> None:
    """Raise the error that a file name gives which no plot can have."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise UserError(f"plot {str(path)!r}: expected a file that ends in {' or '.join(SUFFIXES)}")


def meeting(rollout: Rollout, episode: int) -> int:
    """Return the trace point at which two people are first as near each other as they ever are.

    Where no agents meet it is the middle of the episode.
    """
    length = int(rollout.length[episode])
    position, there = rollout.trace[episode, :, :length], rollout.present[episode, :, :length]
    between = torch.cdist(position.transpose(0, 1), position.transpose(0, 1))
    pair = there.T.unsqueeze(1) & there.T.unsqueeze(2)
    pair &= ~torch.eye(len(there), dtype=torch.bool)
    nearest = between.masked_fill(~pair, torch.inf).flatten(1).amin(1)
    if not bool(nearest.isfinite().any()):
        return length // 2
    return int((nearest <= nearest.min() + _CLOSE).nonzero()[0])


class _Episode:
    """One episode in its map's frame, ready to be drawn; point 0 is where it begins."""

    def __init__(self, walked: PolicyRollout, episode: int) -> None:
        self.name, self.rollout, self.number = walked.name, walked.rollout, episode
        grids = walked.env.bank.grids
        identity = int(self.rollout.map_id[episode])
        self.plan: OccupancyGrid | None = next((grid for grid in grids if grid.map_id == identity), None)
        one = self.rollout.episodes(slice(episode, episode + 1))
        self.length = int(one.length[0])
        self.before = move_to_map(one.past, one.pose)[0]
        after, goal = (move_to_map(value, one.pose)[0, :, : self.length] for value in (one.trace, one.goal))
        self.path = torch.cat((self.before[:, -1:], after), dim=1)
        self.goal = torch.cat((goal[:, :1], goal), dim=1)
        self.present = torch.cat((one.mask[0].unsqueeze(1), one.present[0, :, : self.length]), dim=1)
        seen = torch.cat((self.path[self.present], self.goal[self.present]))
        self.low, self.high = seen.amin(0), seen.amax(0)
        self.stays = self.rollout.stays(episode)
        self.met = min(1 + meeting(self.rollout, episode), self.length)
        around = [self.met + round(seconds / TRACE_SECONDS) for seconds in AROUND]
        self.moments = [min(max(point, 0), self.length) for point in around] + [self.length]

    def draw(self, axes: Axes, point: int, clock: Normalize) -> None:
        """Draw the ways until a trace point."""
        self._ground(axes)
        for person, first, stays_until in self.stays:
            if first > point or (first > 0 and stays_until < point):
                continue  # not there yet, or gone again
            last = min(point, stays_until)
            color = _color(person)
            if first == 0:
                axes.plot(*self.before[person].T.numpy(), color="0.6", linewidth=0.8, zorder=2)
            way = self.path[person, first : last + 1].numpy()
            lines = LineCollection(
                list(np.stack((way[:-1], way[1:]), axis=1)), cmap=SHADE, norm=clock, zorder=4
            )
            lines.set_linewidth([2.4 if last - i <= RECENT else 0.8 for i in range(first, last)])
            lines.set_array(np.arange(first, last) * TRACE_SECONDS)
            axes.add_collection(lines)
            steps = [last - i * TRACE_PER_STEP for i in range(STEPS_BEFORE, 0, -1)]
            dots = self.path[person, [step for step in steps if step >= first]]
            axes.plot(*dots.T.numpy(), "o", color=color, markersize=4.5, zorder=5, **_EDGE)
            axes.plot(*self.path[person, last].numpy(), "*", color=color, markersize=12, zorder=6, **_EDGE)
            if last == point:
                self._mark_goal(axes, self.goal[person, point], color)
        title = f"{point * TRACE_SECONDS:.1f} s"
        if point == self.length:
            title += ", failed" if bool(self.rollout.failed[self.number]) else ", end"
        axes.set_title(title, fontsize=8)

    def draw_all(self, axes: Axes) -> None:
        """Draw the ways of all episodes on this floor plan."""
        self._ground(axes)
        rollout = self.rollout
        same = (rollout.map_id == rollout.map_id[self.number]).nonzero()[:, 0].tolist()
        path = move_to_map(torch.cat((rollout.past[:, :, -1:], rollout.trace), dim=2), rollout.pose)
        for episode in same:
            for person, first, last in rollout.stays(episode):
                way = path[episode, person, first : last + 1]
                axes.plot(*way.T.numpy(), color=_color(person), linewidth=0.8, alpha=0.5, zorder=3)
        axes.set_title(f"all {len(same)} episodes", fontsize=8)

    def _ground(self, axes: Axes) -> None:
        if self.plan is not None:
            draw_floor_plan(axes, self.plan)

    def _mark_goal(self, axes: Axes, goal: Tensor, color: tuple[float, ...]) -> None:
        angle = torch.linspace(0, 2 * torch.pi, 33)
        circle = goal + GOAL_RADIUS * direction_of(angle)
        axes.plot(*circle.T.numpy(), color=color, linewidth=1, linestyle=":", zorder=2)
        axes.plot(*goal.numpy(), "x", color=color, markersize=5, zorder=2)


_EDGE = {"markeredgecolor": "white", "markeredgewidth": 0.6}


def _color(person: int) -> tuple[float, ...]:
    return tuple(value / 255 for value in person_color(person))


def _panel_size(extent: Tensor) -> tuple[float, float]:
    """Return width and height of a panel in inches."""
    ratio = float(extent[1] / extent[0])
    width = 2.9 if ratio < 1 else 2.9 / ratio
    return max(width, 1.6), max(width * ratio, 0.9)


def legend() -> list[Line2D]:
    """Return the entries of a legend for what is drawn."""

    def entry(label: str, **style: object) -> Line2D:
        return Line2D([], [], label=label, **({"color": "0.3", "linestyle": "none"} | style))  # type: ignore[arg-type]

    return [
        entry("latest step", marker="*", markersize=10),
        entry(f"{STEPS_BEFORE} steps before (0.4 s)", marker="o", markersize=4),
        entry("goal", marker="x", markersize=5),
        entry("way, coloured by time", linestyle="-", linewidth=2.4, color=SHADE(0.5)),
        entry("warm start", linestyle="-", linewidth=0.8, color="0.6"),
    ]
