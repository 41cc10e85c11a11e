"""Plots as files: forecasts, floor plans, and density and speed of crowds beside the real ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from pedzoo.core.errors import UserError
from pedzoo.core.paths import PLOTS, check_ending, write_atomically
from pedzoo.maps.grid import FREE, OCCUPIED, OccupancyGrid
from pedzoo.maps.procedural import FloorPlan
from pedzoo.maps.shapes import UNIT, Rect
from pedzoo.metrics.forecast import positions
from pedzoo.models.base import Forecaster
from pedzoo.viz.report import RARE, REAL

if TYPE_CHECKING:
    from pedzoo.data.datamodule import TrajectoryDataModule  # needs lightning, which other plots do not

MARGIN = 2.0
"""Metres around people that a panel shows."""

CURVE = "density_speed"
"""Key of the curves in rows of a replay."""

PANEL, LEAST = (2.2, 1.5), (3.4, 2.9)
"""Inches of a panel, and those that the words along the sides of the whole picture take."""

LOOK: dict[str, Any] = {"color": "tab:red", "marker": ".", "lw": 1.4}
REAL_LOOK: dict[str, Any] = {"color": "black", "lw": 2.2}
"""Lines of the policy and of the real crowd."""

TINTS = {
    "hall": (245, 236, 224),
    "living": (216, 240, 214),
    "kitchen": (251, 221, 200),
    "bedroom": (214, 225, 246),
    "bathroom": (200, 239, 240),
    "study": (240, 215, 235),
    "storage": (221, 221, 221),
    "corridor": (245, 236, 224),
    "office": (221, 234, 247),
    "meeting": (236, 235, 210),
    "open_plan": (222, 245, 216),
    "toilets": (200, 239, 240),
}
"""Red, green and blue of a room's floor."""

WALLS, FURNITURE, DOORS = (56, 56, 56), (122, 132, 152), (255, 164, 120)


def check_plot_path(path: str | Path) -> None:
    """Raise the error that a file name gives which no plot can have."""
    check_ending(f"plot {str(path)!r}", path, PLOTS)


def write_figure(figure: Figure, path: str | Path, dpi: int = 130) -> None:
    """Write a picture, whole or not at all; its folder is made where it is missing.

    Raises:
        UserError: Another ending than `pedzoo.core.paths.PLOTS`, or the file cannot be written.
    """
    check_plot_path(path)
    data = BytesIO()
    figure.savefig(data, format=Path(path).suffix[1:].lower(), dpi=dpi)
    write_atomically(Path(path), data.getvalue())


@torch.no_grad()
def plot_forecasts(
    model: Forecaster,
    data: TrajectoryDataModule,
    path: str | Path,
    panels: int = 6,
    samples: int = 20,
    seed: int = 0,
) -> None:
    """Draw scenes with three people or more, evenly spread over the test split, under the data's protocol.

    ``samples`` random futures per person, of ``seed``, stand beside the mode.
    """
    data.setup("test")
    scenes = data.sets["test"]
    crowded = (scenes.sizes >= min(3, int(scenes.sizes.max()))).nonzero().flatten()
    chosen = crowded[torch.linspace(0, len(crowded) - 1, min(panels, len(crowded))).long()]
    batch = scenes.batch(chosen, data.goal, generator=torch.Generator().manual_seed(seed))
    agents: Any = batch["agents"]
    random = torch.Generator().manual_seed(seed)
    futures = positions(model.sample(batch, samples, data.pred_len, random), agents["history"])
    mode = positions(model.mode(batch, data.pred_len), agents["history"])

    goals, columns = "goal" in agents.keys(), min(3, len(chosen))
    rows = len(chosen) // columns  # no empty panels
    figure = Figure(figsize=(4.2 * columns, 4.2 * rows + 0.5), layout="constrained")
    for i, axes in enumerate(figure.subplots(rows, columns, squeeze=False).flat):
        here = agents["mask"][i]
        draw_floor_plan(axes, data.bank.grid(batch["map_id"][i]))
        for person in here.nonzero()[:, 0].tolist():
            history, last = agents["history"][i, person], agents["history"][i, person, -1:]
            for sample in futures[i][:, person]:
                way = torch.cat((last, sample))
                axes.plot(*way.T.numpy(), color="tab:orange", alpha=0.25, linewidth=1, zorder=2)
            axes.plot(*history.T.numpy(), color="black", linewidth=1.5, zorder=3)
            real = torch.cat((last, agents["future"][i, person]))
            likely = torch.cat((last, mode[i, 0, person]))
            axes.plot(*real.T.numpy(), color="tab:green", linewidth=2, zorder=3)
            axes.plot(*likely.T.numpy(), color="tab:red", linewidth=1.5, linestyle="--", zorder=4)
            axes.plot(*last[0].numpy(), "o", color="black", markersize=4, zorder=5)
            if goals:
                axes.plot(*agents["goal"][i, person].numpy(), "x", color="tab:blue", markersize=6, zorder=5)
        seen = torch.cat((agents["history"], agents["future"]), 2)[i, here].flatten(0, 1)
        low, high = seen.amin(0), seen.amax(0)
        (x, y), half = ((low + high) / 2).tolist(), float((high - low).max()) / 2 + MARGIN
        axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal")
        axes.tick_params(labelsize=7)
        axes.set_xlabel("x, m", fontsize=7)
        axes.set_ylabel("y, m", fontsize=7)
        axes.set_title(f"test window {int(chosen[i])}", fontsize=9)
    handles = [
        Line2D([], [], color="black", marker="o", markersize=4, label="seen"),
        Line2D([], [], color="tab:green", linewidth=2, label="what happened"),
        Line2D([], [], color="tab:red", linestyle="--", label="mode"),
        Line2D([], [], color="tab:orange", alpha=0.5, label=f"{samples} samples"),
    ]
    if goals:
        handles.append(Line2D([], [], color="tab:blue", marker="x", linestyle="none", label="goal"))
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False)
    steps = f"{data.obs_len} steps seen, {data.pred_len} predicted"
    figure.suptitle(f"{type(model).__name__}: {steps}, goal: {data.goal}")
    write_figure(figure, path, dpi=110)


def draw_floor_plan(axes: Axes, grid: OccupancyGrid | None) -> None:
    """Draw walls dark, and unknown cells and all beyond the plan grey, in world coordinates."""
    if grid is None:
        return
    axes.set_facecolor("0.85")
    height, width = grid.cells.shape
    shade = torch.full((height, width), 0.85)
    shade[torch.from_numpy(grid.cells == FREE)] = 1.0
    shade[torch.from_numpy(grid.cells == OCCUPIED)] = 0.45
    x, y, yaw = grid.origin
    pose = Affine2D().scale(grid.resolution).rotate(yaw).translate(x, y)
    extent = (0, width, 0, height)
    image = axes.imshow(shade.numpy(), cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent, zorder=0)
    image.set_transform(pose + axes.transData)


def plot_density_speed(rows: Sequence[Mapping[str, Any]], path: str | Path, simulated: str = "all") -> None:
    """Draw the mean speed at every density: a row of panels for each policy, a column for each recording.

    The real crowd is the black line; bars say how often a density occurs in it. Rows of `pedzoo.evaluate` are
    drawn that are of replays with ``all`` or ``one`` person simulated.

    Raises:
        UserError: No row is of a replay, or the file cannot be written.
    """
    mine = [row for row in rows if CURVE in row and row["case"].get("simulated") == simulated]
    if not mine:
        raise UserError("there is no density and speed to draw: evaluate the suite replay")
    folds = list(dict.fromkeys(row["case"]["fold"] for row in mine))
    names = [name for name in dict.fromkeys(row["name"] for row in mine) if name != REAL] or [REAL]
    size = max(PANEL[0] * len(folds) + 0.6, LEAST[0]), max(PANEL[1] * len(names) + 0.6, LEAST[1])
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(names), len(folds), squeeze=False, sharex="col", sharey="col")
    curves = {(row["name"], row["case"]["fold"]): row[CURVE] for row in mine}
    for i, name in enumerate(names):
        for axes, fold in zip(panels[i], folds, strict=True):
            often = [point for point in curves.get((name, fold), ()) if point["real_share"] >= RARE]
            density = [point["density_per_m2"] for point in often]
            share = axes.twinx()
            share.bar(density, [point["real_share"] for point in often], width=0.06, color="0.9")
            share.set_axis_off()
            axes.set_zorder(share.get_zorder() + 1)
            axes.patch.set_visible(False)
            for key, look in (("real_speed_m_per_s", REAL_LOOK), ("speed_m_per_s", LOOK)):
                axes.plot(density, [np.nan if point[key] is None else point[key] for point in often], **look)
            axes.tick_params(labelsize=7)
            axes.set_title(fold if i == 0 else "", fontsize=9)
        panels[i][0].set_ylabel(name.replace(":", ":\n"), fontsize=8)
    for column in panels.T:
        column[0].set_ylim(0, 1.05 * max(axes.dataLim.y1 for axes in column))
    figure.supxlabel("people per m² within 2 m; bars: how often", fontsize=8)
    figure.supylabel("mean speed, m/s; black: the real crowd", fontsize=8)
    write_figure(figure, path)


def save_sheet(plans: Sequence[FloorPlan], path: str | Path) -> None:
    """Draw floor plans with their names and sizes, and what the colours of rooms say.

    Raises:
        UserError: Another ending than `pedzoo.core.paths.PLOTS`, or the file cannot be written.
    """
    columns = min(4, len(plans))
    rows = -(-len(plans) // columns)
    figure = Figure(figsize=(16, rows * 12 / columns + 0.6), layout="constrained")
    panels = [*figure.subplots(rows, columns, squeeze=False).flat]
    for axes in panels:
        axes.set_axis_off()
    for axes, plan in zip(panels, plans, strict=False):
        axes.imshow(draw(plan))
        axes.set_title(f"{plan.grid.name}, {plan.size[0]:.1f} x {plan.size[1]:.1f} m", fontsize=9)
    used = [use for use in TINTS if any(room.use == use for plan in plans for room in plan.rooms)]
    handles = [Patch(color=tuple(np.array(TINTS[use]) / 255), label=use.replace("_", " ")) for use in used]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    write_figure(figure, path, dpi=100)


def draw(plan: FloorPlan) -> NDArray[np.uint8]:
    """Return a picture of a floor plan (height, width, RGB), one pixel per 5 cm, the largest y at the top."""
    width, height = (round(side / UNIT) for side in plan.size)
    image = np.full((height, width, 3), WALLS, dtype=np.uint8)

    def fill(rect: Rect, color: tuple[int, int, int]) -> None:
        image[rect.y0 : rect.y1, rect.x0 : rect.x1] = color

    for room in plan.rooms:
        for part in room.parts:
            fill(part, TINTS[room.use])
    for door in plan.doors:
        fill(door.opening, DOORS)
    for piece in plan.pieces:
        fill(piece.rect, FURNITURE)
    return np.flipud(image)
