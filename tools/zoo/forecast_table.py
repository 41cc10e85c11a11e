"""The errors of every seed on the test scenes: checkpoints/results/FORECAST.md and FORECAST.json."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterator
from pathlib import Path

from zoo_recipes import RECIPES

from pedzoo.core.machine import versions
from pedzoo.core.paths import shipped, write_atomically
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import forecast, forecast_row
from pedzoo.models.zoo.loading import load
from tools.pages.tables import table as markdown

HEADER = """# Open-loop results of every seed

Made by `python tools/zoo/train_zoo.py train && python tools/zoo/train_zoo.py table`; as JSON: FORECAST.json.
Social GAN's windows of 8 observed steps of 0.4 s, metres; the checkpoint of every run is chosen on the
validation windows of the other scenes. Mean of the seeds, their standard deviation behind ±. The weights that
were chosen, beside the published numbers: TABLE1.md, made by `pedzoo reproduce table1`.

`ade`, `fde` and `next_step` judge the one most likely prediction (noise zero); `sampled ade` is one random
sample; `best of 20` takes one sample for all people of a window together (scene), or each their own
(agent); `anchors` are centroids of training futures, the floor under it.
Under `window_end` the goal is the answer's last position and leaks it: read the lines' rows.
"""

COLUMNS = {
    "ade_m": "ade", "fde_m": "fde", "next_step_m": "next step", "ade_sampled_m": "sampled ade",
    "min_ade_20_scene_m": "best of 20 ade, scene", "min_fde_20_scene_m": "fde, scene",
    "min_ade_20_agent_m": "ade, agent", "min_fde_20_agent_m": "fde, agent",
    "fde_of_min_ade_20_agent_m": "fde of the best by ade", "miss_rate_20": "missed by 2 m",
    "sample_distance_m": "samples apart", "calibration_error": "calibration error",
    "nll_nats_per_step": "nll",
}  # fmt: skip

USUAL = {"pred_len": 8}
"""What rows of earlier tables do not say."""


def table(root: Path) -> None:
    """Write both files; rows of more seeds than there are runs of below ``root`` stay as they are."""
    target = shipped("checkpoints") / "results"
    result: dict[tuple, dict] = {}
    for row in [*json.loads((target / "FORECAST.json").read_text())["rows"], *rows(root)]:
        key = row["name"], place_of(row["case"])
        if key not in result or row["seeds"] >= result[key]["seeds"]:
            result[key] = row
    ordered = sorted(result.values(), key=lambda row: place_of(row["case"]))
    report = {"command": "tools/zoo/train_zoo.py table", "versions": versions(), "rows": ordered}
    write_atomically(target / "FORECAST.json", (json.dumps(report, indent=1) + "\n").encode())
    write_atomically(target / "FORECAST.md", page(ordered).encode())


def rows(root: Path) -> Iterator[dict]:
    """Yield one row per recipe and baseline: test errors of every seed."""
    done: set[tuple[int, str, str]] = set()
    for recipe in RECIPES:
        # on the true clock other windows are scored, and the cards say with which errors
        if recipe.clock == "true" or not (seeds := recipe.finished(root)):
            continue
        data = TrajectoryDataModule(fold=recipe.fold, goal=recipe.goal, pred_len=recipe.pred_len)
        case = {"fold": recipe.fold, "goal": recipe.goal, "pred_len": recipe.pred_len}
        baselines = () if place_of(case) in done else forecast([], data)["rows"]
        done.add(place_of(case))
        yield from ({**row, "case": case, "seeds": 1} for row in baselines)
        models = {seed: load(recipe.run(seed, root).best) for seed in seeds}
        by_seed = [forecast_row(recipe.config, model, data, seed=seed) for seed, model in models.items()]
        metrics = {key: [row["metrics"][key] for row in by_seed] for key in by_seed[0]["metrics"]}
        yield {
            "name": recipe.config,
            "case": case,
            "n": by_seed[0]["n"],
            "seeds": len(by_seed),
            "metrics": {key: statistics.fmean(values) for key, values in metrics.items()},
            "spread": {key: statistics.stdev(v) if len(v) > 1 else None for key, v in metrics.items()},
            "per_seed": metrics,
        }


def page(rows: list[dict]) -> str:
    """Return the tables, one for each fold and protocol."""
    lines = [HEADER]
    for place in dict.fromkeys(place_of(row["case"]) for row in rows):
        mine = [row for row in rows if place_of(row["case"]) == place]
        pred_len, goal, fold = place
        columns = {key: title for key, title in COLUMNS.items() if any(key in row["metrics"] for row in mine)}
        lines += [f"## {fold}, goal `{goal}`, {pred_len} predicted steps, {mine[0]['n']} people\n"]
        cells = [[row["name"], str(row["seeds"]), *(_cell(row, key) for key in columns)] for row in mine]
        lines += [markdown(["model", "seeds", *columns.values()], cells)]
    return "\n".join(lines)


def place_of(case: dict) -> tuple[int, str, str]:
    """Return steps, goal protocol and fold."""
    case = USUAL | case
    return case["pred_len"], case["goal"], case["fold"]


def _cell(row: dict, key: str) -> str:
    if key not in row["metrics"]:
        return ""
    spread = row.get("spread", {}).get(key)
    return f"{row['metrics'][key]:.4f}" + (f" ± {spread:.4f}" if spread is not None else "")
