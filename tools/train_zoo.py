"""Train the weights in checkpoints/ and make their table: python tools/train_zoo.py train | export | table.

``train`` runs ``pedzoo fit`` for every model, fold and seed, as a user would, skips what is finished and
resumes what was interrupted. ``export`` copies the seed that is best in validation into checkpoints/ and
writes their sums. ``table`` evaluates every seed on the test scenes and writes checkpoints/FORECAST.md
and FORECAST.json. The recordings are found by PEDZOO_DATA.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import torch

from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.eval.forecast import BASELINES, forecast
from pedzoo.models.zoo import load, save_weights
from pedzoo.paths import shipped, weight_files
from pedzoo.train.run import RunFolder
from pedzoo.types import GoalProtocol
from pedzoo.versions import versions

OTHERS = ("eth", "hotel", "univ", "zara2")
"""Folds beside zara1: whoever replays a recording needs weights that did not see it."""


@dataclass(frozen=True)
class Recipe:
    """One row of the table: a config on a fold, under one goal protocol."""

    config: str
    fold: str = "zara1"
    goal: GoalProtocol = "window_end"
    monitor: str = "val/ade"
    seeds: int = 3
    shipped: bool = True

    @property
    def name(self) -> str:
        """The zoo name of its weights."""
        architecture = self.config.removesuffix("_destination")
        return f"{architecture}.{self.fold}{'_destination' if self.goal == 'destination' else ''}"


RECIPES = [
    Recipe("sgan", goal="none", monitor="val/min_ade_20_scene"),
    Recipe("sgan_goal"),
    Recipe("sgan_goal_map"),
    Recipe("sgan_goal_destination", goal="destination"),
    *(Recipe("sgan_goal", fold) for fold in OTHERS),
    *(Recipe("sgan_goal_map", fold, seeds=1) for fold in OTHERS),
    *(Recipe("sgan", fold, goal="none", monitor="val/min_ade_20_scene", seeds=1) for fold in OTHERS),
    Recipe("sgan_goal_map_alexnet", seeds=1, shipped=False),
    Recipe("sgan_pool", goal="none", monitor="val/min_ade_20_scene", seeds=1, shipped=False),
]
"""In the order of training: first what is shipped."""


def folder(recipe: Recipe, seed: int, runs: Path) -> RunFolder:
    """Return the run folder that ``pedzoo fit`` chooses."""
    return RunFolder(runs / recipe.config / f"{recipe.fold}-seed{seed}")


def train(recipe: Recipe, seed: int, runs: Path) -> None:
    """Train one seed in a process of its own; finished runs are left alone, interrupted ones resumed."""
    run = folder(recipe, seed, runs)
    if (run.path / "finished").is_file():
        return
    command = [sys.executable, "-m", "pedzoo.cli.main", "fit"]
    if run.last.is_file():
        command += ["--resume", str(run.path)]
    else:
        options = {"config": recipe.config, "data.fold": recipe.fold, "seed_everything": seed}
        options |= {"monitor": recipe.monitor, "runs": runs}
        command += [word for key, value in options.items() for word in (f"--{key}", str(value))]
    log = runs / f"{recipe.config}-{recipe.fold}-{seed}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    quiet = [*command, "--trainer.enable_progress_bar", "false"]
    with log.open("a") as out:
        code = subprocess.run(
            quiet, stdout=out, stderr=out, env=os.environ | {"OMP_NUM_THREADS": "1"}
        ).returncode
    if code:
        raise SystemExit(f"{' '.join(command)} failed: see {log}")
    (run.path / "finished").touch()
    print(f"{recipe.name} seed {seed}: {recipe.monitor} {validation(recipe, seed, runs):.4f}", flush=True)


def validation(recipe: Recipe, seed: int, runs: Path) -> float:
    """Return the best value of the monitored validation metric, by which checkpoint and seed are chosen."""
    with (folder(recipe, seed, runs).path / "metrics.csv").open() as file:
        return min(float(row[recipe.monitor]) for row in csv.DictReader(file) if row.get(recipe.monitor))


def finished(recipe: Recipe, runs: Path) -> list[int]:
    """Return the seeds whose training is done."""
    return [seed for seed in range(recipe.seeds) if (folder(recipe, seed, runs).path / "finished").is_file()]


def checkpoint(recipe: Recipe, seed: int, runs: Path) -> str:
    """Return the checkpoint that validation chose."""
    return str(folder(recipe, seed, runs).best)


def export(runs: Path) -> None:
    """Write the shipped weights and their sums."""
    target = shipped("checkpoints")
    for recipe in RECIPES:
        if recipe.shipped and (seeds := finished(recipe, runs)):
            best = min(seeds, key=lambda seed: validation(recipe, seed, runs))
            training = {
                "config": recipe.config,
                "fold": recipe.fold,
                "seed": best,
                "chosen_by": recipe.monitor,
            }
            source = checkpoint(recipe, best, runs)
            protocol = torch.load(source, weights_only=True)["pedzoo"]["protocol"]
            file = target / f"{recipe.name}.safetensors"
            digest = save_weights(load(source), file, protocol=protocol, training=training)
            print(f"{recipe.name}: seed {best}, sha256 {digest}")
    files = weight_files().values()
    sums = "".join(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in files)
    (target / "SHA256SUMS").write_text(sums)


def rows(runs: Path) -> Iterator[dict]:
    """Yield one row per recipe and baseline: test errors of every seed."""
    told: set[tuple[str, str]] = set()
    for recipe in RECIPES:
        if not (seeds := finished(recipe, runs)):
            continue
        data = TrajectoryDataModule(fold=recipe.fold, goal=recipe.goal)
        case = {"fold": recipe.fold, "goal": recipe.goal}
        by_seed = []
        for seed in seeds:
            report = forecast([checkpoint(recipe, seed, runs)], data, seed=seed)["rows"]
            by_seed.append(report[1])
            if (recipe.fold, recipe.goal) not in told:
                told.add((recipe.fold, recipe.goal))
                yield from ({**row, "case": case, "seeds": 1} for row in report if row["name"] in BASELINES)
        metrics = {key: [row["metrics"][key] for row in by_seed] for key in by_seed[0]["metrics"]}
        yield {
            "name": recipe.config,
            "case": case,
            "n": by_seed[0]["n"],
            "seeds": len(seeds),
            "metrics": {key: statistics.fmean(values) for key, values in metrics.items()},
            "spread": {
                key: statistics.stdev(values) if len(values) > 1 else None for key, values in metrics.items()
            },
            "per_seed": metrics,
        }


HEADER = """# Open-loop results

Made by `python tools/train_zoo.py train && python tools/train_zoo.py table`; for machines: FORECAST.json.
8 observed and 8 predicted steps of 0.4 s, Social GAN's windows, metres; the checkpoint of every run is
chosen on the validation windows of the other scenes. Mean of the seeds, their standard deviation behind ±.

`ade`, `fde` and `next_step` judge the one most likely prediction (noise zero); `sampled ade` is one random
sample; `best of 20` takes one sample for all people of a window together (scene), or each their own
(agent). Under `window_end` the goal is the answer's last position and leaks it: read the lines' rows.
"""

COLUMNS = {
    "ade_m": "ade", "fde_m": "fde", "next_step_m": "next step", "ade_sampled_m": "sampled ade",
    "min_ade_20_scene_m": "best of 20 ade, scene", "min_fde_20_scene_m": "fde, scene",
    "min_ade_20_agent_m": "ade, agent", "min_fde_20_agent_m": "fde, agent",
    "sample_distance_m": "samples apart",
}  # fmt: skip


def table(runs: Path) -> None:
    """Write FORECAST.md and FORECAST.json."""
    found = list(rows(runs))
    lines = [HEADER]
    cases = list(dict.fromkeys((row["case"]["fold"], row["case"]["goal"]) for row in found))
    for fold, goal in cases:
        mine = [row for row in found if (row["case"]["fold"], row["case"]["goal"]) == (fold, goal)]
        lines += [f"## {fold}, goal `{goal}`, {mine[0]['n']} people\n"]
        lines += [
            "| model | seeds | " + " | ".join(COLUMNS.values()) + " |",
            "|---" * (len(COLUMNS) + 2) + "|",
        ]
        for row in mine:
            cells = [_cell(row, key) for key in COLUMNS]
            lines.append(f"| {row['name']} | {row['seeds']} | " + " | ".join(cells) + " |")
        lines.append("")
    target = shipped("checkpoints")
    (target / "FORECAST.md").write_text("\n".join(lines))
    report = {"command": "tools/train_zoo.py table", "versions": versions(), "rows": found}
    (target / "FORECAST.json").write_text(json.dumps(report, indent=1) + "\n")
    print("\n".join(lines))


def _cell(row: dict, key: str) -> str:
    spread = row.get("spread", {}).get(key)
    return f"{row['metrics'][key]:.4f}" + (f" ± {spread:.4f}" if spread is not None else "")


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["train", "export", "table"])
    parser.add_argument("--runs", type=Path, default=Path("runs/zoo"))
    parser.add_argument("--jobs", type=int, default=2, help="trainings at a time")
    parser.add_argument("--only", default="", help="only recipes whose name starts with this")
    options = parser.parse_args()
    if options.what == "train":
        wanted = [(r, seed) for r in RECIPES if r.name.startswith(options.only) for seed in range(r.seeds)]
        with ThreadPoolExecutor(options.jobs) as pool:
            for done in [pool.submit(train, recipe, seed, options.runs) for recipe, seed in wanted]:
                done.result()
    else:
        {"export": export, "table": table}[options.what](options.runs)


if __name__ == "__main__":
    main()
