"""CrowdNav's 500 test cases and CrowdNav++'s crowd of 20, beside what others have printed of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.errors import UserError
from pedzoo.core.paths import sha256_of
from pedzoo.eval.results import ResultTable
from pedzoo.eval.work_units import fingerprint
from pedzoo.metrics.ratios import Ratio, mean, of_sums, ratio, share, summarised
from pedzoo.policies.load import load_planner
from pedzoo.policies.robots._base import LocalPlanner, ObservedPeople, Robot
from pedzoo.sim import crowdnav as rules
from pedzoo.sim.crowdnav import CROWDNAV, CROWDNAV_PP, SUCCESS, TIME_STEP, Setting, State, cases
from tools.paper.base import Jobs, interval_text
from tools.paper.published import CROWDNAV_ROWS, ORCA_LOG, ORCA_PP, SOCIAL_FORCE_LOG

CASES = 500
"""Cases of each table."""

DISCOUNT = 0.9
"""Of rewards per second at 1 m/s: CrowdNav's."""

LETTERS = {SUCCESS: "s", rules.COLLISION: "c", rules.TIMEOUT: "t", rules.FAILED: "f"}
"""How a case ended, as rows of the report have it."""


class Table(NamedTuple):
    """A setting, the seed of its first case, the robots that are tested in it, and metrics shown."""

    title: str
    setting: Setting
    first: int
    robots: tuple[str, ...]
    columns: tuple[str, ...]


LEARNED = ("robot_ppo.circle", "robot_ppo.crowd")
"""Robots that have learned: among CrowdNav's people, and among those of CrowdNav++."""

_SEEN, _FIRST = replace(CROWDNAV, visible=True), SOCIAL_FORCE_LOG.first
_SPACE = "crowdnav_orca:safety_space=0.15"
_RULES = ("crowdnav_orca", _SPACE, "straight", "stop", "crowdnav_social_force", "sampling", "dwa")
_VISIBLE = ("crowdnav_orca", _SPACE, "sampling", *LEARNED)
_PP = (ORCA_PP, "crowdnav_social_force", "straight", "sampling", *LEARNED)
_COLUMNS = ("success", "collision", "timeout", "time_s", "path_m")
_NEAR, _INTRUDES = (*_COLUMNS, "discomfort", "return"), (*_COLUMNS, "intrusion_ratio", "intrusion_distance_m")
_UNSEEN, _FEW, _MANY = "people who do not see the robot", "CrowdNav: 5", "CrowdNav++: 20"
TABLES = {
    "crowdnav": Table(f"{_FEW} {_UNSEEN}", CROWDNAV, rules.TEST, (*_RULES, *LEARNED), _NEAR),
    "crowdnav_visible": Table(f"{_FEW} people who see the robot", _SEEN, rules.TEST, _VISIBLE, _NEAR),
    "crowdnav_pp": Table(f"{_MANY} {_UNSEEN}", CROWDNAV_PP, _FIRST, _PP, _INTRUDES),
}


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
        """Take ``robots`` instead of the usual ones, and the first cases of each setting.

        Raises:
            UserError: An unknown robot, or no cases.
        """
        if not 1 <= count <= CASES:
            raise UserError(f"--episodes {count}: expected 1 to {CASES} cases")
        for name in robots:  # a wrong one is refused before any work
            load_planner(name, TIME_STEP)
        self.count, jobs = count, {}
        for name, table in TABLES.items():
            for job in (Job(name, robot, count) for robot in tuple(robots) or table.robots):
                file = Path(job.robot.partition(".py:")[0] + ".py")
                code = sha256_of(file) if ".py:" in job.robot and file.is_file() else ""
                jobs[fingerprint(job, code)] = job
        super().__init__(jobs, work, journal)

    def report(self) -> dict[str, Any]:
        """Return all rows, and what others have printed."""
        seeds = {
            name: f"seeds {table.first} to {table.first + self.count - 1}" for name, table in TABLES.items()
        }
        return {
            "protocol": {"cases": self.count, "time_step_s": TIME_STEP} | seeds,
            "seeds": sorted({table.first for table in TABLES.values()}),
            "notes": list(NOTES),
            "rows": self.rows,
            "published": CROWDNAV_ROWS,
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
    row = {"name": job.robot, "case": {"setting": job.table}, "n": job.count, "metrics": metrics}
    return [row | {"ci95": ci95, "outcomes": ends, "seconds": round(seconds, 2)}]


class CaseResults(NamedTuple):
    """How B cases went, (B,) each; the last step of a case neither disturbs nor intrudes."""

    outcome: Tensor  # how they ended, long, one of `pedzoo.sim.crowdnav`
    seconds: Tensor
    steps: Tensor
    path: Tensor  # metres that the robot went
    reward: Tensor  # discounted sum
    disturbed: Tensor  # steps in which a body was nearer than the discomfort distance
    gap: Tensor  # sum of the distances in these, metres
    intruded: Tensor  # steps in which the robot stood where a person would be
    intrusion: Tensor  # sum of the distances between centres in these, metres


@torch.no_grad()
def run(policy: LocalPlanner, setting: Setting, cases: State) -> CaseResults:
    """Return how cases go with a policy, a new one for each call, which is asked in single precision.

    Raises:
        ValueError: The policy's answer is not of the shape (B, 2).
    """
    state = cases.copy()
    scenes = len(cases.goal)
    outcome, seconds = torch.full((scenes,), rules.GOES_ON), torch.zeros(scenes).double()
    sums = {name: torch.zeros_like(seconds) for name in CaseResults._fields[2:]}
    while bool((going := state.going).any()):
        place, moving, radius, mask = state.known
        known = ObservedPeople(place.float(), moving.float(), radius.float(), mask)
        velocity = policy(Robot(*(part.float() for part in state.robot)), known)
        if velocity.shape != (scenes, 2):
            raise ValueError(f"the robot's policy gave velocities {tuple(velocity.shape)}, not {(scenes, 2)}")
        before, (state, events) = state, rules.step(setting, state, velocity)
        on = state.going
        disturbed = on & (events.clearance < setting.discomfort_dist)
        intruded = on & events.intruded.isfinite()
        added = {
            "steps": torch.ones_like(seconds),
            "path": (state.robot.position - before.robot.position).norm(dim=-1),
            "reward": DISCOUNT**before.seconds * events.reward,
            "disturbed": disturbed,
            "gap": events.clearance.where(disturbed, 0),
            "intruded": intruded,
            "intrusion": events.intruded.where(intruded, 0),
        }
        sums = {name: total + torch.where(going, added[name], 0) for name, total in sums.items()}
        seconds = torch.where(going, events.seconds, seconds)
        outcome = torch.where(going, events.outcome, outcome)
    return CaseResults(outcome, seconds, **sums)


def ratios(runs: CaseResults) -> dict[str, Ratio]:
    """Return the metrics of `LEGEND` over cases."""
    won = runs.outcome == SUCCESS
    result = {
        "success": share(won),
        "collision": share(runs.outcome == rules.COLLISION),
        "timeout": share(runs.outcome == rules.TIMEOUT),
        "failed": share(runs.outcome == rules.FAILED),
        "time_s": mean(runs.seconds, won),
        "path_m": mean(runs.path, won),
        "return": ratio(runs.reward),
        "discomfort": ratio(runs.disturbed, runs.steps),
        "discomfort_distance_m": ratio(runs.gap, runs.disturbed),
        "intrusion_ratio": ratio(runs.intruded / runs.steps),
        "intrusion_distance_m": of_sums(runs.intrusion, runs.intruded, runs.intruded > 0),
    }
    return result if bool(runs.intruded.any()) else {key: result[key] for key in list(result)[:-2]}


def table_page(name: str, rows: Sequence[Mapping[str, Any]]) -> ResultTable:
    """Return the table of the setting ``name``: our robots, and below them those that only others have."""
    table, own = TABLES[name], {row["name"]: row for row in rows if row["case"]["setting"] == name}
    published = {row["ours"]: row for row in CROWDNAV_ROWS[name] if row["ours"]}
    body = [
        [robot, str(row["n"]), *(_cell(row, key) for key in table.columns), _printed(published.get(robot))]
        for robot, row in own.items()
    ]
    others = (row for row in CROWDNAV_ROWS[name] if row["ours"] not in own)
    body += [[row["robot"], *["-"] * (1 + len(table.columns)), _printed(row)] for row in others]
    head = ["robot", "n", *table.columns, "published (success / collision / time_s)"]
    return ResultTable(table.title, head, body, 2)


def agreement_page(rows: Sequence[Mapping[str, Any]]) -> ResultTable:
    """Return how many cases of CrowdNav++'s logs end here as they do there."""
    own = {row["name"]: row for row in rows if row["case"]["setting"] == "crowdnav_pp"}
    body = []
    for log in (log for log in (SOCIAL_FORCE_LOG, ORCA_LOG) if log.robot in own):
        here = own[log.robot]["outcomes"][log.first - TABLES["crowdnav_pp"].first :: 2]
        pairs = list(zip(here, log.outcomes, strict=False))
        alike = sum(one == other for one, other in pairs)
        shares = [sum(pair[side] == "s" for pair in pairs) / len(pairs) for side in (1, 0)]
        cells = [log.name, log.robot, str(len(pairs)), str(alike)]
        body.append([*cells, *(f"{value:.3f}" for value in shares)])
    head = ["log", "robot", "cases", "end alike", "success there", "success here"]
    return ResultTable("CrowdNav++: case by case", head, body, 2)


def _cell(row: Mapping[str, Any], key: str) -> str:
    if key not in row["metrics"]:
        return "-"
    digits = 2 if key.endswith(("_s", "_m")) else 3
    return f"{row['metrics'][key]:.{digits}f} {interval_text(row['ci95'].get(key), digits)}".strip()


def _printed(row: Mapping[str, str] | None) -> str:
    if row is None:
        return "-"
    more = f", intrusion {row['intrusion_ratio']}" if row["intrusion_ratio"] else ""
    return f"{row['success']} / {row['collision']} / {row['time_s']}{more} ({row['source']})"


LEGEND = {
    "success": "share of cases in which the robot comes within its radius of the goal",
    "collision": "share of cases that end because the robot touches a person",
    "timeout": "share of cases that go on until 1 s before the limit (25 s, CrowdNav++ 50 s)",
    "time_s": "until the goal, mean of successful cases; CrowdNav counts the last step, CrowdNav++ does not",
    "path_m": "metres that the robot went, mean of the successful cases",
    "discomfort": "share of all steps in which the robot is nearer than 0.2 m to a person, body to body",
    "return": "CrowdNav's discounted reward, 0.9 per second",
    "intrusion_ratio": "share of a case's steps in which the robot stands where people will be within 1.25 s",
    "intrusion_distance_m": "distance between centres in these steps, to the nearest such person",
}

NOTES = (
    "`robot_ppo.circle` and `robot_ppo.crowd` have learned, in other crowds of CrowdNav and CrowdNav++; the"
    " others have not. `sampling` has settings that were chosen on other cases, seeds 0 to 499 of CrowdNav's"
    " validation. In brackets 95 % intervals over n cases: Wilson's for shares, Student's t otherwise",
    "`dwa` is a differential drive (1 m/s, 1 m/s^2, 1.5 rad/s); the others go in any direction at once",
    "CrowdNav: cases, rules and clock are its own. Of 500 cases with `crowdnav_orca` 499 end as with RVO2 at"
    " the same time; one collides a step earlier. The test is tests/sim/test_crowdnav.py",
    "CrowdNav, visible: ORCA is printed with .99 and 12.29 s. A safety space of 0.15 m gives exactly that."
    " The `test.py` of today sets 0 m, which gives 1.00 and 10.02 s",
    "CrowdNav++: the seeds are its own, 1000 + 425 + number of the case. Nothing in a case is left to chance:"
    " people who arrive are replaced by draws from the case's own stream. Those keep clear of the robot, so"
    " the crowd depends on it",
    "CrowdNav++: its 500 runs are 250 cases twice. Each run is reset twice, and the number of the case goes"
    " on at each, modulo 500. All its logs list each failure twice, 250 apart. Intervals are those of 250",
    "CrowdNav++: the log of ORCA (folder `ORCA_no_rand`) is not of the crowd that its config names. It begins"
    ' with "Randomize human\'s radius and preferred speed". With random radii, speeds and goals RVO2 ends as'
    " the log in 250 of 250 cases, after 14.77 s: `python -m tools.bench.crowdnav_rvo2`",
    "CrowdNav++: the simulation here leaves random people out. Theirs keep the radii of people who are gone,"
    " one memory for each pair, and their robot that of the first case for ever. That cannot be batched",
    "CrowdNav++: GST's log has other seeds, 1125, 1127, .... Path lengths of its logs have the jump from the"
    " end of a run to the next start, and are left out",
)
