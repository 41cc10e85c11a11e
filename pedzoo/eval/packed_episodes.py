"""A compact form of the positions of episodes: results store them so, and `pedzoo report` draws them.

Positions are whole millimetres in the floor plan's frame. Of every person the first one is written, then the
first step, then how each step differs from the one before. All numbers are varints of seven bits a byte, with
the sign in the lowest bit, and stand as base64 in JSON. A person who walks takes about two bytes per 0.1 s.
"""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.batch import ROBOT
from pedzoo.core.geometry import move_to_map
from pedzoo.core.types import TRACE_SECONDS
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.metrics.arrival import arrived_in_time
from pedzoo.metrics.contacts import contact_events
from pedzoo.sim.rollout import Rollout

LONGEST = 120.0
"""Seconds of an episode that are stored."""

CELLS = 600
"""Floor plans of more cells along a side are stored in coarser ones."""

_MM = 1000
_BYTES = 10  # that a varint of 64 bits can have


def packed_episodes(
    rollout: Rollout, bank: MapBank, number: int, seed: int = 0
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the first ``number`` episodes of a rollout, and their floor plans by name, ready for JSON."""
    shown = range(min(number, len(rollout.failed)))
    ids = {int(one) for one in rollout.map_id[: len(shown)]}
    plans = {str(grid.map_id): packed_plan(grid) for grid in bank.grids if grid.map_id in ids}
    return [packed_episode(rollout, episode, seed) for episode in shown], plans


def packed_episode(rollout: Rollout, episode: int, seed: int = 0) -> dict[str, Any]:
    """Return one episode; point 0 is where it begins.

    ``people`` has one entry for every stay of a person in the scene. ``goals`` are [point, x, y] wherever
    they change; ``touch`` and ``wall`` are runs of points [first, last]. ``xy`` has the positions of all
    people, ``counts`` says how many each has. ``values`` are numbers by which episodes are looked for.
    """
    one = rollout.episodes(slice(episode, episode + 1))
    points = min(int(one.length[0]), round(LONGEST / TRACE_SECONDS))
    path = move_to_map(one.path, one.pose)[0, :, : points + 1]
    goal = move_to_map(one.goal, one.pose)[0, :, :points]
    goal = torch.cat((goal[:, :1], goal), dim=1)
    people, tracks = [], []
    for slot, first, last in rollout.stays(episode):
        last = min(last, points)
        if first > last:
            continue
        while_here = slice(max(first - 1, 0), last)
        tracks.append(path[slot, first : last + 1].double().numpy())
        people.append(
            {
                "slot": slot,
                "person": int(one.person[0, slot, min(first, points - 1)]) if points else slot,
                "robot": int(one.kind[0, slot]) == ROBOT,
                "radius": round(float(one.radius[0, slot]), 3),
                "first": first,
                "goals": _changes(goal[slot, first : last + 1], first),
                "touch": _runs(one.agent_contact[0, slot, while_here], while_here.start + 1),
                "wall": _runs(one.wall_contact[0, slot, while_here], while_here.start + 1),
            }
        )
    touches = {"agent_contacts": one.agent_contact, "wall_contacts": one.wall_contact}
    values = {key: int(contact_events(touch & one.scored).sum()) for key, touch in touches.items()}
    success = float(arrived_in_time(one)[one.mask].sum()) / (int(one.mask.sum()) or 1)
    return {
        "episode": episode,
        "seed": seed,
        "plan": str(int(one.map_id[0])) if int(one.map_id[0]) >= 0 else None,
        "points": points,
        "dt": TRACE_SECONDS,
        "people": people,
        "counts": [len(track) for track in tracks],
        "xy": _text(np.concatenate([_differences(track) for track in tracks])) if tracks else "",
        "values": {"success": round(success, 4), **values, "failed": int(one.failed[0])},
    }


def packed_plan(grid: OccupancyGrid) -> dict[str, Any]:
    """Return a floor plan: cells row by row as runs, each its length times 4 plus the kind of cell."""
    side = grid.resolution * max(1, -(-max(grid.cells.shape) // CELLS))
    grid = grid.coarser(side)
    cells = grid.cells.ravel().astype(np.int64)
    starts = np.flatnonzero(np.diff(cells, prepend=-1))
    lengths = np.diff(starts, append=len(cells))
    return {
        "name": grid.name,
        "cell": grid.resolution,
        "origin": [round(float(value), 6) for value in grid.origin],
        "rows": grid.cells.shape[0],
        "columns": grid.cells.shape[1],
        "runs": _text(4 * lengths + cells[starts]),
    }


def _differences(track: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the second differences (2 N,) of positions (N, 2): summed up twice they are those again."""
    whole = np.round(track * _MM).astype(np.int64)
    return np.diff(whole, n=2, axis=0, prepend=np.zeros((2, 2), dtype=np.int64)).ravel()


def _text(numbers: NDArray[np.int64]) -> str:
    """Return whole numbers as base64 of varints."""
    signed = (numbers << 1) ^ (numbers >> 63)
    parts = signed[:, None] >> (7 * np.arange(_BYTES))
    written = (parts > 0) | (np.arange(_BYTES) == 0)
    more = np.concatenate((written[:, 1:], np.zeros((len(numbers), 1), dtype=bool)), axis=1)
    return base64.b64encode(((parts & 127) | (more << 7))[written].astype(np.uint8).tobytes()).decode()


def _changes(values: Tensor, first: int) -> list[list[float]]:
    """Return [point, x, y] at the first of the positions (N, 2) and wherever they change."""
    changed = torch.ones(len(values), dtype=torch.bool)
    changed[1:] = (values[1:] != values[:-1]).any(1)
    return [
        [first + point, round(float(values[point, 0]), 3), round(float(values[point, 1]), 3)]
        for point in changed.nonzero()[:, 0].tolist()
    ]


def _runs(flags: Tensor, first: int) -> list[list[int]]:
    """Return [first, last] of every run of flags (N,) bool."""
    edge = torch.diff(torch.nn.functional.pad(flags.int(), (1, 1)))
    begins, ends = (edge == 1).nonzero()[:, 0], (edge == -1).nonzero()[:, 0]
    return [[first + a, first + b - 1] for a, b in zip(begins.tolist(), ends.tolist(), strict=True)]
