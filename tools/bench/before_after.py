"""Measures a commit and the working tree in one run, in turns, on one thread, beside other programs.

    python tools/bench/before_after.py --before f998d3e --json speed.json
    python tools/bench/before_after.py --sections environment --quick
    python tools/bench/before_after.py --peer tools/bench/peers/*.py --peer_python ../venv_peers/bin/python

The commit is checked out into a temporary worktree. Each side runs ``side.py`` in a process of its own.
``README.md`` beside this file says what is measured and how to read the table.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import torch

from pedzoo.cli.arguments import Arguments
from pedzoo.cli.output import check_outputs, write_json
from pedzoo.core.errors import UserError
from tools.bench.command import add_timing, timed
from tools.bench.comparison import SIDES, measure, rows
from tools.bench.peer import Peer, PeerCase, Scenes, check
from tools.bench.scenes import Size
from tools.bench.sections.loop import ORCA, Walk
from tools.bench.tables import print_bench
from tools.bench.turns import load, machine

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SIDE = HERE / "side.py"
EXAMPLE = "python tools/bench/before_after.py --sections environment --size 64x5 --quick"
BEFORE = "f998d3e"
"""The commit before the kernel (issue 19)."""

PATIENCE = 600.0
"""Seconds that an answer may take beyond its turn: in the first one a program builds and warms up."""

SIZES = {
    "environment": ((1, 5), (64, 5), (1024, 5)),
    "policies": ((64, 5),),
    "safety": ((1024, 5),),
    "controller": ((1, 2), (1, 20), (1, 200)),
}
"""Scenes and agents of every section; sections are those of ``side.py``."""


def main(argv: Sequence[str]) -> int:
    """Measure, write and print; returns the exit code."""
    try:
        options = parsed(argv)
        check_outputs(json=options.json)
        for script in options.peer:
            check(script, options.peer_python)
        if options.turns < 1 or not options.seconds > 0:
            raise UserError(f"--turns {options.turns} --seconds {options.seconds:g}: expected above 0")
        asked = questions(options.sections, options.size)
        report = measured(options, asked)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if options.json:
        write_json(options.json, report)
    print_bench(report)
    return 1 if report["skipped"] else 0


def parsed(argv: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        UserError: A wrong one.
    """
    parser = Arguments("before_after", (__doc__ or "").partition("\n")[0], EXAMPLE)
    parser.prog = "python tools/bench/before_after.py"
    parser.add_argument("--before", default=BEFORE, metavar="COMMIT", help=f"default: {BEFORE}")
    parser.add_argument("--sections", nargs="+", choices=[*SIZES], default=[*SIZES], help="default: all")
    add_timing(parser, "the sections")
    options = timed(parser.parse_args(argv))
    # It answers nothing: the other peers import it.
    options.peer = [script for script in options.peer if script.name != "answering.py"]
    return options


def questions(sections: Sequence[str], sizes: Sequence[tuple[int, int]]) -> list[Scenes]:
    """Return what sides are asked about: sections at sizes, without any states.

    Raises:
        UserError: None of the sizes is measured in these sections.
    """
    every = [(size, name) for name in sections for size in SIZES[name]]
    if sizes:
        every = [(size, name) for size, name in every if size in sizes]
    if not every:
        given = " ".join(f"{scenes}x{people}" for scenes, people in sizes)
        raise UserError(f"--size {given}: none is measured in {', '.join(sections)}")
    return [Scenes(name, size[0], size[1], {}, [], [], [], [], []) for size, name in sorted(every)]


def measured(options: Namespace, asked: Sequence[Scenes]) -> dict[str, Any]:
    """Run both sides and the peers; returns the report.

    Raises:
        UserError: There is no such commit, or a program does not start.
    """
    busy = load()
    with ExitStack() as stack:
        tree = stack.enter_context(checkout(options.before))

        def start(script: Path, python: str, environment: dict[str, str]) -> Peer:
            program = Peer(script, python, 1, PATIENCE, environment)
            stack.callback(program.close)
            return program

        sides = {name: start(SIDE, "", of(where)) for name, where in zip(SIDES, (tree, ROOT), strict=True)}
        cases = [(name, case) for name, side in sides.items() for case in known(side, asked, name)]
        for name, where in zip(SIDES, (tree, ROOT), strict=True):
            if sides[name].versions["tree"] != str(where):
                raise UserError(
                    f"{name}: imported pedzoo from {sides[name].versions['tree']}, not from {where}"
                )
        moments = states(asked) if options.peer else []
        peers = [start(script, options.peer_python, {}) for script in options.peer]
        cases += [(case.peer, case) for peer in peers for case in known(peer, moments, peer.script.stem)]
        timed, failed = measure(cases, options.turns, options.seconds, tell)
        versions = {name: each for peer in (sides["after"], *peers) for name, each in peer.versions.items()}
    changed = " with changes" if git("status", "--porcelain", "--untracked-files=no") else ""
    return {
        "command": "before_after",
        "protocol": {
            "before": commit(options.before),
            "after": commit("HEAD") + changed,
            "turns": options.turns,
            "seconds_per_turn": options.seconds,
            "threads": 1,
            "device": "cpu",
            "clock": "processor time",
        },
        "machine": machine() | {"load_before": busy, "load_after": load()},
        "versions": {name: each for name, each in versions.items() if name != "tree"},
        "skipped": failed,
        "rows": [row.as_json() for row in rows(timed)],
    }


def known(program: Peer, asked: Sequence[Scenes], name: str) -> list[PeerCase]:
    """Return what a program can do of what is asked."""
    tell(f"{name} starts")
    return program.cases(asked)


def states(asked: Sequence[Scenes]) -> list[Scenes]:
    """Return the middle of walks, at the environment's sizes, for peers to start from."""
    tell("states for peers")
    torch.set_num_threads(1)
    sizes = [Size(each.scenes, each.people) for each in asked if each.section == "environment"]
    return [Walk(f"goals:map=apartment.7,people={size.people}", size, ORCA).scenes() for size in sizes]


def of(tree: Path) -> dict[str, str]:
    """Return the variables under which Python imports pedzoo from a checkout and uses one thread."""
    return {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


@contextmanager
def checkout(name: str) -> Iterator[Path]:
    """Give a temporary worktree of a commit, and remove it after the block.

    Raises:
        UserError: There is no such commit.
    """
    with tempfile.TemporaryDirectory(prefix="before_after_") as folder:
        tree = Path(folder).resolve() / "before"
        git("worktree", "add", "--detach", str(tree), commit(name))
        try:
            yield tree
        finally:
            git("worktree", "remove", "--force", str(tree))


def commit(name: str) -> str:
    """Return the short hash of a commit.

    Raises:
        UserError: There is no such commit.
    """
    return git("rev-parse", "--short", "--verify", f"{name}^{{commit}}")


def git(*words: str) -> str:
    """Return what git answers in this repository.

    Raises:
        UserError: It fails.
    """
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise UserError(f"git {' '.join(words)}: {done.stderr.strip()}")
    return done.stdout.strip()


def tell(line: str) -> None:
    """Show what is going on."""
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
