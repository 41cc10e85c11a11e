"""Table II with ORCA: people walk from goal to goal. Makes checkpoints/TABLE2_ORCA.md.

    python tools/table2_orca.py --map ../shared/maps/igibson_rs.yaml

n people reach k goals each on one floor plan, with three radii, walls seen and unseen, 20 seeds per cell.
Steps are iGibson's, of 0.1 s.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import torch

from pedzoo.eval.closed_loop import row
from pedzoo.eval.results import markdown_table
from pedzoo.eval.rollout import rollout
from pedzoo.paths import shipped, write_whole
from pedzoo.sim.make import CLEARANCE
from pedzoo.versions import versions

CELLS = ((2, 3), (2, 5), (3, 3), (3, 5), (5, 3))
RADII = (0.2, 0.3, 0.5)
MARGIN = 0.05
BLOCKS = {
    "seen": "walls seen, ways {:g} m from walls",
    "unseen": "walls unseen, ways {:g} m from walls",
    "wide": "walls seen, ways {:g} m from walls: only where the disk fits",
}


class Case(NamedTuple):
    """One cell of the table."""

    policy: str
    scenario: str
    world: str
    episodes: int
    clearance: float


def main() -> None:
    """Walk everything and write the page."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--map", default="flat", help="floor plan file, or flat")
    parser.add_argument("--episodes", type=int, default=20, help="seeds per cell")
    parser.add_argument("--world", default="grid", choices=["grid", "bullet"])
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--out", default=str(shipped("checkpoints") / "TABLE2_ORCA.md"))
    options = parser.parse_args()
    cases = {}
    for radius in RADII:
        for block in BLOCKS:
            for people, goals in CELLS:
                scenario = f"goals:map={options.map},people={people},goals={goals}"
                policy = f"orca:radius={radius},walls={'false' if block == 'unseen' else 'true'}"
                clearance = radius + MARGIN if block == "wide" else CLEARANCE
                case = Case(policy, scenario, options.world, options.episodes, clearance)
                cases[radius, block, people, goals] = case
    with ProcessPoolExecutor(options.workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        metrics = dict(zip(cases, pool.map(measured, cases.values()), strict=True))
    text = page(Path(options.map).stem, options, metrics)
    print(text)
    write_whole(Path(options.out), text.encode())


def measured(case: Case) -> dict[str, float]:
    """Return the metrics of one cell."""
    result, env = rollout(case.policy, case.scenario, case.world, case.episodes, clearance=case.clearance)
    env.world.close()
    return row(case.policy, result, 0.1)["metrics"] | {"clearance": case.clearance}


def page(name: str, options: argparse.Namespace, metrics: dict[tuple, dict[str, float]]) -> str:
    """Return the page."""
    lines = [
        "# Table II with ORCA\n",
        f"Made by `python tools/table2_orca.py --map .../{Path(options.map).name}` with torch"
        f" {versions()['torch']}: map {name}, {options.episodes} seeds per cell, speeds N(1.3, 0.2) m/s,"
        " decisions every 0.1 s, goals on ways of more than 2 m. Who is finished walks on until all are.\n",
    ]
    names = ["people / goals", "episodes in time", "time until all are done, s", "steps of 0.1 s"]
    names += ["goals per person", "least", "people touch: events per min", "walls: events per min"]
    for radius in RADII:
        for block, what in BLOCKS.items():
            clearance = metrics[radius, block, *CELLS[0]]["clearance"]
            lines.append(f"## radius {radius} m, {what.format(clearance)}\n")
            rows = []
            for people, goals in CELLS:
                found = metrics[radius, block, people, goals]
                time = found.get("time_s")
                rows.append(
                    [
                        f"{people} / {goals}",
                        f"{round(100 * found['episode_success'])} %",
                        "-" if time is None else f"{time:.1f}",
                        "-" if time is None else f"{10 * time:.0f}",
                        f"{found['goals_per_person']:.1f}",
                        f"{found['goals_per_person_min']:.1f}",
                        f"{found['agent_contacts_per_min']:.2f}",
                        f"{found['wall_contacts_per_min']:.2f}",
                    ]
                )
            lines.append(markdown_table(names, rows))
    lines.append(
        "Times are means over the episodes in which everybody reaches all goals in time. Step counts depend"
        " on walking speed, building and step: they compare within a table, not with the paper's.\n"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
