"""The global planner beside networkx' A*, as iGibson plans: first queries, many queries, building."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from statistics import mean, median
from typing import Any

import networkx as nx
import numpy as np
import torch
from numpy.typing import NDArray

from pedzoo.core.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.planning import planner
from pedzoo.maps.plans import load_plan, rectangles, room, wall
from tools.bench.figures import Measured, Row
from tools.bench.section import Section
from tools.bench.turns import seconds_of, versus

GOALS, QUERIES = 64, 1000
PAIRS = 40
"""First queries of one turn, the same in all turns and for both sides: neither remembers them."""

WIDEST = 950
"""Larger floor plans are cut to so many cells along each side: A* takes seconds there."""

Cells = NDArray[np.int64]


class Planner(Section):
    """Both sides have the same open cells and build their graphs beforehand.

    iGibson's way (its social navigation of 2022) is networkx' A* on the 8-connected graph of open cells,
    edges weighted by length, one search per query, with the L2 distance by numpy as its heuristic; the same
    with ``math.dist`` is timed too.
    """

    takes = 6, 54

    def rows(self) -> Iterator[Row]:
        """Measure on every floor plan, or on a plain one."""
        self.versions["networkx"] = version("networkx")
        grids = [cut(load_plan(file)) for file in self.settings.maps]
        for grid in grids or [plain(0.1 if self.settings.quick else 0.05)]:
            yield from self._on(grid)

    def _on(self, grid: OccupancyGrid) -> Iterator[Row]:
        now, turns = self.settings.clock, self.settings.turns
        where = {"map": grid.name, "cells": f"{grid.cells.shape[1]} x {grid.cells.shape[0]}"}
        ours = planner.Planner(MapBank([grid], unknown="wall"))

        def build() -> None:
            graph = ours.graph(0)
            _ = graph.component, graph.nearest, graph.matrix
            ours.corners(0).prepare()

        built = seconds_of(build, now)
        graph, peer = ours.graph(0), nx.Graph()
        edges = graph.matrix.tocoo()
        triples = list(zip(edges.row.tolist(), edges.col.tolist(), edges.data.tolist(), strict=True))
        theirs = seconds_of(lambda: peer.add_weighted_edges_from(triples), now)
        yield Row("planner", "graph, once", where, versus([built], [theirs], "networkx"))

        cells = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
        draws = np.random.default_rng(0)
        goals = draws.choice(cells, min(8 if self.settings.quick else GOALS, len(cells)), replace=False)
        ids = ours.add_goals(0, graph.xy[goals])
        cache = seconds_of(ours.prepare, now)
        size = 8e-6 * len(goals) * (len(graph) + 1)  # a waypoint and a length per cell and goal
        result = {"pedzoo_ms": Measured.of([1e3 * cache]), "pedzoo_mb": Measured.of([size])}
        yield Row("planner", f"fields of {len(goals)} goals, once", where, result)

        pairs = 4 if self.settings.quick else PAIRS
        starts, ends = draws.choice(cells, pairs), draws.choice(goals, pairs)
        sample = []
        for name, heuristic in heuristics(graph.xy).items():
            taken = [self._cold(ours, peer, heuristic, starts, ends) for _ in range(turns)]
            own, other, means = (list(side) for side in zip(*taken, strict=True))
            sample = sample or means
            row = Row("planner", f"first query, {name}", where, versus(own, other, "networkx"))
            bars = [row.at_least("times_networkx", 5)] if name == IGIBSON else []
            yield replace(row, bars=bars)

        people = draws.choice(cells, QUERIES)
        which = torch.from_numpy(draws.integers(0, len(goals), QUERIES))
        points = torch.from_numpy(graph.xy[people]).float()
        about = ids[which], torch.full((QUERIES,), grid.map_id), identity_pose(QUERIES)
        ours.next_waypoints(points, *about)
        look = [seconds_of(lambda: ours.next_waypoints(points, *about), now) for _ in range(50)]
        scaled = [second * QUERIES for second in sample]  # theirs of iGibson's heuristic, for as many queries
        row = Row("planner", f"{QUERIES} queries", where, versus(look, scaled, "networkx"))
        note = "networkx scaled up from the first queries"
        yield replace(row, bars=[row.at_least("times_networkx", 50)], note=note)
        whole = versus([cache + second for second in look], scaled, "networkx")
        yield Row("planner", f"{QUERIES} queries, fields built", where, whole, note=note)
        far = self._lengths(ours, peer, starts, ends, ids, goals)
        note = "path and field beside one another, and path beside the 8-connected one"
        yield Row("planner", "lengths of ways", where, far, note=note)

    def _cold(
        self, ours: Any, peer: nx.Graph, heuristic: Any, starts: Cells, ends: Cells
    ) -> tuple[float, float, float]:
        """Return seconds of queries that are new, in turns: both medians, and their mean."""
        xy, now = ours.graph(0).xy, self.settings.clock
        ours.path(xy[starts[0]], xy[ends[0]], 0)
        own, other = [], []
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            other.append(seconds_of(lambda a=start, b=end: nx.astar_path(peer, a, b, heuristic), now))
            own.append(seconds_of(lambda a=start, b=end: ours.path(xy[a], xy[b], 0), now))
        return median(own), median(other), mean(other)

    def _lengths(
        self, ours: Any, peer: nx.Graph, starts: Cells, ends: Cells, ids: torch.Tensor, goals: Cells
    ) -> dict[str, Measured]:
        """Return how long our ways are: path against field, and path against 8-connected path."""
        xy = ours.graph(0).xy
        ids = ids[[int(np.flatnonzero(goals == end)[0]) for end in ends]]
        about = ids, torch.full((len(ids),), ours.bank.grids[0].map_id), identity_pose(len(ids))
        field = ours.next_waypoints(torch.from_numpy(xy[starts]).float(), *about).distance.numpy()
        pairs = list(zip(starts.tolist(), ends.tolist(), strict=True))
        paths = [np.vstack((xy[a], ours.path(xy[a], xy[b], 0))) for a, b in pairs]
        path = np.array([np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in paths])
        fastest = heuristics(xy)["math.dist"]
        eight = np.array([nx.astar_path_length(peer, a, b, fastest) for a, b in pairs])
        apart = 100 * np.abs(field - path) / np.maximum(path, 1e-9)
        return {
            "apart_at_most_percent": Measured.of([float(apart.max())]),
            "of_8_connected_percent": Measured.of((100 * path / np.maximum(eight, 1e-9)).tolist()),
        }


IGIBSON = "iGibson's heuristic"


def heuristics(xy: NDArray[np.float64]) -> dict[str, Callable[[int, int], float]]:
    """Return ways to compute the distance between two cells."""
    places = [tuple(place) for place in xy.tolist()]

    def by_numpy(one: int, other: int) -> float:
        return float(np.linalg.norm(np.array(places[one]) - np.array(places[other])))

    def by_dist(one: int, other: int) -> float:
        return math.dist(places[one], places[other])

    return {IGIBSON: by_numpy, "math.dist": by_dist}


def plain(resolution: float) -> OccupancyGrid:
    """Return four rooms in a row, ``resolution`` metres per cell."""
    walls = room((0, 0), (19.8, 9.8), 0.1)
    for x in (5.0, 10.0, 15.0):
        walls += wall((x, 0), (x, 9.8), 0.2, doors=[(2.0 if x == 10 else 8.0, 1.0)])
    return rectangles(walls, resolution, name="plain")


def cut(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the middle of a floor plan that is too large."""
    if max(grid.cells.shape) <= WIDEST:
        return grid
    middle = tuple(
        slice(max(0, (size - WIDEST) // 2), max(0, (size - WIDEST) // 2) + WIDEST)
        for size in grid.cells.shape
    )
    return OccupancyGrid(grid.cells[middle], grid.resolution, grid.origin, name=f"{grid.name} cut")
