"""Draw the README's moving picture: python tools/pages/make_readme_picture.py [SCENARIO] [OUT.gif].

The same people at the same door, in real time: weights trained to forecast, the same trained on in the loop,
and ORCA. People who touch others or a wall are red.
"""

from __future__ import annotations

import sys

import torch
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from pedzoo.core.geometry import move_to_map
from pedzoo.core.types import BODY_RADIUS, TRACE_SECONDS
from pedzoo.eval.rollout import rollout
from pedzoo.metrics.safety import begins
from pedzoo.viz.plots import draw_floor_plan

POLICIES = {
    "sgan_goal_map.controller_open": "trained to forecast",
    "sgan_goal_map.indoor": "trained in the loop",
    "orca:radius=0.3": "ORCA, radius 0.3 m",
}
SECONDS = 9
"""Of the episode, at most."""

COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:purple", "tab:cyan", "tab:olive")
"""Of people, in turn; red is for people who touch something."""

WINDOW = (-3.6, 3.6), (-2.2, 2.2)
"""Metres that a panel shows, the door in the middle."""

LINGERS = 5
"""Frames for which a touch is seen."""

TRAIL = 15
"""Frames."""


class Panel:
    """One policy's first episode."""

    def __init__(self, axes: Axes, policy: str, scenario: str) -> None:
        """Walk, and draw what does not move."""
        walked, env = rollout(policy, scenario, "compiled", 1)
        grid = next(grid for grid in env.bank.grids if grid.map_id == int(walked.map_id[0]))
        draw_floor_plan(axes, grid)
        axes.set(xlim=WINDOW[0], ylim=WINDOW[1], aspect="equal")
        axes.set_axis_off()
        self.axes, self.title = axes, POLICIES[policy]
        self.path = move_to_map(walked.path, walked.pose)[0]
        self.present = walked.present[0]
        touched = walked.agent_contact[0] | walked.wall_contact[0]
        self.events = begins(touched).sum(0).cumsum(0)
        before = torch.nn.functional.pad(touched, (LINGERS, 0)).unfold(-1, LINGERS + 1, 1)
        self.red = before.any(-1)
        self.length = int(walked.length[0])
        self.colors = [COLORS[person % len(COLORS)] for person in range(len(self.path))]
        self.trails = LineCollection([], linewidth=1.5, alpha=0.6)
        width = torch.full((len(self.path),), 2 * BODY_RADIUS).numpy()
        self.people = EllipseCollection(
            width, width, width * 0, units="xy", offset_transform=axes.transData, edgecolors="black"
        )
        for artist in (self.trails, self.people):
            axes.add_collection(artist)

    def draw(self, frame: int) -> list[Artist]:
        """Draw a moment; after the episode its last one."""
        frame = min(frame, self.length - 1)
        here = self.present[:, frame].nonzero()[:, 0].tolist()
        self.people.set_offsets(self.path[here, frame + 1].numpy())
        self.people.set_facecolor(["red" if self.red[who, frame] else self.colors[who] for who in here])
        self.trails.set_segments([self.path[who, max(frame - TRAIL, 0) : frame + 2].numpy() for who in here])
        self.trails.set_color([self.colors[who] for who in here])
        touches = int(self.events[frame])
        self.axes.set_title(
            f"{self.title}: {touches or 'no'} {'touch' if touches == 1 else 'touches'}", fontsize=9
        )
        return [self.people, self.trails]


def main(scenario: str = "door:people=4,width=0.8", out: str = "tools/pages/readme.gif") -> None:
    """Draw the first episode of a scenario."""
    figure = Figure(figsize=(9.6, 2.2), layout="constrained")
    rows = zip(figure.subplots(1, len(POLICIES)), POLICIES, strict=True)
    panels = [Panel(axes, policy, scenario) for axes, policy in rows]
    frames = min(max(panel.length for panel in panels) + LINGERS, round(SECONDS / TRACE_SECONDS))

    def draw(frame: int) -> list[Artist]:
        return [artist for panel in panels for artist in panel.draw(frame)]

    FuncAnimation(figure, draw, frames=frames).save(out, PillowWriter(fps=round(1 / TRACE_SECONDS)), dpi=90)  # type: ignore[arg-type]
    print(out)


if __name__ == "__main__":
    main(*sys.argv[1:])
