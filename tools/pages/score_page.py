"""Writes checkpoints/results/SCORES.md and .json from reports of ``pedzoo score``.

pedzoo score social_walker.eth social_force:preset=indoor --against eth --json score_eth.json
python -m tools.pages.score_page score_*.json

Reports of one recording and protocol are joined: a row of a later one takes the place of an earlier one's. So
``python -m tools.pages.score_page checkpoints/results/SCORES.json score_eth.json`` adds a crowd to the page.
Rows of checkpoints, called by their paths, get a name by ``--named social_walker.styled_SCENE-seed1``.
"""

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import Any

from tools.pages.tables import RESULTS, number, table

Reports = dict[str, dict[str, Any]]
"""By what they are against."""

COLUMNS = {
    "realism": "realism",
    "coarse_realism": "realism, coarse",
    "classifier_auc": "AUC",
    "coarse_classifier_auc": "AUC, coarse",
    "likelihood": "likelihood",
    "min_ade_20_8s_m": "minADE_20, m",
    "coarse_acceleration_p95_ratio": "acceleration p95, coarse",
    "coarse_acceleration_p99_ratio": "acceleration p99, coarse",
    "standing_share": "standing",
    "companions_near_share": "companions near",
    "agent_contacts_per_min": "touches/min",
}
"""Metrics of `docs/score.md`, and what they are called here."""

INTRO = """All people are simulated at once, from the real entry to the real exit. Weights called `NAME.SCENE`
did not see that scene. [docs/score.md](../../docs/score.md) has the formulas. In brackets: 95 % intervals
over blocks of time. `real halves`: two halves of the real people, as near as people are to each other.
`real others`: other people in similar situations. Less is better for realism, AUC (.5: a classifier cannot
distinguish them) and minADE. AUCs are by the trees of version 2; [CLASSIFIERS](CLASSIFIERS.md) has those by
scikit-learn's, of version 3. More is better for likelihood. Ratios are best at 1, standing and touches as
those of `real`. Companions near: of the steps that recorded companions share, those within 1.5 m. *Coarse*
positions are means over three steps. Rows called `-seed1` and `-seed2` are trainings whose weights are not
in the zoo."""

WITH_STOPS = """`pedzoo score --stops`: people also have the places where the recorded ones stood for 2 s or
more as goals, in turn, and wait there as long. That tells policies more of the future than exits alone do.
Compare these rows with each other only."""


def main() -> None:
    """Read the reports and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+", help="Reports of pedzoo score --json.")
    parser.add_argument("--named", help="What checkpoints are called; SCENE stands for the recording.")
    parser.add_argument("--out", type=Path, default=RESULTS / "SCORES.md")
    given = parser.parse_args()
    reports: Reports = {}
    for file in given.files:
        content = json.loads(file.read_text())
        # a page's own file has one report of each recording
        for report in [content] if "rows" in content else content.values():
            # reports of before there were stops do not name them
            protocol = report["protocol"] = {"stops": False} | report["protocol"]
            for row in report["rows"] if given.named else ():
                if row["name"].endswith(".ckpt"):
                    row["name"] = given.named.replace("SCENE", protocol["against"])
            name = protocol["against"] + ", with stops" * protocol["stops"]
            reports[name] = joined(reports.get(name), report)
    given.out.write_text("\n".join(page(reports)) + "\n")
    given.out.with_suffix(".json").write_text(json.dumps(reports, indent=1) + "\n")


def joined(before: dict[str, Any] | None, report: dict[str, Any]) -> dict[str, Any]:
    """Return a report with the rows of an earlier one that it does not have; every row names its commit."""
    before = before or report | {"rows": []}
    if before["protocol"] != report["protocol"]:
        raise SystemExit(f"{before['protocol']} and {report['protocol']}: expected reports of one protocol")
    commit = {"commit": report["versions"]["commit"]}
    rows = [*before["rows"], *(commit | row for row in report["rows"])]
    return report | {"rows": list({row["name"]: row for row in rows}.values())}


def page(reports: Reports) -> Iterator[str]:
    """Yield the lines of the page."""
    yield from ("# How near simulated crowds are to real ones", "", INTRO, "")
    for stops in (False, True):
        mine = {name: report for name, report in reports.items() if report["protocol"]["stops"] == stops}
        if mine and stops:
            yield from ("## With stops", "", WITH_STOPS, "")
        if mine:
            yield from means(mine, stops)
            yield from each(mine)


def means(reports: Reports, stops: bool) -> Iterator[str]:
    """Yield the table of the means of crowds that are scored against all recordings.

    A second one says how much the means of crowds differ between seeds, if there are several of any.
    """
    kinds: dict[str, list[dict[str, Any]]] = {}
    for report in reports.values():
        for row in report["rows"]:
            kinds.setdefault(kind(row["name"], report["protocol"]["against"]), []).append(row["metrics"])
    values: dict[str, dict[str, float | None]] = {}
    seeds: dict[str, list[str]] = {}
    for name, rows in kinds.items():
        if len(rows) == len(reports):
            known = {key: [row[key] for row in rows if key in row] for key in COLUMNS}
            values[name] = {key: fmean(v) if len(v) == len(rows) else None for key, v in known.items()}
            seeds.setdefault(re.sub(r"-seed\d+$", "", name), []).append(name)
    names = ", ".join(report["protocol"]["against"] for report in reports.values())
    yield from (f"## Mean of {names}" + ", with stops" * stops, "")
    head = ["crowd", *COLUMNS.values()]
    yield table(head, [[name, *(number(one, 3) for one in mine.values())] for name, mine in values.items()])
    lines = [
        [f"{name}, {len(runs)} seeds", *(spread([values[run][key] for run in runs]) for key in COLUMNS)]
        for name, runs in seeds.items()
        if len(runs) > 1
    ]
    if lines:
        yield from ("Over seeds: the mean of their means, and the least and the greatest one.", "")
        yield table(head, lines)


def each(reports: Reports) -> Iterator[str]:
    """Yield one table of every recording."""
    for against, report in reports.items():
        yield from (f"## {against}", "")
        by_commit: dict[str, list[str]] = {}
        for row in report["rows"]:
            by_commit.setdefault(row["commit"], []).append(f"`{row['name']}`")
        commits = "; ".join(f"{', '.join(names)} by commit {commit}" for commit, names in by_commit.items())
        yield f"`pedzoo score` with pedzoo {report['versions']['pedzoo']}: {commits}."
        yield ""
        rows = [[row["name"], *(cell(row, key) for key in COLUMNS)] for row in report["rows"]]
        yield table(["crowd", *COLUMNS.values()], rows)


def kind(name: str, against: str) -> str:
    """Return what a row of one recording is called for all of them."""
    return re.sub(rf"(?<=.){re.escape(against)}(?=(-seed\d+)?$)", "SCENE", name)


def spread(values: list[float | None]) -> str:
    """Return the mean of values, and the least and the greatest one."""
    known = [value for value in values if value is not None]
    ends = f"{fmean(known):.3f} ({min(known):.3f} to {max(known):.3f})" if known else "-"
    return ends if len(known) == len(values) else "-"


def cell(row: dict[str, Any], key: str) -> str:
    """Return a value with its interval."""
    interval = row["ci95"].get(key) if key in row["metrics"] else None
    ends = f" [{interval[0]:.2f}, {interval[1]:.2f}]" if interval else ""
    return number(row["metrics"].get(key), 3) + ends


if __name__ == "__main__":
    main()
