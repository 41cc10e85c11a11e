"""Writes the bins of the likelihood score: ``python -m tools.zoo.score_bins``, with recordings at hand."""

from __future__ import annotations

import sys
from pathlib import Path

import yaml

from pedzoo.core.types import STEP_SECONDS
from pedzoo.data.datasets.eth_ucy import SCENES
from pedzoo.eval.scoring.likelihood import BINS_FILE, STEPS, ranges, recorded_windows, windows_of
from pedzoo.eval.scoring.score import Reference


def main() -> int:
    """Write the file beside the code that reads it; it must not exist, for versions do not change."""
    target = Path(__file__).parents[2] / "pedzoo" / "eval" / "scoring" / BINS_FILE
    if target.exists():
        print(f"{target} exists: name a new version in pedzoo/eval/scoring/likelihood.py", file=sys.stderr)
        return 2
    walks = {fold: recorded_windows(windows_of(Reference(fold).prepared())) for fold in SCENES}
    folds = {fold: ranges([walks[other] for other in SCENES if other != fold]) for fold in SCENES}
    folds["all"] = ranges([*walks.values()])
    text = {
        "made_of": f"windows of {STEPS * STEP_SECONDS:g} s of ETH/UCY on the true clock; 0.5 to 99.5 %",
        "folds": {fold: {name: list(ends) for name, ends in one.items()} for fold, one in folds.items()},
    }
    target.write_text(yaml.safe_dump(text, sort_keys=False, default_flow_style=None))
    print(target)
    return 0


if __name__ == "__main__":
    sys.exit(main())
