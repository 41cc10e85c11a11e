"""Draw every scenario as one contact sheet.

    python tools/pages/scenario_sheet.py [SCENARIO...] [--out PICTURE]

Floor plan, who is where when the episode begins, the 2.8 s that they have walked until then, and their ways
to their first goals. One episode is drawn strongly and others of the same seed faintly; where these have
other floor plans, the outlines of their walls are dotted. Without names all scenarios are drawn.
"""

import argparse
from pathlib import Path
from textwrap import fill
from typing import Any

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.transforms import Affine2D

from pedzoo.core.geometry import move_to_map
from pedzoo.core.registry import SCENARIOS
from pedzoo.core.spec import parse
from pedzoo.core.types import BODY_RADIUS, GOAL_RADIUS
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.segments import outlines
from pedzoo.sim.drawing import person_color
from pedzoo.sim.env import PedestrianEnv
from pedzoo.sim.make import make_env
from pedzoo.sim.scenarios._lanes import Encounter
from pedzoo.viz.plots import draw_floor_plan, write_figure

WINDOW = (14.6, 10.8)
"""Metres that a panel shows, unless a scene is larger."""

MARGIN = 1.2
"""Metres around every person's way; what they walked before it may be cut off."""

COLUMNS = 5

PANEL, GAP, HEAD, FOOT = 3.0, 0.14, 0.7, 0.42
"""Inches: a panel's width, and what is beside and above each and below all of them."""


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenarios", nargs="*", help="names with settings; none: all with their defaults")
    parser.add_argument("--episodes", type=int, default=6, help="drawn over each other")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "scenarios.png")
    options = parser.parse_args()
    names = options.scenarios or SCENARIOS.names()
    columns = min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    # everything in inches: panels of the same size, with room for two lines and a name above each
    height = PANEL * WINDOW[1] / WINDOW[0]
    size = (columns * (PANEL + GAP) + GAP, rows * (height + HEAD) + FOOT)
    figure = Figure(figsize=size)
    for number, name in enumerate(names):
        left = GAP + number % columns * (PANEL + GAP)
        bottom = FOOT + (rows - 1 - number // columns) * (height + HEAD)
        place = (left / size[0], bottom / size[1], PANEL / size[0], height / size[1])
        panel(figure.add_axes(place), name, make_env(name, num_envs=options.episodes, seed=options.seed))
    look: dict[str, Any] = {"loc": "lower center", "ncols": 7, "frameon": False}
    figure.legend(handles=legend(options.episodes), fontsize=min(9, 3 * columns), **look)
    write_figure(figure, options.out, dpi=110)
    print(f"{options.out}: {len(names)} scenarios")


def panel(axes: Axes, name: str, env: PedestrianEnv) -> None:
    """Draw the first episodes of a scenario, on the floor plan of the first and outlines of the others."""
    env.reset()
    state = env.state
    grids = {grid.map_id: (row, grid) for row, grid in enumerate(env.bank.grids)}
    _, plan = grids.get(int(state.map_id[0]), (-1, None))
    past, goal = move_to_map(state.past, state.pose), move_to_map(state.goal_point, state.pose)
    routes = {}
    for episode, person in state.mask.nonzero().tolist():
        here, row = past[episode, person, -1], grids.get(int(state.map_id[episode]), (-1, None))[0]
        way = env.prepared.planner.path(here, goal[episode, person], row)
        routes[episode, person] = torch.cat((here[None], torch.from_numpy(way).to(here)))
    draw_floor_plan(axes, plan)
    for identity in {*state.map_id.tolist()} - {int(state.map_id[0])}:
        outline(axes, grids[identity][1])
    reached = torch.cat([*routes.values()])
    frame(axes, reached.amin(0) - MARGIN, reached.amax(0) + MARGIN, open_space=plan is None)
    for (episode, person), way in routes.items():
        first, color = episode == 0, tuple(part / 255 for part in person_color(person))
        alpha = 1.0 if first else 0.22
        line = {"color": color, "zorder": 3 + first, "solid_capstyle": "round"}
        axes.plot(*past[episode, person].T, linewidth=2.0, alpha=0.9 * alpha, **line)
        axes.plot(*way.T, linewidth=0.8, alpha=0.75 * alpha, linestyle=(0, (3, 2)), **line)
        body = Circle((float(way[0, 0]), float(way[0, 1])), BODY_RADIUS * 1.5)
        body.set(color=color, alpha=alpha, linewidth=0, zorder=5 + first)
        axes.add_patch(body)
        if first:
            ring = Circle((float(way[-1, 0]), float(way[-1, 1])), GOAL_RADIUS)
            ring.set(fill=False, edgecolor=color, linewidth=1.1, zorder=4)
            axes.add_patch(ring)
    about = fill(SCENARIOS.describe(parse(name).name), 54, max_lines=2)
    size = 11 if len(name) < 20 else 7.5
    inside: dict[str, Any] = {"transform": axes.transAxes}
    axes.text(0, 1.19, name, va="bottom", fontsize=size, fontweight="bold", **inside)
    axes.text(1, 1.19, crowd(env), ha="right", va="bottom", fontsize=8, color="0.35", **inside)
    axes.text(0, 1.165, about, va="top", fontsize=7.5, color="0.35", **inside)


def outline(axes: Axes, plan: OccupancyGrid) -> None:
    """Draw the borders of the walls as thin lines, without the outer one of the whole plan."""
    x, y, yaw = plan.origin
    pose = Affine2D().scale(plan.resolution).rotate(yaw).translate(x, y)
    for corners in outlines(plan.occupied("wall")):
        if corners.min() > 0:
            border = Polygon(corners.tolist(), fill=False, edgecolor="0.25", linewidth=0.6, zorder=1)
            border.set(transform=pose + axes.transData, linestyle=(0, (1.5, 1.5)))
            axes.add_patch(border)


def crowd(env: PedestrianEnv) -> str:
    """Return how many people there are, how many there may be, and how many goals they have."""
    scenario = env.scenario
    people = f"{int(env.state.mask[0].sum())} people"
    if isinstance(scenario, Encounter):
        people += f" ({scenario.fewest} to {scenario.most})"
    return people + (f", {scenario.goals} goals each" if scenario.goals > 1 else "")


def frame(axes: Axes, low: torch.Tensor, high: torch.Tensor, open_space: bool) -> None:
    """Show a window of the usual size around what matters, or a larger one, with a bar of 2 m."""
    middle = (low + high) / 2
    larger = max(1.0, *((high - low) / torch.tensor(WINDOW)).tolist())
    half = larger * torch.tensor(WINDOW) / 2
    (left, bottom), (right, top) = (middle - half).tolist(), (middle + half).tolist()
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=[], yticks=[])
    if open_space:
        axes.set_facecolor("white")
    for spine in axes.spines.values():
        spine.set(color="0.75", linewidth=0.6)
    x, y = left + 0.04 * (right - left), bottom + 0.05 * (top - bottom)
    shade = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
    axes.plot((x, x + 2), (y, y), color="black", linewidth=2.2, solid_capstyle="butt", zorder=9)
    axes.text(x + 1, y + 0.18, "2 m", ha="center", va="bottom", fontsize=7, zorder=8, bbox=shade)


def legend(episodes: int) -> list[Line2D]:
    """Return what the marks mean."""
    marks: dict[str, dict[str, Any]] = {
        "when the episode begins": {"marker": "o", "linestyle": "none"},
        "2.8 s before": {"linewidth": 2},
        "way to the goal": {"linewidth": 0.8, "linestyle": (0, (3, 2))},
        "goal (0.3 m)": {"marker": "o", "markersize": 9, "markerfacecolor": "none", "linestyle": "none"},
        "wall": {"color": "0.45", "marker": "s", "markersize": 8, "linestyle": "none"},
        "walls in other episodes": {"color": "0.25", "linewidth": 0.6, "linestyle": (0, (1.5, 1.5))},
        f"{episodes - 1} more episodes": {"alpha": 0.25, "linewidth": 2},
    }
    usual: dict[str, Any] = {"color": "tab:blue"}
    lines = [Line2D([], [], label=label, **(usual | look)) for label, look in marks.items()]
    return lines if episodes > 1 else lines[:-2]


if __name__ == "__main__":
    main()
