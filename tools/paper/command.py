"""The command ``pedzoo reproduce``."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import COMMANDS

if TYPE_CHECKING:
    from tools.paper.base import Reproduction

_WALKED = "models episodes physics"
MADE = {
    "table1": ("forecasts.Table1", "folds data_root"),
    "forecasting": ("forecasts.Forecasting", "folds data_root"),
    "table2": ("table2.Table2", f"{_WALKED} maps"),
    "figure4": ("figure4.Figure4", _WALKED),
    "loop": ("loop.Loop", f"{_WALKED} maps data_root"),
    "gc": ("gc.GrandCentral", "models data_root"),
    "crowdnav": ("crowdnav.Crowdnav", "models episodes"),
    "robots": ("robots.RobotTransfer", f"{_WALKED} data_root"),
}
"""What can be made: its class, and those of its options that only some have a use for."""

_ABOUT = """
table1   forecasts on ETH/UCY: five folds, 8 and 12 steps, every protocol, released Social GANs
forecasting  a best of 20 with a floor: centroids, networks on them, published rows and their leaks
table2   from goal to goal: total steps, goals per person, steps per goal, at two speeds
figure4  two people at a narrow door: who is blocked, who circles, who passes; with a picture
loop     what controllers trained in the loop have to show: doors, buildings, crowds, noise, recorded people
gc       people of Grand Central from 2 s of history to their exits, as PCS and SPDiff are judged
crowdnav robots among CrowdNav's 5 and CrowdNav++'s 20 people; --models names robots, or FILE.py:Class
robots   robots trained among each kind of people, tested among all others and in a recorded crowd

Writes TABLE1.md and .json, TABLE2, FIGURE4, LOOP, FORECASTING, GC, CROWDNAV, ROBOTS.
What was interrupted goes on."""

_FLAGS = {"data_root": "data.root", "maps": "map"}


class Arguments(ArgumentParser):
    """argparse with pedzoo's exit code and one line in place of the usage."""

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        raise UserError(f"{message} (see {self.prog} --help)")


def _parser() -> ArgumentParser:
    about = f"{COMMANDS.describe('reproduce')}\n{_ABOUT}"
    how: dict[str, Any] = {"allow_abbrev": False, "formatter_class": RawDescriptionHelpFormatter}
    example = f"example: {COMMANDS.declared('reproduce')[0]}"
    parser = Arguments("pedzoo reproduce", description=about, epilog=example, **how)
    add = parser.add_argument
    add("what", choices=MADE, help="what is made")
    add("--out", metavar="FOLDER", default=".", help="for page, report and picture")
    add("--quick", action="store_true", help="zara1 alone; a tenth of the episodes")
    add("--seeds", default="0", help="of samples or scenes, between commas (forecasts: one)")
    add("--workers", type=int, default=1, help="processes; the numbers stay the same")
    add("--folds", metavar="FOLD,...", help="forecasts: test scenes (default: all five)")
    add("--data.root", dest="data_root", metavar="FOLDER", help="forecasts, loop, robots: the recordings")
    add("--models", nargs="+", metavar="NAME", help="not table1: instead of the usual ones")
    add("--episodes", type=int, help="not table1: of every case and seed")
    add("--physics", metavar="NAME", help="not table1 (default: as each case says)")
    add("--map", dest="maps", nargs="+", metavar="PLAN", help="table2, loop: floor plans, files or names")
    return parser


def run(argv: list[str]) -> int:
    """Do what is not done, print the tables and write page, report and picture; returns the exit code."""
    options = _parser().parse_args(argv)

    from pedzoo.cli.check import whole_numbers
    from pedzoo.cli.output import check_outputs, overall_bar, print_tables, write_json, write_text
    from pedzoo.core.machine import versions
    from tools.paper.base import markdown

    for key, value in vars(options).items():
        having = [name for name, (_, uses) in MADE.items() if key in uses.split()]
        if having and value is not None and options.what not in having:
            flag = _FLAGS.get(key, key)
            raise UserError(f"--{flag}: no use for it in {options.what}; {', '.join(having)} would have")
    folder, stem = Path(options.out), options.what.upper()
    page, file, journal = (folder / f"{stem}{end}" for end in (".md", ".json", ".json.partial"))
    check_outputs(out=str(page), json=str(file))
    made = _made(options, journal, whole_numbers("--seeds", options.seeds))
    if made.parts[0]:
        print(f"{made.parts[0]} of {made.parts[1]} parts were done before: {journal}")

    def tell(**more: bool) -> None:
        report = {"command": "reproduce", **made.report(), "versions": versions(), **more}
        if not more:
            write_json(file, report)
            write_text(page, markdown(made, report, ["pedzoo", "reproduce", *argv], made.draw(folder)))
        for note in report["notes"]:
            print(f"note: {note}")
        print_tables(made.pages(report))
        if not more:
            print(f"page:   {page}\nreport: {file}")

    try:
        with overall_bar() as progress:
            made.run(options.workers, progress)
    except (KeyboardInterrupt, UserError, RuntimeError):  # the last: a worker was killed
        done, total = made.parts
        if done:
            tell(interrupted=True)
            print(f"not finished: {done} of {total} parts, kept in {journal}: the same command goes on")
        raise
    tell()
    if made.others:  # of a larger table, perhaps, that was interrupted before a quick one was made
        print(f"kept:   {journal}, with {made.others} parts of another request, other weights or other code")
    else:
        journal.unlink(missing_ok=True)  # the report has all of it
    return 0


def _made(options: Namespace, journal: Path, seeds: list[int]) -> Reproduction:
    """Return the reproduction that was asked for; errors of what is not there."""
    from pedzoo.eval.suite import EvaluationOptions
    from tools.paper.published import FOLDS

    where, uses = MADE[options.what]
    file, _, name = where.partition(".")
    make = getattr(import_module(f"tools.paper.{file}"), name)
    if "folds" in uses:
        if len(seeds) != 1:
            raise UserError(f"--seeds {options.seeds}: {options.what} has one seed of its samples")
        folds = options.folds.split(",") if options.folds else ["zara1"] if options.quick else list(FOLDS)
        for fold in folds:
            if fold not in FOLDS:
                raise unknown("fold", fold, FOLDS)
        return make(folds, seeds[0], options.data_root, journal)
    if options.what == "crowdnav":
        from tools.paper.crowdnav import CASES

        if seeds != [0]:
            raise UserError(f"--seeds {options.seeds}: crowdnav has the seeds of its cases")
        count = options.episodes if options.episodes is not None else CASES // 10 if options.quick else CASES
        return make(options.models or (), count, journal)
    settings = EvaluationOptions(
        episodes=options.episodes,
        quick=options.quick,
        physics=options.physics,
        maps=tuple(options.maps or ()),
        root=options.data_root,
    )
    return make(options.models or (), settings, seeds, journal)
