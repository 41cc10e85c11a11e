"""Pictures of how people walked: the way so far at some moments around the one at which they meet.

A star is where an agent is, dots are where they were at the three steps of 0.4 s before.
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

from pedzoo.core.geometry import move_to_map
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.eval.comparison import PolicyRollout
from pedzoo.metrics.contacts import begins, nearest
from pedzoo.sim.drawing import goal_circle, person_color
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.state import TRACE_PER_STEP
from pedzoo.viz.plots import check_plot_path, draw_floor_plan, write_figure
from pedzoo.viz.video import ShownEpisode, check_episode

STEPS_BEFORE = 3
"""Dots behind each star."""

MOMENTS, AROUND = 3, 0.8
"""Panels from before the first meeting of all policies to after the last one, and so many seconds of it."""

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

    All walked in the same scenario. Errors: no such episode, or as of `write_figure`.
    """
    check_plot_path(path)
    shown = [_Episode(one, episode) for one in walked]
    low = torch.stack([one.low for one in shown]).amin(0) - MARGIN
    high = torch.stack([one.high for one in shown]).amax(0) + MARGIN
    plan = shown[0].plan
    if plan is not None and not plan.origin[2]:  # what lies beyond the floor plan is left out
        corner, (rows, columns) = low.new_tensor(plan.origin[:2]), plan.cells.shape
        low = low.maximum(corner)
        high = high.minimum(corner + plan.resolution * low.new_tensor([columns, rows]))
    moments = common_moments([one.met for one in shown], [one.length for one in shown])
    columns = len(moments) + 1
    wide, tall = (high - low).tolist()
    width = 2.9 if tall < wide else 2.9 * wide / tall
    width, height = max(width, 1.6), max(width * tall / wide, 0.9)  # inches
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
    """Draw the ways of one episode until a trace point, by default its end; errors as `plot_rollouts`."""
    one = _Episode(walked, episode)
    one.draw(axes, one.length if point is None else point)
    low, high = (one.low - MARGIN).tolist(), (one.high + MARGIN).tolist()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def meeting(rollout: Rollout, episode: int) -> int:
    """Return the trace point at which two people are first nearest, in the middle where no agents meet."""
    length = int(rollout.length[episode])
    one = rollout.episodes(slice(episode, episode + 1))
    gap = nearest(one.trace, one.present)[0, :, :length].amin(0)
    if not bool(gap.isfinite().any()):
        return length // 2
    return int((gap <= gap.min() + _CLOSE).nonzero()[0])


def common_moments(met: Sequence[int], lengths: Sequence[int]) -> list[int]:
    """Return the trace points that have a panel, from when policies' people meet and episodes end."""
    around, end = round(AROUND / TRACE_SECONDS), max(lengths)
    first, last = max(min(met) - around, 0), min(max(met) + around, end)
    between = [round(first + (last - first) * i / (MOMENTS - 1)) for i in range(MOMENTS)]
    return sorted({*between, end})


def meeting_and_end(walked: Sequence[PolicyRollout], episode: int = 0) -> tuple[int, int]:
    """Return the trace points at which people of most policies have met, and all episodes are over."""
    shown = [_Episode(one, episode) for one in walked]
    return median_low(one.met for one in shown), max(one.length for one in shown)


class _Episode(ShownEpisode):
    """One episode in its map's frame, ready to be drawn; point 0 is where it begins."""

    def __init__(self, walked: PolicyRollout, episode: int) -> None:
        check_episode(walked, episode)
        super().__init__(walked.rollout, episode, on_map=True)
        one = self.rollout
        self.name, self.all = walked.name, walked.rollout
        self.plan = walked.env.bank.grid(one.map_id)
        self.before = move_to_map(one.past, one.pose)[0]
        self.goal = torch.cat((self.goal[:, :1], self.goal), dim=1)
        self.low, self.high = self.seen.amin(0), self.seen.amax(0)
        self.met = min(1 + meeting(walked.rollout, episode), self.length)
        contact = ((one.agent_contact | one.wall_contact) & one.present)[0, :, : self.length]
        self.touches = torch.nn.functional.pad(begins(contact.unsqueeze(0))[0], (1, 0))

    def draw(self, axes: Axes, point: int) -> None:
        """Draw the ways until a trace point, or until the end where that is earlier."""
        draw_floor_plan(axes, self.plan)
        title = f"{point * TRACE_SECONDS:.1f} s"
        point = min(point, self.length)
        for person, first, stays_until in self.stays:
            if first > point or (first > 0 and stays_until < point):
                continue  # not there yet, or gone again
            last = min(point, stays_until)
            color, way = _color(person), self.path[person, first : last + 1]
            if first == 0:
                axes.plot(*self.before[person].T.numpy(), color="0.6", linewidth=0.8, zorder=2)
            steps = np.stack((way[:-1].numpy(), way[1:].numpy()), axis=1)
            widths = [2.4 if last - i <= RECENT else 0.8 for i in range(first, last)]
            axes.add_collection(LineCollection(list(steps), colors=[color], linewidths=widths, zorder=4))
            touched = way[self.touches[person, first : last + 1]]
            axes.plot(*touched.T.numpy(), "o", markersize=9, fillstyle="none", color=TOUCH, zorder=7)
            dots = [last - i * TRACE_PER_STEP for i in range(STEPS_BEFORE, 0, -1)]
            places = self.path[person, [dot for dot in dots if dot >= first]]
            axes.plot(*places.T.numpy(), "o", color=color, markersize=4.5, zorder=5, **_EDGE)
            axes.plot(*way[-1].numpy(), "*", color=color, markersize=12, zorder=6, **_EDGE)
            if last == point:
                goal = self.goal[person, point]
                circle = goal_circle(goal)[[*range(32), 0]]
                axes.plot(*circle.T.numpy(), color=color, linewidth=1, linestyle=":", zorder=2)
                axes.plot(*goal.numpy(), "x", color=color, markersize=5, zorder=2)
        if point == self.length:
            ended = "failed" if bool(self.rollout.failed[0]) else "ended"
            title += f" ({ended} at {self.length * TRACE_SECONDS:.1f} s)"
        axes.set_title(title, fontsize=8)

    def draw_all(self, axes: Axes) -> None:
        """Draw the ways of all episodes on this floor plan."""
        draw_floor_plan(axes, self.plan)
        same = (self.all.map_id == self.rollout.map_id).nonzero()[:, 0].tolist()
        path = move_to_map(self.all.path, self.all.pose)
        for episode in same:
            for person, first, last in self.all.stays(episode):
                way = path[episode, person, first : last + 1]
                axes.plot(*way.T.numpy(), color=_color(person), linewidth=0.8, alpha=0.5, zorder=3)
        axes.set_title(f"all {len(same)} episodes", fontsize=8)


_EDGE = {"markeredgecolor": "white", "markeredgewidth": 0.6}


def _color(person: int) -> tuple[float, ...]:
    return tuple(value / 255 for value in person_color(person))


def legend() -> list[Line2D]:
    """Return the entries of a legend for what is drawn."""
    entries: dict[str, dict[str, Any]] = {
        "latest step": {"marker": "*", "markersize": 10},
        "0.4, 0.8 and 1.2 s before": {"marker": "o", "markersize": 4},
        "goal, until it is reached": {"marker": "x", "markersize": 5},
        "way of the last 6 s": {"linestyle": "-", "linewidth": 2.4},
        "touch": {"marker": "o", "markersize": 8, "fillstyle": "none", "color": TOUCH},
        "warm start": {"linestyle": "-", "linewidth": 0.8, "color": "0.6"},
    }
    usual: dict[str, Any] = {"color": "0.3", "linestyle": "none"}
    return [Line2D([], [], label=label, **(usual | style)) for label, style in entries.items()]
