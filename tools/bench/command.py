"""The command ``pedzoo bench``."""

import platform
import re
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import COMMANDS
from tools.bench.programs import CASES, ROOT, Case, Program, checkout, git

SECTIONS: dict[str, tuple[str, list[tuple[int, int]]]] = {
    "start": ("what a person waits for: imports, help, a typo, one epoch, one evaluation", [(0, 0)]),
    "environment": ("people who go straight, with every physics", [(1, 5), (64, 5), (1024, 5)]),
    "policies": ("people who walk by policies", [(64, 5)]),
    "robots": ("a robot with a lidar among people", [(1, 5), (64, 5)]),
    "controller": ("a call of a controller", [(1, 2), (1, 20), (1, 200)]),
    "planner": ("a new goal on a large plan, beside networkx' A*", [(0, 0)]),
    "forecast": ("twenty futures of one scene", [(1, 10), (1, 200)]),
    "train": ("an iteration of Social GAN's training", [(64, 10)]),
}
"""What each section times, and its sizes: scenes and people."""


def run(argv: list[str]) -> int:
    """Measure and print; returns the exit code."""
    width = max(map(len, SECTIONS))
    about = "\n".join(f"  {name:<{width}}  {text}" for name, (text, _) in SECTIONS.items())
    parser = ArgumentParser(
        "pedzoo bench",
        description=f"{COMMANDS.describe('bench')}\n\nsections:\n{about}",
        epilog=f"example: {COMMANDS.declared('bench')[0]}",
        formatter_class=RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("sections", nargs="*", metavar="SECTION", help="which (default: all)")
    add("--before", metavar="COMMIT", help="time this commit, too")
    add("--size", nargs="+", default=[], metavar="BxA", help="only these sizes: 64x5")
    add("--peer", nargs="+", default=[], metavar="FILE.py", help="other programs: tools/bench/peers/*.py")
    add("--peer_python", default="", metavar="PYTHON", help="their interpreter (default: this)")
    add("--turns", type=int, default=5, help="how often each is timed (default: 5)")
    add("--seconds", type=float, default=1.0, help="least seconds of a turn (default: 1)")
    add("--json", metavar="FILE", help="also write the report to this file")
    options = parser.parse_args(argv)
    for name in options.sections:
        if name not in SECTIONS:
            raise unknown("section", name, list(SECTIONS))
    if options.turns < 1 or not options.seconds >= 0:
        raise UserError(
            f"--turns {options.turns} --seconds {options.seconds:g}: expected 1 or more, and 0 or more"
        )

    from pedzoo.cli.output import check_outputs, write_and_print
    from pedzoo.core.machine import versions

    check_outputs(json=options.json)
    sections = asked(options.sections or list(SECTIONS), options.size)
    with ExitStack() as stack:
        programs = [stack.enter_context(closing(Program("pedzoo", CASES, tree=ROOT)))]
        if options.before:
            tree = stack.enter_context(checkout(options.before))
            programs.append(stack.enter_context(closing(Program(options.before, CASES, tree=tree))))
        for script in map(Path, options.peer):
            peer = Program(script.stem, script, options.peer_python)
            programs.append(stack.enter_context(closing(peer)))
        cases = [case for program in programs for case in program.cases(sections)]
        taken, failed = in_turns(cases, options.turns, options.seconds)
        known = {name: value for program in programs for name, value in program.versions.items()}
    changed = " with changes" if git("status", "--porcelain", "--untracked-files=no") else ""
    protocol = {"commit": git("rev-parse", "--short", "HEAD") + changed, "before": options.before}
    protocol |= {"turns": options.turns, "seconds_per_turn": options.seconds}
    report: dict[str, Any] = {
        "command": "bench",
        "protocol": protocol | {"clock": "processor time, one thread"},
        "machine": {"cpu": processor(), "system": platform.platform()},
        "versions": versions() | known,
        "rows": rows(taken),
        "failed": failed,
    }
    write_and_print(report, options.json, lambda: show(report))
    for title, error in failed.items():
        print(f"failed: {title}: {error}", file=sys.stderr)
    return 1 if failed else 0


def asked(names: Sequence[str], sizes: Sequence[str]) -> dict[str, list[tuple[int, int]]]:
    """Return sizes by section.

    Raises:
        UserError: Something that is no size, or sizes that no section has.
    """
    wanted = []
    for text in sizes:
        scenes, _, people = text.partition("x")
        if not (scenes.isdecimal() and people.isdecimal()):
            raise UserError(f"--size {text}: expected scenes x people such as 1024x5")
        wanted.append((int(scenes), int(people)))
    sections = {name: [size for size in SECTIONS[name][1] if not wanted or size in wanted] for name in names}
    sections = {name: kept for name, kept in sections.items() if kept}
    if not sections:
        known = sorted({f"{b}x{a}" for name in names for b, a in SECTIONS[name][1] if b})
        raise UserError(f"--size {' '.join(sizes)}: expected some of {', '.join(known)}")
    return sections


def in_turns(
    cases: Sequence[Case], turns: int, seconds: float
) -> tuple[dict[Case, list[float]], dict[str, str]]:
    """Return the seconds of a step in each turn, by case, and errors by title.

    Programs take turns at the same work, every second turn backwards: other load slows all of them alike.
    """
    taken: dict[Case, list[float]] = {}
    failed: dict[str, str] = {}
    for same in dict.fromkeys(map(work, cases)):
        block = [case for case in cases if work(case) == same]
        for turn in range(turns):
            for case in block[:: -1 if turn % 2 else 1]:
                title = f"{case.program.name}: {case.name}, {case.scenes} x {case.people}"
                if title in failed:
                    continue
                print(f"turn {turn + 1} of {turns}, {title}", file=sys.stderr, flush=True)
                try:
                    taken.setdefault(case, []).append(case.seconds(seconds))
                except UserError as error:
                    failed[title] = str(error)
                    taken.pop(case, None)
    return taken, failed


def work(case: Case) -> tuple[str, int, int]:
    """Return what cases share that take turns: section and size."""
    return case.section, case.scenes, case.people


def rows(taken: Mapping[Case, Sequence[float]]) -> list[dict[str, Any]]:
    """Return a row for every case: milliseconds of a step, and how many times as fast pedzoo is.

    Pedzoo's case of the same name counts; for a peer that does something else, its first one of this size.
    """
    ours = [case for case in taken if case.program.name == "pedzoo"]
    result = []
    for case, seconds in taken.items():
        values = {"ms": [1e3 * second for second in seconds]}
        if case.scenes:
            values["agent_steps_per_s"] = [case.scenes * case.people / second for second in seconds]
        row: dict[str, Any] = {"program": case.program.name, "section": case.section, "name": case.name}
        row["case"] = {"size": f"{case.scenes} x {case.people}" if case.scenes else ""}
        row |= {"n": len(seconds), "note": case.note}
        same = [own for own in ours if work(own) == work(case)]
        same.sort(key=lambda own: own.name != case.name)
        if same and case.program.name != "pedzoo":
            row["beside"] = same[0].name
            values["times_as_fast"] = [a / b for a, b in zip(seconds, taken[same[0]], strict=False)]
        row["metrics"] = {key: median(each) for key, each in values.items()}
        row["quartiles"] = {key: np.quantile(each, (0.25, 0.75)).tolist() for key, each in values.items()}
        result.append(row)
    return result


def show(report: Mapping[str, Any]) -> None:
    """Print a table for each section."""
    from rich.table import Table

    from pedzoo.cli.output import plain_console

    for section in dict.fromkeys(row["section"] for row in report["rows"]):
        head = ("work", "size", "program", "ms", "agent-steps/s", "pedzoo is x times as fast")
        table = Table(*head, title=section)
        for row in report["rows"]:
            if row["section"] == section:
                value, speed, times = row["metrics"], "", ""
                if "agent_steps_per_s" in value:
                    speed = f"{value['agent_steps_per_s']:,.0f}"
                if "times_as_fast" in value:
                    ends = row["quartiles"]["times_as_fast"]
                    times = "{:.2f} ({:.2f} to {:.2f})".format(value["times_as_fast"], *ends)
                size, ms = row["case"]["size"], f"{value['ms']:.3g}"
                table.add_row(row["name"], size, row["program"], ms, speed, times)
        plain_console().print(table)


def processor() -> str:
    """Return what the processor is called."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"^model name\s*: (.*)$", info.read_text() if info.is_file() else "", re.MULTILINE)
    return names[0] if names else platform.processor() or platform.machine()
