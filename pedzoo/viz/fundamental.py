"""Density and speed of replayed crowds beside the real ones: the fundamental diagram as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pedzoo.core.errors import UserError
from pedzoo.eval.realism import REAL
from pedzoo.viz.figure_files import write_figure

CURVE = "density_speed"
"""Key of the curves in rows of a replay."""

RARE = 0.005
"""Densities that a smaller share of the real steps has are not drawn: their means are of a few people."""

PANEL = (2.2, 1.5)
"""Inches."""

LEAST = (3.4, 2.9)
"""Inches that the words along the sides of the whole picture take."""

LOOK: dict[str, Any] = {"color": "tab:red", "marker": ".", "lw": 1.4}
REAL_LOOK: dict[str, Any] = {"color": "black", "lw": 2.2}
"""Lines of the policy and of the real crowd."""


def plot_density_speed(rows: Sequence[Mapping[str, Any]], path: str | Path, simulated: str = "all") -> None:
    """Draw the mean speed at every density: a row of panels for each policy, a column for each recording.

    The real crowd is the black line; bars say how often a density occurs in it. Of the rows of
    `pedzoo.evaluate` those of replays are drawn, with ``all`` or ``one`` person simulated.

    Raises:
        UserError: No row is of a replay, or the file cannot be written.
    """
    mine = [row for row in rows if CURVE in row and row["case"].get("simulated") == simulated]
    if not mine:
        raise UserError("there is no density and speed to draw: evaluate the suite replay")
    folds = list(dict.fromkeys(row["case"]["fold"] for row in mine))
    names = [name for name in dict.fromkeys(row["name"] for row in mine) if name != REAL] or [REAL]
    size = PANEL[0] * len(folds) + 0.6, PANEL[1] * len(names) + 0.6
    figure = Figure(figsize=(max(size[0], LEAST[0]), max(size[1], LEAST[1])), layout="constrained")
    panels = figure.subplots(len(names), len(folds), squeeze=False, sharex="col", sharey="col")
    curves = {(row["name"], row["case"]["fold"]): row[CURVE] for row in mine}
    for i, name in enumerate(names):
        for axes, fold in zip(panels[i], folds, strict=True):
            _draw(axes, curves.get((name, fold), []))
            axes.set_title(fold if i == 0 else "", fontsize=9)
        panels[i][0].set_ylabel(name.replace(":", ":\n"), fontsize=8)
    for column in panels.T:
        column[0].set_ylim(0, 1.05 * max(axes.dataLim.y1 for axes in column))
    figure.supxlabel("people per m² within 2 m; bars: how often", fontsize=8)
    figure.supylabel("mean speed, m/s; black: the real crowd", fontsize=8)
    write_figure(figure, path)


def _draw(axes: Axes, curve: Sequence[Mapping[str, Any]]) -> None:
    """Draw one policy in one recording, beside the real crowd."""
    often = [point for point in curve if point["real_share"] >= RARE]
    density = [point["density_per_m2"] for point in often]
    share = axes.twinx()
    share.bar(density, [point["real_share"] for point in often], width=0.06, color="0.9")
    share.set_axis_off()
    axes.set_zorder(share.get_zorder() + 1)
    axes.patch.set_visible(False)
    for key, look in (("real_speed_m_per_s", REAL_LOOK), ("speed_m_per_s", LOOK)):
        speeds = [np.nan if point[key] is None else point[key] for point in often]
        axes.plot(density, speeds, **look)
    axes.tick_params(labelsize=7)
