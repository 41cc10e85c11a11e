"""Pictures of how people walked: the way so far at some moments around the one at which they meet.

In the manner of Fig. 4 of the paper on iGibson: a star is where an agent is, dots are where they were at the
three steps of 0.4 s before. Colours are people; all policies are shown at the same times.
"""

from collections.abc import Sequence
from pathlib import Path
from statistics import median_low
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from torch import Tensor

from pedzoo.core.geometry import direction_of, move_to_map
from pedzoo.core.types import GOAL_RADIUS, TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.metrics.contacts import begins
from pedzoo.sim.camera import person_color
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.state import TRACE_PER_STEP
from pedzoo.viz.plots import check_plot_path, draw_floor_plan, write_figure
from pedzoo.viz.video import ShownEpisode, check_episode

STEPS_BEFORE = 3
"""Dots behind each star."""

MOMENTS = 3
"""Panels from the first meeting to the last one of all policies; the end has another one."""

AROUND = 0.8
"""Seconds before the first and after the last meeting where these begin and end."""

RECENT = 60
"""Trace points before a star that are drawn broad, 6 s; what is older is thin."""

MARGIN = 0.5
"""Metres around people's paths that panels show."""

TOUCH = "black"
"""Colour of the rings where bodies or walls were touched."""

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
    low, high = _cropped(low, high, shown[0].plan)
    moments = common_moments([one.met for one in shown], [one.length for one in shown])
    columns = len(moments) + 1
    width, height = _panel_size(high - low)
    figure = Figure(figsize=(columns * width + 0.4, len(shown) * (height + 0.75) + 0.4), layout="constrained")
    for part, one in zip(figure.subfigures(len(shown), 1, squeeze=False)[:, 0], shown, strict=True):
        part.suptitle(one.name, x=0.01, ha="left", fontsize=9, fontweight="bold")
        row = part.subplots(1, columns, sharex=True, sharey=True)
        for axes, point in zip(row, moments, strict=False):
            one.draw(axes, point)
        one.draw_all(row[-1])
        row[0].set(xlim=(float(low[0]), float(high[0])), ylim=(float(low[1]), float(high[1])))
        row[0].set_ylabel("y, m", fontsize=8)
        for axes in row:
            axes.set_aspect("equal")
            axes.tick_params(labelsize=7)
            if one is shown[-1]:
                axes.set_xlabel("x, m", fontsize=8)
    figure.legend(handles=legend(), loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    write_figure(figure, path)


def draw_episode(axes: Axes, walked: PolicyRollout, episode: int = 0, point: int | None = None) -> None:
    """Draw the ways of one episode until a trace point, by default its end, with a margin around all of them.

    Raises:
        UserError: No such episode.
    """
    check_episode(walked, episode)
    one = _Episode(walked, episode)
    one.draw(axes, one.length if point is None else point)
    low, high = (one.low - MARGIN).tolist(), (one.high + MARGIN).tolist()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


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


def common_moments(met: Sequence[int], lengths: Sequence[int]) -> list[int]:
    """Return the trace points that have a panel, the same for all policies; the last is the longest end.

    Args:
        met: At which point the people of each policy meet.
        lengths: When each policy's episode ends.
    """
    around, end = round(AROUND / TRACE_SECONDS), max(lengths)
    first, last = max(min(met) - around, 0), min(max(met) + around, end)
    between = [round(first + (last - first) * i / (MOMENTS - 1)) for i in range(MOMENTS)]
    return sorted({*between, end})


def meeting_and_end(walked: Sequence[PolicyRollout], episode: int = 0) -> tuple[int, int]:
    """Return the trace points at which people of most policies have met, and at which all episodes are over.

    Raises:
        UserError: No such episode.
    """
    for one in walked:
        check_episode(one, episode)
    shown = [_Episode(one, episode) for one in walked]
    return median_low(one.met for one in shown), max(one.length for one in shown)


def _cropped(low: Tensor, high: Tensor, plan: OccupancyGrid | None) -> tuple[Tensor, Tensor]:
    """Return the corners of what is seen, without what lies beyond the floor plan."""
    if plan is None or plan.origin[2]:
        return low, high
    rows, columns = plan.cells.shape
    corner = low.new_tensor(plan.origin[:2])
    other = corner + plan.resolution * low.new_tensor([columns, rows])
    return torch.maximum(low, corner), torch.minimum(high, other)


class _Episode:
    """One episode in its map's frame, ready to be drawn; point 0 is where it begins."""

    def __init__(self, walked: PolicyRollout, episode: int) -> None:
        self.name, self.rollout, self.number = walked.name, walked.rollout, episode
        grids = walked.env.bank.grids
        identity = int(self.rollout.map_id[episode])
        self.plan: OccupancyGrid | None = next((grid for grid in grids if grid.map_id == identity), None)
        shown = ShownEpisode(self.rollout, episode, on_map=True)
        one, self.length, self.path, self.present = shown.rollout, shown.length, shown.path, shown.present
        self.before, self.stays = move_to_map(one.past, one.pose)[0], shown.stays
        self.goal = torch.cat((shown.goal[:, :1], shown.goal), dim=1)
        self.low, self.high = shown.seen.amin(0), shown.seen.amax(0)
        self.met = min(1 + meeting(self.rollout, episode), self.length)
        contact = ((one.agent_contact | one.wall_contact) & one.present)[0, :, : self.length]
        self.touches = torch.nn.functional.pad(begins(contact.unsqueeze(0))[0], (1, 0))

    def draw(self, axes: Axes, point: int) -> None:
        """Draw the ways until a trace point, or until the end where that is earlier."""
        self._ground(axes)
        title = f"{point * TRACE_SECONDS:.1f} s"
        point = min(point, self.length)
        for person, first, stays_until in self.stays:
            if first > point or (first > 0 and stays_until < point):
                continue  # not there yet, or gone again
            last = min(point, stays_until)
            color = _color(person)
            if first == 0:
                axes.plot(*self.before[person].T.numpy(), color="0.6", linewidth=0.8, zorder=2)
            way = self.path[person, first : last + 1].numpy()
            lines = LineCollection(list(np.stack((way[:-1], way[1:]), axis=1)), colors=[color], zorder=4)
            lines.set_linewidth([2.4 if last - i <= RECENT else 0.8 for i in range(first, last)])
            axes.add_collection(lines)
            touched = self.path[person, first : last + 1][self.touches[person, first : last + 1]]
            axes.plot(*touched.T.numpy(), "o", markersize=9, fillstyle="none", color=TOUCH, zorder=7)
            steps = [last - i * TRACE_PER_STEP for i in range(STEPS_BEFORE, 0, -1)]
            dots = self.path[person, [step for step in steps if step >= first]]
            axes.plot(*dots.T.numpy(), "o", color=color, markersize=4.5, zorder=5, **_EDGE)
            axes.plot(*self.path[person, last].numpy(), "*", color=color, markersize=12, zorder=6, **_EDGE)
            if last == point:
                self._mark_goal(axes, self.goal[person, point], color)
        if point == self.length:
            ended = "failed" if bool(self.rollout.failed[self.number]) else "ended"
            title += f" ({ended} at {self.length * TRACE_SECONDS:.1f} s)"
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

    def entry(label: str, **style: Any) -> Line2D:
        style = {"color": "0.3", "linestyle": "none"} | style
        return Line2D([], [], label=label, **style)

    return [
        entry("latest step", marker="*", markersize=10),
        entry("0.4, 0.8 and 1.2 s before", marker="o", markersize=4),
        entry("goal, until it is reached", marker="x", markersize=5),
        entry("way of the last 6 s", linestyle="-", linewidth=2.4),
        entry("touch", marker="o", markersize=8, fillstyle="none", color=TOUCH),
        entry("warm start", linestyle="-", linewidth=0.8, color="0.6"),
    ]
