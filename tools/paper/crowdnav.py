"""CrowdNav's 500 test cases and CrowdNav++'s crowd of 20, beside what others have printed of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.fetch import sha256_of
from pedzoo.eval.results import ResultTable
from pedzoo.eval.work_units import fingerprint
from pedzoo.metrics.ratios import Ratio, mean, of_sums, ratio, share, summarised
from pedzoo.policies.robots._weights import load_planner
from pedzoo.sim.crowdnav import COLLISION, FAILED, SUCCESS, TIME_STEP, TIMEOUT, cases
from tools.paper.base import Jobs
from tools.paper.crowdnav_published import PUBLISHED
from tools.paper.crowdnav_runs import CaseResults, run
from tools.paper.crowdnav_tables import LEGEND, NOTES, TABLES, agreement_page, table_page

CASES = 500
"""Cases of each table."""

LETTERS = {SUCCESS: "s", COLLISION: "c", TIMEOUT: "t", FAILED: "f"}
"""How a case ended, as rows of the report have it."""


class Job(NamedTuple):
    """A robot in a setting."""

    table: str
    robot: str
    count: int

    @property
    def label(self) -> str:
        """What is said while it is done."""
        return f"{self.table} {self.robot}"


class Crowdnav(Jobs):
    """Each robot in each setting, all cases at once."""

    title = "Robots among people: CrowdNav and CrowdNav++"
    stem = "CROWDNAV"

    def __init__(self, robots: Sequence[str] = (), count: int = CASES, journal: Path | None = None) -> None:
        """Say what is to be done.

        Args:
            robots: Instead of the usual ones, in all settings: names, or ``path/to/file.py:Class``.
            count: Of the cases of each setting, the first ones.
            journal: A file that keeps finished rows.

        Raises:
            UserError: An unknown robot, or no cases.
        """
        if not 1 <= count <= CASES:
            raise UserError(f"--episodes {count}: expected 1 to {CASES} cases")
        for name in robots:  # a wrong one is refused before any work
            load_planner(name, TIME_STEP)
        names = {table: tuple(robots) or TABLES[table].robots for table in TABLES}
        self.count = count
        jobs = [Job(table, robot, count) for table in TABLES for robot in names[table]]
        super().__init__(jobs, [fingerprint(job, _file_sum(job.robot)) for job in jobs], work, journal)

    def report(self) -> dict[str, Any]:
        """Return all rows, and what others have printed."""
        return {
            "protocol": {"cases": self.count, "time_step_s": TIME_STEP}
            | {
                name: f"seeds {table.first} to {table.first + self.count - 1}"
                for name, table in TABLES.items()
            },
            "seeds": sorted({table.first for table in TABLES.values()}),
            "notes": list(NOTES),
            "rows": self.rows,
            "published": {name: [row._asdict() for row in rows] for name, rows in PUBLISHED.items()},
        }

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return a table for each setting, and how many cases end as in published logs."""
        pages = [*(table_page(name, report["rows"]) for name in TABLES), agreement_page(report["rows"])]
        return [page for page in pages if page.rows]

    def legend(self) -> dict[str, str]:
        """Return what the metrics are."""
        return LEGEND


def work(job: Job) -> list[dict[str, Any]]:
    """Run all cases with a robot and return its one row."""
    table = TABLES[job.table]
    drawn = cases(table.setting, range(table.first, table.first + job.count))
    started = time.perf_counter()
    runs = run(load_planner(job.robot, TIME_STEP), table.setting, drawn)
    seconds = time.perf_counter() - started
    metrics, ci95 = summarised(ratios(runs))
    ends = "".join(LETTERS[end] for end in runs.outcome.tolist())
    row = {
        "name": job.robot,
        "case": {"setting": job.table},
        "n": job.count,
        "metrics": metrics,
        "ci95": ci95,
    }
    return [row | {"outcomes": ends, "seconds": round(seconds, 2)}]


def ratios(runs: CaseResults) -> dict[str, Ratio]:
    """Return the metrics of `LEGEND` over cases."""
    won = runs.outcome == SUCCESS
    result = {
        "success": share(won),
        "collision": share(runs.outcome == COLLISION),
        "timeout": share(runs.outcome == TIMEOUT),
        "failed": share(runs.outcome == FAILED),
        "time_s": mean(runs.seconds, won),
        "path_m": mean(runs.path, won),
        "return": ratio(runs.reward),
        "discomfort": ratio(runs.disturbed, runs.steps),
        "discomfort_distance_m": ratio(runs.gap, runs.disturbed),
        "intrusion_ratio": ratio(runs.intruded / runs.steps),
        "intrusion_distance_m": of_sums(runs.intrusion, runs.intruded, runs.intruded > 0),
    }
    return result if bool(runs.intruded.any()) else {key: result[key] for key in list(result)[:-2]}


def _file_sum(robot: str) -> str:
    path = Path(robot.partition(".py:")[0] + ".py")
    return sha256_of(path) if ".py:" in robot and path.is_file() else ""
