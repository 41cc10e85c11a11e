"""Draw the README's moving picture: python tools/make_readme_picture.py [MODEL] [OUT.gif].

A model's forecasts over the embedded, synthetic plaza, step after step.
"""

from __future__ import annotations

import sys
from typing import Any

import torch
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.plots import draw_floor_plan
from pedzoo.metrics.displacement import positions
from pedzoo.models.zoo import load

FIRST, FRAMES, SAMPLES = 60, 60, 12


@torch.no_grad()
def main(name: str = "sgan_goal.zara1_destination", out: str = "tools/readme.gif") -> None:
    """Draw ``FRAMES`` consecutive windows of the plaza's test recording."""
    model = load(name)
    data = TrajectoryDataModule(goal="destination", people="present", min_people=1)
    data.setup("test")
    model.bind(data.bank)
    batch = data.sets["test"].batch(torch.arange(FIRST, FIRST + FRAMES), "destination")
    agents: Any = batch["agents"]
    start = agents["history"][:, None, :, -1:]
    paths = positions(model.sample(batch, SAMPLES, 12, torch.Generator().manual_seed(0)), agents["history"])
    paths = torch.cat((start.expand(-1, SAMPLES, -1, -1, -1), paths), -2)
    mode = torch.cat((start[:, 0], positions(model.mode(batch, 12), agents["history"])[:, 0]), -2)

    figure = Figure(figsize=(6.0, 4.2), layout="tight")
    axes = figure.subplots()
    draw_floor_plan(axes, data.bank.grids[0])
    axes.set_xlim(-12, 12)
    axes.set_ylim(-8, 8)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"{name}: seen (black), 12 futures (orange), the most likely (red)", fontsize=8)
    lines = [LineCollection([], color=c, alpha=a, linewidth=w) for c, a, w in
             (("tab:orange", 0.3, 1), ("black", 1, 1.5), ("tab:red", 1, 1.5))]  # fmt: skip
    for collection in lines:
        axes.add_collection(collection)
    people = axes.scatter([], [], s=18, color="black", zorder=5)

    def draw(i: int) -> list[Any]:
        here = agents["mask"][i]
        lines[0].set_segments(list(paths[i][:, here].flatten(0, 1).numpy()))
        lines[1].set_segments(list(agents["history"][i, here].numpy()))
        lines[2].set_segments(list(mode[i, here].numpy()))
        people.set_offsets(start[i, 0, here, 0].numpy())
        return [*lines, people]

    FuncAnimation(figure, draw, frames=FRAMES).save(out, PillowWriter(fps=5), dpi=90)  # type: ignore[arg-type]
    print(out)


if __name__ == "__main__":
    main(*sys.argv[1:])
