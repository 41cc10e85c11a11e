"""Times pedzoo's planner beside iGibson's way, in one process and on the same open cells.

    python tools/bench_planner.py [--maps ../shared/maps] [--pairs 40] [--json FILE]

iGibson's way is networkx's A* on the 8-connected graph of the open cells, edges weighted by length, one
search per query (its social navigation of 2022), with the L2 distance by numpy as its heuristic; the same
with math.dist is timed too. Both sides build their graphs beforehand. One thread, turns, medians.

The maps are a real apartment of 200 x 200 cells and a real office cut to 950 x 950; without them it is a
plain plan.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import networkx as nx
import numpy as np
import torch
from numpy.typing import NDArray
from side_by_side import Row, report, row, seconds

from pedzoo.geometry import identity_pose
from pedzoo.maps.bank import MapBank
from pedzoo.maps.graph import OpenGraph
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.maps.plain import rectangles, room, wall
from pedzoo.maps.planner import Planner

GOALS, QUERIES = 64, 1000


def main() -> None:
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shared = Path(os.environ.get("PEDZOO_SHARED") or Path(__file__).parents[2] / "shared")
    parser.add_argument("--maps", type=Path, default=shared / "maps", help="folder with the ROS maps")
    parser.add_argument("--pairs", type=int, default=40, help="random starts and goals of cold queries")
    parser.add_argument("--json", help="also write the table to this file")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for grid in floor_plans(options.maps):
        rows += compare(grid, max(20, options.pairs))
    report("global planner beside networkx A*, one thread", rows, {}, options.json)


def floor_plans(folder: Path) -> list[OccupancyGrid]:
    """Return the two maps, or a plain plan where they are absent."""
    if not folder.is_dir():
        print(f"{folder} is absent (--maps FOLDER): a plain plan instead of the apartment and the office")
        walls = room((0, 0), (19.8, 9.8), 0.1)
        for x in (5.0, 10.0, 15.0):
            walls += wall((x, 0), (x, 9.8), 0.2, doors=[(2.0 if x == 10 else 8.0, 0.9)])
        return [rectangles(walls, resolution=0.05, name="plain")]
    office = OccupancyGrid.load(folder / "fetch_hq.yaml")
    top, left = ((size - 950) // 2 for size in office.cells.shape)
    cut = office.cells[top : top + 950, left : left + 950]
    return [
        OccupancyGrid.load(folder / "igibson_rs.yaml"),
        OccupancyGrid(cut, office.resolution, office.origin, name="fetch_hq cut"),
    ]


def compare(grid: OccupancyGrid, pairs: int) -> list[Row]:
    """Time cold queries, the batch and all that is built beforehand on one floor plan."""
    planner = Planner(MapBank([grid], unknown="wall"))
    size = f"{grid.name}, {grid.cells.shape[1]} x {grid.cells.shape[0]}"
    graph, cells, times = built(planner)
    peer = nx.Graph()
    edges = graph.matrix.tocoo()
    triples = list(zip(edges.row.tolist(), edges.col.tolist(), edges.data.tolist(), strict=True))
    their_build = seconds(lambda: peer.add_weighted_edges_from(triples))
    places = [tuple(place) for place in graph.xy.tolist()]

    def by_numpy(one: int, other: int) -> float:
        return float(np.linalg.norm(np.array(places[one]) - np.array(places[other])))

    def by_dist(one: int, other: int) -> float:
        return math.dist(places[one], places[other])

    draws = np.random.default_rng(0)
    goals = draws.choice(cells, min(GOALS, len(cells)), replace=False)
    ids = planner.add_goals(0, graph.xy[goals])
    cache = seconds(planner.prepare)
    megabytes = 8 * len(goals) * (len(graph) + 1) / 1e6  # a waypoint and a length per cell and goal
    print(f"{size}: {len(graph)} open cells; " + ", ".join(f"{k} {v:.2f} s" for k, v in times.items()))
    print(f"  cache: fields of {len(goals)} goals {cache:.2f} s, {megabytes:.1f} MB")

    starts, ends = draws.choice(cells, pairs), draws.choice(goals, pairs)
    rows = [row(f"{size}: graph, once", None, [their_build], [sum(times.values())])]
    for name, heuristic in (("iGibson's heuristic", by_numpy), ("math.dist", by_dist)):
        bar = 5.0 if heuristic is by_numpy else None
        rows.append(cold(f"{size}: cold query ({name})", bar, planner, peer, heuristic, starts, ends))

    # A sample of the batch on the other side, scaled up.
    sample = [
        seconds(lambda a=a, b=b: nx.astar_path(peer, int(a), int(b), by_numpy))
        for a, b in zip(starts, ends, strict=True)
    ]
    people = draws.choice(cells, QUERIES)
    which = torch.from_numpy(draws.integers(0, len(goals), QUERIES))
    where = torch.from_numpy(graph.xy[people]).float()
    about = ids[which], torch.full((QUERIES,), grid.map_id), identity_pose(QUERIES)
    look = [seconds(lambda: planner.look(where, *about)) for _ in range(50)]
    theirs = statistics.mean(sample) * QUERIES
    what = f"{size}: {QUERIES} queries to {len(goals)} goals ({pairs} of theirs, scaled)"
    rows.append(row(what, 50.0, [theirs], look))
    rows.append(row(f"{size}: the same with building the cache", None, [theirs], [cache + look[0]]))
    lengths(planner, peer, by_dist, starts, ends, ids, goals)
    return rows


def built(planner: Planner) -> tuple[OpenGraph, NDArray[np.int64], dict[str, float]]:
    """Return the open cells, those of the largest component, and how long building all of it took."""
    start = time.perf_counter()
    graph = planner.graph(0)
    component, _, _ = graph.component, graph.nearest, graph.matrix
    middle = time.perf_counter()
    planner.corners(0).prepare()
    times = {"graph": middle - start, "corners": time.perf_counter() - middle}
    return graph, np.flatnonzero(component == np.bincount(component).argmax()), times


def cold(
    what: str,
    bar: float | None,
    planner: Planner,
    peer: nx.Graph,
    heuristic: Callable[[int, int], float],
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
) -> Row:
    """Time single queries whose goals nobody asked for before, in turns."""
    xy = planner.graph(0).xy
    planner.path(xy[starts[0]], xy[ends[0]], 0)
    taken = [
        (
            seconds(lambda a=a, b=b: nx.astar_path(peer, int(a), int(b), heuristic)),
            seconds(lambda a=a, b=b: planner.path(xy[a], xy[b], 0)),
        )
        for a, b in zip(starts, ends, strict=True)
    ]
    return row(what, bar, [theirs for theirs, _ in taken], [ours for _, ours in taken])


def lengths(
    planner: Planner,
    peer: nx.Graph,
    heuristic: Callable[[int, int], float],
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    ids: torch.Tensor,
    goals: NDArray[np.int64],
) -> None:
    """Print how long the ways are: path and field beside one another, and beside the 8-connected path."""
    xy = planner.graph(0).xy
    ids = ids[[int(np.flatnonzero(goals == end)[0]) for end in ends]]
    where, grid = torch.from_numpy(xy[starts]).float(), planner.bank.grids[0]
    about = ids, torch.full((len(ids),), grid.map_id), identity_pose(len(ids))
    field = planner.look(where, *about).distance.numpy()
    path = np.array(
        [
            np.linalg.norm(np.diff(np.vstack((xy[a], planner.path(xy[a], xy[b], 0))), axis=0), axis=1).sum()
            for a, b in zip(starts, ends, strict=True)
        ]
    )
    eight = np.array(
        [nx.astar_path_length(peer, int(a), int(b), heuristic) for a, b in zip(starts, ends, strict=True)]
    )
    apart = np.abs(field - path) / np.maximum(path, 1e-9)
    ratio = path / np.maximum(eight, 1e-9)
    print(
        f"  lengths of {len(path)} ways: path and field at most {100 * apart.max():.3f} % apart; of the "
        f"8-connected ones {100 * np.median(ratio):.1f} % in the median, {100 * ratio.max():.1f} % at most"
    )


if __name__ == "__main__":
    main()
