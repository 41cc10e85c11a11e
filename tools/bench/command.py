"""The command ``pedzoo bench``."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from pedzoo.cli.arguments import Arguments
from pedzoo.cli.commands.checkout.bench import EXAMPLE, HELP
from pedzoo.core.errors import UserError, unknown
from tools.bench import BENCHMARKS


def run(argv: list[str]) -> int:
    """Measure and print; returns the exit code."""
    options = _parsed(argv)

    # --help and mistakes need not wait for torch
    from pedzoo.cli.output import check_outputs, write_and_print
    from tools.bench.compare import compare, read_report
    from tools.bench.run import Run
    from tools.bench.section import Settings
    from tools.bench.tables import line, print_bench, print_comparison

    if options.device != "cpu":
        raise UserError(
            f"--device {options.device}: benchmarks are of the CPU only: expected cpu; "
            "python tools/bench/devices.py --devices cpu cuda measures the environment on others"
        )
    check_outputs(json=options.json)
    old = read_report(options.compare) if options.compare else None
    settings = Settings(
        seconds=options.seconds,
        turns=options.turns,
        quick=options.quick,
        threads=options.threads,
        sizes=options.size,
        maps=tuple(options.map),
        peers=options.peer,
        peer_python=options.peer_python,
        sgan=Path(options.sgan) if options.sgan else None,
        crowdnav=Path(options.crowdnav) if options.crowdnav else None,
        data=options.data,
    )
    measuring = Run(options.sections, settings)

    def tell(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def finish(**more: bool) -> None:
        report = measuring.report() | more
        write_and_print(report, options.json, lambda: print_bench(report))
        if old is not None:
            print_comparison(compare(old, report), options.compare)

    try:
        measuring.go(lambda row: tell(line(row)), tell)
    except (KeyboardInterrupt, UserError):
        if measuring.rows:
            print("not finished: only what was measured by then")
            finish(interrupted=True)
        raise
    finish()
    return 0


def _parsed(argv: list[str]) -> Namespace:
    names = BENCHMARKS.names()
    width = max(map(len, names))
    about = [f"  {name:<{width}}  {BENCHMARKS.describe(name)}" for name in names]
    parser = Arguments("bench", "\n".join([f"{HELP}", "", "sections:", *about]), EXAMPLE)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="which (default: all that can be run)")
    add_timing(parser, "loop, orca, profile, robots")
    parser.add_argument("--threads", type=int, default=1, help="of torch and of peers (default: 1)")
    parser.add_argument(
        "--map",
        nargs="+",
        default=[],
        metavar="PLAN",
        help="floor plans, files or office.7; each case takes the first with room",
    )
    parser.add_argument(
        "--device",
        default="cpu",
        choices=("cpu", "cuda"),
        help="cpu; tools/bench/devices.py measures the others",
    )
    parser.add_argument(
        "--sgan", metavar="FOLDER", help="checkout of the original Social GAN, for section sgan"
    )
    parser.add_argument(
        "--crowdnav", metavar="FOLDER", help="checkout of CrowdNav, for the peer crowdnav_gym.py"
    )
    parser.add_argument("--data", metavar="FOLDER", help="ETH/UCY, for section sgan (default: PEDZOO_DATA)")
    parser.add_argument("--compare", metavar="FILE", help="an older report: what has become faster or slower")
    options = timed(parser.parse_args(argv))
    for name in options.sections:
        if name not in names and ":" not in name:
            raise unknown("benchmark", name, names)
    return options


def add_timing(parser: ArgumentParser, sized: str) -> None:
    """Add the options of every benchmark that times sides and peers in turns; ``sized`` have sizes."""
    add = parser.add_argument
    add("--quick", action="store_true", help="small cases and short turns: about a minute")
    add("--seconds", type=float, help="least seconds per side and turn (default: 1; quick 0.1)")
    add("--turns", type=int, help="how often each side is timed (default: 5; quick 3)")
    add("--size", nargs="+", default=[], metavar="BxA", help=f"scenes x people in {sized}: 1024x5")
    add("--peer", nargs="+", default=[], metavar="FILE.py", help="other programs: tools/bench/peers/*.py")
    python = "interpreter of peers (default: this)"
    add("--peer_python", "--peer-python", default="", metavar="PYTHON", help=python)
    add("--json", metavar="FILE", help="also write the report to this file")


def timed(options: Namespace) -> Namespace:
    """Return the options with seconds and turns where none are given, sizes as numbers and peers as paths.

    Raises:
        UserError: Something that is no size.
    """
    seconds, turns = (0.1, 3) if options.quick else (1.0, 5)
    options.seconds = seconds if options.seconds is None else options.seconds
    options.turns = turns if options.turns is None else options.turns
    options.size = tuple(map(_size, options.size))
    options.peer = tuple(map(Path, options.peer))
    return options


def _size(text: str) -> tuple[int, int]:
    """Return scenes and people of ``1024x5``."""
    scenes, _, people = text.partition("x")
    if not (scenes.isdecimal() and people.isdecimal()):
        raise UserError(f"--size {text}: expected scenes x people such as 1024x5")
    return int(scenes), int(people)
