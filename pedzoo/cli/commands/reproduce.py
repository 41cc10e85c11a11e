"""``pedzoo reproduce``: the paper's tables and its Figure 4 beside ours; controllers; CrowdNav."""

from pedzoo.core.registry import run_tool

HELP = "the paper's tables and figure beside ours and baselines; what controllers have to show; CrowdNav"
EXAMPLE = "pedzoo reproduce table2 --quick --out results"


def run(argv: list[str]) -> int:
    """Do what is not done, print the tables and write page, report and picture; returns the exit code."""
    return run_tool("reproduce", "tools.paper", argv)
