"""The tables of `pedzoo reproduce crowdnav`: settings, robots, columns, and what has to be known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from pedzoo.eval.results import ResultTable
from pedzoo.sim.crowdnav import CROWDNAV, CROWDNAV_PP, TEST, Setting
from tools.paper.base import interval_text
from tools.paper.crowdnav_published import ORCA_LOG, ORCA_PP, PUBLISHED, SOCIAL_FORCE_LOG, Log, Published


class Table(NamedTuple):
    """A setting and the robots that are tested in it.

    Attributes:
        title: What people call it.
        setting: Its rules.
        first: Seed of its first case.
        robots: Names with settings.
        columns: Metrics that are shown.
    """

    title: str
    setting: Setting
    first: int
    robots: tuple[str, ...]
    columns: tuple[str, ...]


LEARNED = ("robot_ppo.circle", "robot_ppo.crowd")
"""Robots that have learned: among CrowdNav's people, and among those of CrowdNav++."""

_SPACE = "crowdnav_orca:safety_space=0.15"
_COLUMNS = ("success", "collision", "timeout", "time_s", "path_m")
TABLES = {
    "crowdnav": Table(
        "CrowdNav: 5 people who do not see the robot",
        CROWDNAV,
        TEST,
        (
            *("crowdnav_orca", _SPACE, "straight", "stop", "crowdnav_social_force", "sampling", "dwa"),
            *LEARNED,
        ),
        (*_COLUMNS, "discomfort", "return"),
    ),
    "crowdnav_visible": Table(
        "CrowdNav: 5 people who see the robot",
        replace(CROWDNAV, visible=True),
        TEST,
        ("crowdnav_orca", _SPACE, "sampling", *LEARNED),
        (*_COLUMNS, "discomfort", "return"),
    ),
    "crowdnav_pp": Table(
        "CrowdNav++: 20 people who do not see the robot",
        CROWDNAV_PP,
        SOCIAL_FORCE_LOG.first,
        (ORCA_PP, "crowdnav_social_force", "straight", "sampling", *LEARNED),
        (*_COLUMNS, "intrusion_ratio", "intrusion_distance_m"),
    ),
}


def table_page(name: str, rows: Sequence[Mapping[str, Any]]) -> ResultTable:
    """Return the table of a setting: our robots, and below them those that only others have.

    Args:
        name: Of the setting.
        rows: Of the report.
    """
    table, own = TABLES[name], [row for row in rows if row["case"]["setting"] == name]
    published = {row.ours: row for row in PUBLISHED[name] if row.ours}
    body = [
        [row["name"], str(row["n"]), *(_cell(row, key) for key in table.columns), _printed(row, published)]
        for row in own
    ]
    empty, names = ["-"] * (1 + len(table.columns)), {row["name"] for row in own}
    others = [row for row in PUBLISHED[name] if row.ours not in names]
    body += [[row.robot, *empty, _printed({"name": row.ours}, {row.ours: row})] for row in others]
    head = ["robot", "n", *table.columns, "published (success / collision / time_s)"]
    return ResultTable(table.title, head, body, 2)


def agreement_page(rows: Sequence[Mapping[str, Any]]) -> ResultTable:
    """Return how many cases of CrowdNav++'s logs end here as they do there."""
    body = [line for log in (SOCIAL_FORCE_LOG, ORCA_LOG) if (line := _agreement(log, rows))]
    head = ["log", "robot", "cases", "end alike", "success there", "success here"]
    return ResultTable("CrowdNav++: case by case", head, body, 2)


def _agreement(log: Log, rows: Sequence[Mapping[str, Any]]) -> list[str] | None:
    own = [row for row in rows if row["case"]["setting"] == "crowdnav_pp" and row["name"] == log.robot]
    if not own:
        return None
    here = own[0]["outcomes"][log.first - TABLES["crowdnav_pp"].first :: 2]
    pairs = list(zip(here, log.outcomes, strict=False))
    alike = sum(one == other for one, other in pairs)
    shares = [sum(pair[side] == "s" for pair in pairs) / len(pairs) for side in (1, 0)]
    return [log.name, log.robot, str(len(pairs)), str(alike), *(f"{value:.3f}" for value in shares)]


def _cell(row: Mapping[str, Any], key: str) -> str:
    if key not in row["metrics"]:
        return "-"
    digits = 2 if key.endswith(("_s", "_m")) else 3
    return f"{row['metrics'][key]:.{digits}f} {interval_text(row['ci95'].get(key), digits)}".strip()


def _printed(row: Mapping[str, Any], published: Mapping[str, Published]) -> str:
    if (result := published.get(row["name"])) is None:
        return "-"
    more = f", intrusion {result.intrusion_ratio}" if result.intrusion_ratio else ""
    return f"{result.success} / {result.collision} / {result.time_s}{more} ({result.source})"


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
