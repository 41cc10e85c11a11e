"""The root of the command line: finds commands, prints the overview, turns errors into exit codes.

Nothing heavy is imported here: the overview is read from files, and a command is imported when it is run.
Exit codes: 0 done; 1 our fault (with a traceback); 2 the user's mistake (one line); 130 interrupted, and
143, 129 or 138 ended by SIGTERM, SIGHUP or Slurm's SIGUSR1.
"""

import errno
import os
import sys

from pedzoo import __version__
from pedzoo.cli.signals import EndedBySignal, exit_code, handle_signals
from pedzoo.core.errors import NO_ROOM, UserError, lacks_memory, missing_extra
from pedzoo.core.paths import config_names, weight_files
from pedzoo.core.registry import (
    COMMANDS,
    DATASETS,
    METRICS,
    MODELS,
    PHYSICS,
    POLICIES,
    ROBOT_POLICIES,
    ROBOTS,
    SCENARIOS,
)


def main(argv: list[str] | None = None) -> int:
    """Run one command and return the exit code."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        with handle_signals():
            code = _dispatch(argv)
            sys.stdout.flush()
            return code
    except KeyboardInterrupt as stop:
        said = f"ended by {stop}" if isinstance(stop, EndedBySignal) else "interrupted"
        print(f"pedzoo: {said}", file=sys.stderr)
        return exit_code(stop)
    except BrokenPipeError:  # of `| head`: no more is read, not at exit either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except Exception as error:
        if (refusal := _refusal(error)) is None:
            raise
        # in one line, without what a server or a file put there as orders to the terminal
        readable = "".join(sign if sign.isprintable() else " " for sign in str(refusal))
        print(f"pedzoo: {' '.join(readable.split())}", file=sys.stderr)
        return 2


def _refusal(error: Exception) -> UserError | None:
    """Return what is said about an error that a person can do something about; None for ours."""
    name, number = getattr(error, "filename", None), getattr(error, "errno", None)
    if isinstance(error, UserError):
        return error
    if isinstance(error, ModuleNotFoundError):
        return missing_extra(error)
    if number == errno.ENAMETOOLONG:
        return UserError(f"{name!r:.100}: no file has so long a name")
    if number in NO_ROOM:
        return UserError(f"cannot write {name or 'a file'}: {os.strerror(number)}")
    return lacks_memory(error) if isinstance(error, MemoryError | OSError | RuntimeError) else None


def _dispatch(argv: list[str]) -> int:
    name, *words = argv or ["--help"]
    if name in ("-h", "--help", "help"):
        print(overview())
        return 0
    if name in ("-V", "--version"):
        print(f"pedzoo {__version__}")
        return 0
    if COMMANDS.module_of(name) is None:
        return COMMANDS.get(name)(words)  # a plugin's function, or the error with the nearest name
    from pedzoo.cli.check import check_names

    check_names(name, words)
    from pedzoo.cli.parsing import call

    return call(COMMANDS.get(name), words)


def overview() -> str:
    """Return the text of ``pedzoo --help``: every command with an example, and what there is to use."""
    names = sorted(COMMANDS.names())
    width = max(map(len, names))
    lines = ["pedzoo: train, share and evaluate learned pedestrian controllers", "", "commands:"]
    for name in names:
        lines.append(f"  {name:<{width}}  {COMMANDS.describe(name)}")
        lines += [f"  {'':<{width}}    $ {example}" for example in COMMANDS.declared(name)]
    for title, known in (
        ("models", MODELS.names()),
        ("weights", weight_files()),
        ("policies (and every model)", POLICIES.names()),
        ("scenarios", SCENARIOS.names()),
        ("robots", ROBOTS.names()),
        ("policies of robots (and every policy)", ROBOT_POLICIES.names()),
        ("physics", PHYSICS.names()),
        ("datasets", DATASETS.names()),
        ("metrics", METRICS.names()),
        ("configs", config_names()),
    ):
        rows = [""]
        for name in known or ["none yet"]:
            if len(rows[-1]) + len(name) + 2 > 96:
                rows.append("")
            rows[-1] += f"  {name}"
        lines += ["", f"{title}:", *rows]
    return "\n".join([*lines, "", "`pedzoo COMMAND --help` lists a command's options."])


if __name__ == "__main__":
    sys.exit(main())
