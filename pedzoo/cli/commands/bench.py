"""``pedzoo bench``: every speed figure of the project, measured in one run."""

from pedzoo.core.registry import run_tool

HELP = "every speed figure, as ratios measured in one run, beside other programs where they are given"
EXAMPLE = "pedzoo bench policies --before HEAD~1 --peer tools/bench/peers/pyrvo_orca.py --json speed.json"


def run(argv: list[str]) -> int:
    """Measure and print; returns the exit code."""
    return run_tool("bench", "tools.bench", argv)
