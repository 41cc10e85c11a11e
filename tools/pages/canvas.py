"""A floor from above, on which bodies are drawn in metres, and moving pictures of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pedzoo.sim.drawing import FACE, FACE_AHEAD, HAIR, HEAD, SKIN, shoulders

Color = tuple[int, int, int]

FINER, COLORS, SWATCH = 2, 96, 12
"""Supersampling; colours of a palette; rows of pixels by which a wanted one counts in it."""

INK, ROBOT_COLOR, LIDAR = (40, 44, 52), (36, 40, 48), (255, 170, 20, 60)


class Canvas:
    """A drawn floor, on which bodies are drawn in metres."""

    def __init__(
        self, floor: Image.Image, size: tuple[float, float], width: int, corner: tuple[float, float] = (0, 0)
    ) -> None:
        """Stretch the floor over its place.

        Args:
            floor: Its picture, the largest y at the top.
            size: Width and height of the floor, metres.
            width: Pixels of the finished picture.
            corner: Its smallest x and y, metres.
        """
        self.scale, self.corner = width * FINER / size[0], np.array(corner)
        pixels = width * FINER, round(size[1] * self.scale)
        self.floor = floor.resize(pixels, Image.Resampling.NEAREST).convert("RGB")
        self.clear()

    def clear(self) -> None:
        """Start a new picture."""
        self.image = self.floor.copy()
        self.pen = ImageDraw.Draw(self.image, "RGBA")

    def pixels(self, places: Any) -> list[tuple[float, float]]:
        """Return places (N, 2), metres, in pixels."""
        places = (np.asarray(places, dtype=float).reshape(-1, 2) - self.corner) * self.scale
        return [(x, self.image.height - y) for x, y in places]

    def trail(self, places: Any, color: Color, metres: float = 0.05) -> None:
        """Draw where an agent was."""
        self.pen.line(self.pixels(places), pale(color), round(metres * self.scale), joint="curve")

    def goal(self, place: Any, color: Color) -> None:
        """Draw a ring."""
        self._disc(place, 0.2, None, color, 3 * FINER)

    def person(self, place: Any, heading: float, color: Color, larger: float = 1.0) -> None:
        """Draw shoulders and a head from above, so many times as large as they are."""
        middle, ahead = np.asarray(place), np.array([np.cos(heading), np.sin(heading)])
        self.pen.polygon(self.pixels(middle + larger * shoulders(heading)), color, INK, FINER)
        self._disc(middle, larger * HEAD, HAIR, None, 0)
        self._disc(middle + larger * FACE_AHEAD * ahead, larger * FACE, SKIN, None, 0)

    def robot(self, place: Any, heading: float, radius: float) -> None:
        """Draw a disc, and where its front is."""
        self._disc(place, radius, ROBOT_COLOR, INK, FINER)
        tip = np.asarray(place) + radius * np.array([np.cos(heading), np.sin(heading)])
        self.pen.line(self.pixels([place, tip]), LIDAR[:3], 3 * FINER)

    def label(self, place: Any, text: str, color: Any = INK) -> None:
        """Write beside a place."""
        (x, y), font = self.pixels(place)[0], ImageFont.load_default(15 * FINER)
        self.pen.text((x + 14 * FINER, y - 24 * FINER), text, color, font)

    def area(self, outline: Any) -> None:
        """Draw what a lidar sees."""
        self.pen.polygon(self.pixels(outline), LIDAR)

    def small(self) -> Image.Image:
        """Return the picture in its size."""
        return self.image.resize(
            (self.image.width // FINER, self.image.height // FINER), Image.Resampling.BOX
        )

    def finished(self, text: str) -> Image.Image:
        """Return the picture in its size, with a line of text at its lower edge."""
        small = self.small()
        result = Image.new("RGB", (small.width, small.height + 34), "white")
        result.paste(small)
        ImageDraw.Draw(result).text((8, small.height + 6), text, INK, ImageFont.load_default(19))
        return result

    def _disc(self, place: Any, radius: float, fill: Any, outline: Any, width: int) -> None:
        (x, y), far = self.pixels(place)[0], radius * self.scale
        self.pen.ellipse((x - far, y - far, x + far, y + far), fill, outline, width)


def pale(color: Color) -> Color:
    """Return the colour of a trail."""
    red, green, blue = ((2 * part + 255) // 3 for part in color)
    return red, green, blue


def headings(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a walker faces at every point (T,): its mean direction of 0.6 s, kept while it stands."""
    angle, result = 0.0, np.zeros(len(way))
    for now in range(len(way)):
        move = way[min(now + 3, len(way) - 1)] - way[max(now - 3, 0)]
        if np.linalg.norm(move) > 0.08:
            angle = float(np.arctan2(move[1], move[0]))
        result[now] = angle
    return result


def save_gif(frames: Sequence[Image.Image], out: Path, colors: Sequence[Color], seconds: float) -> None:
    """Write pictures with one palette: what does not move does not flicker, and takes no room.

    Args:
        frames: All of one size.
        out: The file.
        colors: Those that the palette must have.
        seconds: Time between frames.
    """
    few = [np.asarray(frame) for frame in frames[:: len(frames) // 6]]
    few += [np.full((SWATCH, frames[0].width, 3), color, np.uint8) for color in colors]
    palette = Image.fromarray(np.vstack(few)).quantize(COLORS)
    first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    first.save(out, save_all=True, append_images=rest, duration=round(1000 * seconds), loop=0)
