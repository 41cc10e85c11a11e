"""Draw half a minute of zara2 twice, real and simulated, unlabelled: python tools/pages/crowd_twice.py.

``docs/pictures/zara2_twice.gif``, in real time. ``docs/score.md`` shows it and says which side is real.
The recordings are found by PEDZOO_DATA. It takes a minute.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.interpolate import PchipInterpolator

from pedzoo.core.types import STEP_SECONDS, TRACE_SECONDS
from pedzoo.eval.rollout import rollout
from pedzoo.maps.grid import OCCUPIED, OccupancyGrid
from pedzoo.metrics.realism.features import SampledRollout, coarse, every_step
from pedzoo.metrics.smoothness import acceleration, heading_rate
from pedzoo.sim.camera import person_color
from pedzoo.sim.rollout import joined
from pedzoo.sim.scenarios.replay import PreparedReplay
from tools.pages.canvas import FINER, INK, Canvas, headings, pale, save_gif

OUT = Path(__file__).parents[2] / "docs" / "pictures" / "zara2_twice.gif"

POLICY, SCENARIO = "social_walker.styled_zara2", "replay:fold=zara2,share=0.3"
"""Weights that did not see zara2, and the first two minutes of it, in which they move all people."""

SIDE_SEED = 22
"""Decides which side is real."""

REAL = random.Random(SIDE_SEED).choice("AB")

SECONDS, LATEST = 28.0, 110.0
"""Length of the picture, and its latest end in the recording."""

PANEL, GAP, HEADER, MARGIN = 448, 8, 34, 0.5
"""Pixels of each side, between them and above them; metres around people's paths."""

LARGER, TRAIL = 1.4, 20
"""Bodies are drawn so many times as large as they are; trace points of a trail."""

BUILDING, STREET = (206, 208, 214), (248, 247, 243)


class Walk:
    """One person's stay: places and headings every 0.1 s from ``begin``, a trace point."""

    def __init__(self, person: int, begin: int, xy: NDArray[np.float64]) -> None:
        """Interpolate places (N, 2) every 0.4 s, metres, without overshoot."""
        fine = round(STEP_SECONDS / TRACE_SECONDS)
        time = np.arange(fine * (len(xy) - 1) + 1) / fine
        self.begin, self.color = begin, person_color(person)
        self.xy = PchipInterpolator(np.arange(len(xy)), xy)(time)
        self.heading = headings(self.xy)


def walks_of(steps: SampledRollout) -> list[Walk]:
    """Return all stays of at least two steps in the one scene of a rollout.

    Both sides are sampled every 0.4 s and averaged over three steps. So annotation jitter, and the traces
    in between, tell nothing.
    """
    steps = coarse(steps)
    fine = round(STEP_SECONDS / TRACE_SECONDS)
    walks = []
    for person, xy in zip(steps.person[0].numpy(), steps.xy[0].double().numpy(), strict=True):
        edges = np.flatnonzero(np.diff(person, prepend=-1, append=-1))
        for begin, end in pairwise(edges.tolist()):
            if person[begin] >= 0 and end - begin > 1:
                walks.append(Walk(int(person[begin]), fine * begin, xy[begin:end]))
    return walks


def busiest(walks: list[Walk]) -> int:
    """Return the trace point, a full second, from which on most real people are seen."""
    points = round(LATEST / TRACE_SECONDS)
    count = np.zeros(points)
    for walk in walks:
        count[walk.begin : walk.begin + len(walk.xy)] += 1
    length = round(SECONDS / TRACE_SECONDS)
    starts = np.arange(0, points - length, round(1 / TRACE_SECONDS))
    return int(starts[np.argmax([count[start : start + length].sum() for start in starts])])


def present(walks: list[Walk], point: int) -> Iterator[tuple[Walk, int]]:
    """Yield the walks of people who are there at a trace point, and its number in each."""
    for walk in walks:
        if 0 <= point - walk.begin < len(walk.xy):
            yield walk, point - walk.begin


def street(grid: OccupancyGrid, low: NDArray[np.float64], high: NDArray[np.float64]) -> Canvas:
    """Return the floor between two corners (2,), metres, with the outlines of its buildings."""
    width, height = (float(side) for side in high - low)
    canvas = Canvas(Image.new("RGB", (1, 1), STREET), (width, height), PANEL, (float(low[0]), float(low[1])))
    wall = np.ascontiguousarray(grid.cells == OCCUPIED, dtype=np.uint8)
    outlines = cv2.findContours(wall, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    for outline in outlines:
        corners = (outline[:, 0] + 0.5) * grid.resolution + grid.origin[:2]
        canvas.pen.polygon(canvas.pixels(corners), BUILDING, INK, FINER)
    canvas.floor = canvas.image.copy()
    return canvas


def picture(canvas: Canvas, sides: dict[str, list[Walk]], point: int) -> Image.Image:
    """Return both sides at a trace point beside each other, A to the left."""
    height = canvas.small().height
    result = Image.new("RGB", (2 * PANEL + GAP, HEADER + height), "white")
    for left, name in zip((0, PANEL + GAP), "AB", strict=True):
        canvas.clear()
        for walk, now in present(sides[name], point):
            canvas.trail(walk.xy[max(0, now - TRAIL) : now + 1], walk.color)
        for walk, now in present(sides[name], point):
            canvas.person(walk.xy[now], float(walk.heading[now]), walk.color, LARGER)
        result.paste(canvas.small(), (left, HEADER))
        place = (left + PANEL // 2, HEADER // 2)
        ImageDraw.Draw(result).text(place, name, INK, ImageFont.load_default(22), anchor="mm")
    return result


def unsteadiness(steps: SampledRollout, start: int) -> str:
    """Return how much people turn and change speed within 0.4 s of the picture's time: 95th percentiles."""
    begin = round(start * TRACE_SECONDS / STEP_SECONDS)
    seen = slice(begin, begin + round(SECONDS / STEP_SECONDS))
    steps = coarse(steps)
    values = []
    for measure in (heading_rate, acceleration):
        value, known = measure(steps.velocity[:, :, seen], steps.known[:, :, seen])
        values.append(float(value[known].abs().quantile(0.95)))
    return f"{np.degrees(values[0]) * STEP_SECONDS:.0f} degrees and {values[1]:.2f} m/s2"


def main() -> None:
    """Walk, choose the half minute by the recording alone, and draw it."""
    walked, env = rollout(POLICY, SCENARIO, physics="compiled", episodes=1)
    prepared = env.prepared
    assert isinstance(prepared, PreparedReplay)
    steps = [every_step(one) for one in (walked, joined(list(prepared.real_parts())))]
    simulated, real = map(walks_of, steps)
    start = busiest(real)
    points = range(start, start + round(SECONDS / TRACE_SECONDS))
    both = [*real, *simulated]
    seen = np.array([walk.xy[now] for point in points for walk, now in present(both, point)])
    canvas = street(prepared.bank.grids[0], seen.min(0) - MARGIN, seen.max(0) + MARGIN)
    other = "AB".replace(REAL, "")
    sides = {REAL: real, other: simulated}
    frames = [picture(canvas, sides, point) for point in points]
    colors = {walk.color for point in points for walk, _ in present(both, point)}
    save_gif(frames, OUT, [*colors, *map(pale, colors)], TRACE_SECONDS)
    print(f"{OUT}: from {start * TRACE_SECONDS:.0f} s on, {OUT.stat().st_size / 1e6:.1f} MB")
    for name, one in zip((f"{other}, simulated", f"{REAL}, real"), steps, strict=True):
        print(f"{name}: {unsteadiness(one, start)}")


if __name__ == "__main__":
    main()
