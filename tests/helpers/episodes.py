"""Positions of episodes as results keep them, read again."""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pedzoo.maps.grid import OccupancyGrid


def unpacked_tracks(packed: Mapping[str, Any]) -> list[NDArray[np.float64]]:
    """Return the positions (N, 2) of every entry of ``people``, metres."""
    numbers = np.split(_numbers(packed["xy"]), 2 * np.cumsum(packed["counts"])[:-1])
    return [part.reshape(-1, 2).cumsum(0).cumsum(0) / 1000 for part in numbers]


def unpacked_plan(packed: Mapping[str, Any]) -> OccupancyGrid:
    """Return the floor plan that was packed."""
    runs = _numbers(packed["runs"])
    cells = np.repeat(runs % 4, runs // 4).reshape(packed["rows"], packed["columns"])
    x, y, yaw = packed["origin"]
    return OccupancyGrid(cells.astype(np.uint8), packed["cell"], (x, y, yaw), name=packed["name"])


def _numbers(text: str) -> NDArray[np.int64]:
    """Return the numbers of base64 of varints."""
    data = np.frombuffer(base64.b64decode(text), dtype=np.uint8).astype(np.int64)
    if not len(data):
        return data
    ends = np.flatnonzero(data < 128)
    starts = np.concatenate(([0], ends[:-1] + 1))
    place = np.arange(len(data)) - np.repeat(starts, ends - starts + 1)
    signed = np.add.reduceat((data & 127) << (7 * place), starts)
    return (signed >> 1) ^ -(signed & 1)
