"""The tables of docs/results.md: the main rows of FORECAST.json, RESULTS.md and LOOP.md."""

from __future__ import annotations

import json
import re
from pathlib import Path

from pedzoo.data.datasets.eth_ucy import SCENES
from pedzoo.eval.forecast import BASELINES

ROOT = Path(__file__).parents[2]
HEADLINE = "## all suites\n"
"""The first table of RESULTS.md and INDOOR.md in checkpoints/results."""

SHOWN = {
    ("doors: varied", "clean"): "two at doors of 0.7 to 1.2 m: clean",
    ("doors: varied", "time_ratio_median"): "their time / free walking, median",
    ("doors: hard", "clean"): "doors of 0.7 to 0.85 m, both there within 0.4 s: clean",
    ("doors: mirror", "clean"): "each the mirror image of the other: clean",
    ("doors: mirror", "yield_delay_s"): "how much later the second one passes, s",
    ("doors: 2 against 2", "clean"): "2 against 2 at a door: clean",
    ("doors: queue of 6", "clean"): "queue of 6: clean",
    ("doors: standing", "clean"): "a person stands at the door: clean",
    (
        "doors: flow of 20",
        "specific_flow_per_m_s",
    ): "queue of 20 at doors of 0.8 to 1.2 m: people / (m s) (real: about 1.9)",
    ("buildings: drawn", "episode_success"): "unseen drawn floor plans: all people reach all goals",
    ("buildings: drawn", "contact_free"): "no person touches anything there",
    ("buildings: drawn", "time_ratio"): "time / planned way's",
    ("buildings: aws_small_house", "time_ratio"): "time / planned way's in `aws_small_house`",
    ("buildings: crowd of 50", "success"): "50 people in an unseen office: share who arrive",
    ("buildings: crowd of 50", "contacts_per_min"): "their touches per minute",
    (
        "noise: who goes first",
        "varied",
    ): "share of doors at which another draw of noise lets another person go first",
    **{(f"replay: {fold}", "realism"): f"realism among the people of {fold}" for fold in SCENES},
}
"""Rows of checkpoints/results/LOOP.md by case and metric, and what the page calls them."""

SEEDS = "", "-seed1", "-seed2"
COLUMNS = {
    "sgan_goal_map.indoor": [f"sgan_goal_map.indoor{seed}" for seed in SEEDS],
    "sgan_goal.indoor": [f"sgan_goal.indoor{seed}" for seed in SEEDS],
    "social_walker.eth_ucy": ["social_walker.eth_ucy"],
    "social_walker.styled": ["social_walker.styled"],
    "sgan_goal_map.controller_open": ["sgan_goal_map.controller_open"],
    "go_to_goal:safety=true": ["go_to_goal:safety=true"],
    "orca:radius=0.2": ["orca:radius=0.2"],
    "orca:radius=0.3": ["orca:radius=0.3"],
    "social_force:preset=indoor": ["social_force:preset=indoor"],
}
"""Columns of the page, and those of LOOP.md of which they show the least and the most, if any."""

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


def walked(page: str = "RESULTS.md") -> str:
    """Return the headline of a page of closed-loop results, without its intervals."""
    page = (ROOT / "checkpoints" / "results" / page).read_text()
    table = page.partition(HEADLINE)[2].partition("\n## ")[0].strip()
    table = re.sub(r" \[[^]]*]", "", table).replace("_per_min", " / min").replace("agent_", "")
    return f"\n{table}\n"


def cells_of(table: str) -> list[list[str]]:
    """Return the cells of a Markdown table, the head first, without the line of dashes."""
    lines = table.strip().splitlines()
    head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [head, *rows]


def indoors() -> str:
    """Return the headline of what people do indoors, a policy in each column."""
    head, *rows = cells_of(walked("INDOOR.md"))
    columns = [[name.replace("_", " ") for name in head], *rows]
    columns[1:] = [[f"`{name}`", *cells] for name, *cells in rows]
    turned = ["| " + " | ".join(cells) + " |" for cells in zip(*columns, strict=True)]
    return "\n".join(["", turned[0], "|---" * len(columns) + "|", *turned[1:], ""])


def in_the_loop() -> str:
    """Return what controllers trained in the loop do, of several trainings the least and the most.

    Among recorded people those walk that have not seen them; where there are none, others, marked.
    """
    page = (ROOT / "checkpoints" / "results" / "LOOP.md").read_text()
    head, *rows = cells_of(page.partition("## Targets\n")[2].partition("\n## ")[0])
    columns = {column: [name for name in names if name in head] for column, names in COLUMNS.items()}
    columns = {column: names for column, names in columns.items() if names}
    by_target = {(row[0], row[1].split()[0]): dict(zip(head, row, strict=True)) for row in rows}
    seen = re.findall(r"^\* loop_replay: (\S+) was trained on", page, re.MULTILINE)
    text = f"\n| | {' | '.join(f'`{name}`' for name in columns)} |\n|---|{'---|' * len(columns)}\n"
    for key, label in SHOWN.items():
        recorded = key[0].startswith("replay")
        cells = []
        for names in columns.values():
            fresh = [name for name in names if name not in seen] if recorded else names
            cells.append(_span([by_target[key][name] for name in fresh or names]) + "*" * (not fresh))
        text += f"| {label} | {' | '.join(cells)} |\n"
    return text


def _span(cells: list[str]) -> str:
    """Return the least and the most of some cells, one number where they are the same."""
    values = {cell.split()[0] for cell in cells}
    if len(values) == 1:
        return values.pop()
    return f"{min(values, key=float)} to {max(values, key=float)}"


def forecasts() -> str:
    """Return the tables of forecasting errors."""
    rows = json.loads((ROOT / "checkpoints" / "results" / "FORECAST.json").read_text())["rows"]
    text = INTRODUCTION
    for goal in ("none", "window_end", "destination"):
        for row in rows:
            if _is(row, "zara1", goal):
                trained = "" if row["name"] in BASELINES else row["seeds"]
                text += f"| `{goal}` | `{row['name']}` | {trained} | {' | '.join(_cells(row))} |\n"
    text += READING
    for fold in SCENES:
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
