"""Copy the main rows of checkpoints/FORECAST.json and RESULTS.md into the README: tools/readme_results.py."""

from __future__ import annotations

import json
import re
from pathlib import Path

from pedzoo.eval.forecast import BASELINES

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results: tools/readme_results.py -->\n", "<!-- end of results -->"
WALKED, END_OF_WALKED = "<!-- walked: tools/readme_results.py -->\n", "<!-- end of walked -->"
HEADLINE = "## all suites\n"
"""The first table of checkpoints/RESULTS.md."""

INTRODUCTION = """
zara1, 8 observed and 8 predicted steps, ADE / FDE in metres. Learned rows are the mean of so many trainings ±
their standard deviation, each checkpoint chosen on the validation windows of the other scenes.

| goal | model | trainings | most likely | one random sample | best of 20, per scene | next step |
|---|---|---|---|---|---|---|
"""

READING = """
`sgan` is made for the best of 20: one of its random samples is worse than constant velocity. `window_end`
is the paper's protocol and leaks the answer. ADE of the most likely prediction of `sgan_goal` beside the
lines, on every fold:

| fold | `sgan_goal` | `bent_line` | `straight_line` |
|---|---|---|---|
"""


def main() -> None:
    """Write the tables between the README's markers."""
    readme = ROOT / "README.md"
    text = between(readme.read_text(), BEGIN, END, forecasts())
    readme.write_text(between(text, WALKED, END_OF_WALKED, walked()))


def between(text: str, begin: str, end: str, new: str) -> str:
    """Return ``text`` with what stands between two markers replaced."""
    before, _, rest = text.partition(begin)
    return f"{before}{begin}{new}\n{end}{rest.partition(end)[2]}"


def walked() -> str:
    """Return the headline of the closed-loop results, without its intervals."""
    page = (ROOT / "checkpoints" / "RESULTS.md").read_text()
    table = page.partition(HEADLINE)[2].partition("\n## ")[0].strip()
    table = re.sub(r" \[[^]]*]", "", table).replace("_per_min", " / min").replace("agent_", "")
    return f"\n{table}\n"


def forecasts() -> str:
    """Return the tables of forecasting errors."""
    rows = json.loads((ROOT / "checkpoints" / "FORECAST.json").read_text())["rows"]
    text = INTRODUCTION
    for goal in ("none", "window_end", "destination"):
        for row in rows:
            if _is(row, "zara1", goal):
                trained = "" if row["name"] in BASELINES else row["seeds"]
                text += f"| `{goal}` | `{row['name']}` | {trained} | {' | '.join(_cells(row))} |\n"
    text += READING
    for fold in ("eth", "hotel", "univ", "zara1", "zara2"):
        here = {row["name"]: row for row in rows if _is(row, fold, "window_end")}
        cells = [_value(here[name], "ade_m") for name in ("sgan_goal", "bent_line", "straight_line")]
        text += f"| {fold} | {' | '.join(cells)} |\n"
    return text


def _is(row: dict, fold: str, goal: str) -> bool:
    case = row["case"]
    return (case["fold"], case["goal"], case.get("pred_len", 8)) == (fold, goal, 8)


def _cells(row: dict) -> list[str]:
    pairs = [
        ("ade_m", "fde_m"),
        ("ade_sampled_m", "fde_sampled_m"),
        ("min_ade_20_scene_m", "min_fde_20_scene_m"),
    ]
    if row["name"] in BASELINES:
        pairs[1:] = []
    cells = [f"{_value(row, ade)} / {_value(row, fde)}" for ade, fde in pairs]
    return [*cells, *[""] * (3 - len(cells)), _value(row, "next_step_m")]


def _value(row: dict, metric: str) -> str:
    spread = row.get("spread", {}).get(metric)
    return f"{row['metrics'][metric]:.4f}" + (f" ± {spread:.4f}" if spread is not None else "")


if __name__ == "__main__":
    main()
