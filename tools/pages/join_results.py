"""Writes a page of `pedzoo evaluate` from an earlier report and later ones of some of its policies.

pedzoo evaluate social_walker.styled --suite door,goals,encounters,replay --json later.json
python -m tools.pages.join_results earlier.json later.json --page checkpoints/results/RESULTS.md

All have to be of the same suites and options. Rows of later ones take the place of earlier ones. The page
says which policies are of which commit.
"""

import argparse
import json
import re
import shlex
from functools import reduce
from pathlib import Path
from typing import Any

from pedzoo.cli.output import write_text
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.results import markdown, summary
from pedzoo.eval.suite import EvaluationOptions

COMMAND = re.compile(r"Made by `(.*?)`")


def joined(before: dict[str, Any], later: dict[str, Any]) -> dict[str, Any]:
    """Return a report with the rows of both; those of ``later`` take the place of others of its policies."""
    if before["protocol"] != later["protocol"] or before["seeds"] != later["seeds"]:
        raise SystemExit(f"not of one protocol:\n{before['protocol']}\n{later['protocol']}")
    names = {row["name"] for row in later["rows"]}
    rows = [row for row in before["rows"] if row["name"] not in names]
    place = {name: number for number, name in enumerate(row["name"] for row in before["summary"])}
    mine = [row for row in later["rows"] if row["name"] in place]
    rows = sorted([*rows, *mine], key=lambda row: place.get(row["name"], -1))
    again = ", ".join(sorted(names & set(place)))
    note = f"by commit {later['versions']['commit']}: {again}"
    return before | {"rows": rows, "summary": summary(rows), "notes": [*before["notes"], note]}


def main() -> None:
    """Read the reports and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("before", type=Path, help="Report of all policies, by pedzoo evaluate --json.")
    parser.add_argument("later", type=Path, nargs="+", help="Reports of some of them.")
    parser.add_argument("--page", type=Path, required=True, help="Its command is that of the page so far.")
    given = parser.parse_args()
    report = reduce(joined, (json.loads(path.read_text()) for path in (given.before, *given.later)))
    command = COMMAND.search(given.page.read_text())
    if command is None:
        raise SystemExit(f"{given.page}: names no command")
    suites = report["protocol"]["suites"]
    shown = Evaluation(["go_to_goal"], suites, EvaluationOptions(), [0], False, None).shown
    write_text(given.page, markdown(report, shown, shlex.split(command[1])))


if __name__ == "__main__":
    main()
