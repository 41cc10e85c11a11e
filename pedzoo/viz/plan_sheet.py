"""Floor plans as one picture: rooms tinted by what they are for, furniture, doors and walls."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.core.paths import write_atomically
from pedzoo.maps.procedural import FloorPlan
from pedzoo.maps.shapes import UNIT, Rect

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
PAPER, INK = (255, 255, 255), (40, 40, 40)

_GAP = 16
_LINE = 22  # pixels of a line of text


def sheet(plans: Sequence[FloorPlan], width: int = 1600) -> NDArray[np.uint8]:
    """Return a picture of floor plans (height, width, RGB), one pixel per 5 cm, with their names.

    It is wider than ``width`` where one plan is.
    """
    width = max([width, *(round(plan.size[0] / UNIT) + 2 * _GAP for plan in plans)])
    rows: list[list[FloorPlan]] = [[]]
    left = width - _GAP
    for plan in plans:
        needed = round(plan.size[0] / UNIT) + _GAP
        if rows[-1] and (needed > left or plan.kind != rows[-1][-1].kind):
            rows.append([])
            left = width - _GAP
        rows[-1].append(plan)
        left -= needed
    uses = [use for use in TINTS if any(room.use == use for plan in plans for room in plan.rooms)]
    return np.concatenate([*(_row(row, width) for row in rows), _legend(uses, width)])


def save_sheet(plans: Sequence[FloorPlan], file: Path) -> None:
    """Write the `sheet` of floor plans as a png, whole or not at all."""
    import cv2

    picture = np.ascontiguousarray(sheet(plans)[..., ::-1])
    _, encoded = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    write_atomically(file, encoded.tobytes())


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


def _row(plans: Sequence[FloorPlan], width: int) -> NDArray[np.uint8]:
    pictures = [draw(plan) for plan in plans]
    row = np.full((max(map(len, pictures)) + _LINE + _GAP, width, 3), PAPER, dtype=np.uint8)
    x = _GAP
    for plan, picture in zip(plans, pictures, strict=True):
        row[_LINE : _LINE + len(picture), x : x + picture.shape[1]] = picture
        _write(row, plan.grid.name, x)
        x += picture.shape[1] + _GAP
    return row


def _legend(uses: Sequence[str], width: int) -> NDArray[np.uint8]:
    line = np.full((_LINE + _GAP, width, 3), PAPER, dtype=np.uint8)
    x = _GAP
    for use in uses:
        line[2:18, x : x + 16] = TINTS[use]
        _write(line, use.replace("_", " "), x + 22)
        x += 22 + 9 * len(use) + 2 * _GAP
    return line


def _write(image: Any, text: str, x: int) -> None:
    import cv2

    cv2.putText(image, text, (x, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)
