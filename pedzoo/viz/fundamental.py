"""Density and speed of replayed crowds beside the real ones: the fundamental diagram as a picture."""

from collections.abc import Mapping, Sequence
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pedzoo.core.errors import UserError
from pedzoo.eval.realism import REAL

CURVE = "density_speed"
"""Key of the curves in rows of a replay."""

RARE = 0.005
"""Densities that a smaller share of the real steps has are not drawn: their means are of a few people."""

PANEL = (4.2, 3.4)
"""Inches."""


def plot_density_speed(rows: Sequence[Mapping[str, Any]], path: str | Path, simulated: str = "all") -> None:
    """Draw the mean speed at every density, a panel for each recording, a line for each policy.

    The real crowd is the thick line; bars say how often a density occurs in it. Of the rows of
    `pedzoo.evaluate` those of replays are drawn, with ``all`` or ``one`` person simulated.

    Raises:
        UserError: No row is of a replay.
    """
    mine = [row for row in rows if CURVE in row and row["case"].get("simulated") == simulated]
    if not mine:
        raise UserError("there is no density and speed to draw: evaluate the suite replay")
    folds = list(dict.fromkeys(row["case"]["fold"] for row in mine))
    names = [name for name in dict.fromkeys(row["name"] for row in mine) if name != REAL]
    # policies beyond ten have the same colours again, dashed
    looks = product(("-", "--", ":"), colormaps["tab10"].colors)  # pyright: ignore
    styles = {
        name: {"color": colour, "ls": line, "lw": 1.3}
        for name, (line, colour) in zip(names, cycle(looks), strict=False)
    }
    styles[REAL] = {"color": "black", "lw": 3, "zorder": 3}
    columns = min(3, len(folds))
    lines = -(-len(folds) // columns)
    size = (PANEL[0] * columns, PANEL[1] * lines + 0.6)
    figure = Figure(figsize=size, layout="constrained")
    panels = list(figure.subplots(lines, columns, squeeze=False).flat)
    for axes, fold in zip(panels, folds, strict=False):
        _draw(axes, fold, [row for row in mine if row["case"]["fold"] == fold], styles)
    for axes in panels[len(folds) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)


def _draw(axes: Axes, fold: str, rows: Sequence[Mapping[str, Any]], styles: Mapping[str, Any]) -> None:
    """Draw one recording."""
    curve = rows[0][CURVE]
    often = np.array([bin["real_share"] for bin in curve]) >= RARE
    density = np.array([bin["density_per_m2"] for bin in curve])[often]
    share = axes.twinx()
    share.bar(density, np.array([bin["real_share"] for bin in curve])[often], width=0.06, color="0.9")
    share.set_axis_off()
    axes.set_zorder(share.get_zorder() + 1)
    axes.patch.set_visible(False)
    for row in rows:
        speeds = [bin["speed_m_per_s"] for bin in row[CURVE]]
        speed = np.array([np.nan if one is None else one for one in speeds], dtype=float)[often]
        axes.plot(density, speed, marker=".", label=row["name"], **styles[row["name"]])
    axes.set_title(fold)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("people per m² within 2 m", fontsize=8)
    axes.set_ylabel("mean speed, m/s", fontsize=8)
