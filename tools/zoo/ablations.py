"""Trains `closed_loop/social_walker_styled` with one part left out at a time, and scores each walker.

    python -m tools.zoo.ablations --runs runs/ablations

Every training has as many updates as the whole one; finished ones are left alone, interrupted ones go on.
`--jobs 11 --train` trains all of them at once and scores none; a later call finds them trained.
Writes checkpoints/results/ABLATIONS.md and .json. The recordings are found by PEDZOO_DATA.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from pedzoo.core.paths import shipped
from pedzoo.models.zoo.publish import monitored
from pedzoo.train.run import RunFolder
from tools.pages.score_page import cell
from tools.pages.tables import table

CONFIG = "closed_loop/social_walker_styled"
MODEL = "model.generator.init_args"
PARTS: dict[str, dict[str, str]] = {
    "the whole": {},
    "the whole, another seed": {"seed_everything": "1"},
    "the whole, a third seed": {"seed_everything": "2"},
    "without style": {
        f"{MODEL}.architecture.style": "false",
        f"{MODEL}.architecture.style_prior": "false",
    },
    "without noise at every step": {f"{MODEL}.architecture.step_noise": "false"},
    "without held velocities": {f"{MODEL}.architecture.held": "false"},
    "without companions": {
        f"{MODEL}.architecture.companions": "false",
        f"{MODEL}.architecture.groups": "false",
    },
    "without evasion": {f"{MODEL}.architecture.avoids": "false"},
    "without following": {f"{MODEL}.architecture.follows": "false"},
    "with two layers of 64": {f"{MODEL}.architecture.hidden_dim": "64"},
    "without weight decay": {"model.weight_decay": "0.0"},
    "without the layer in training": {f"{MODEL}.walking.safety": "false"},
}
"""Settings of each training beside those of the config."""

COLUMNS = {
    "realism": "realism",
    "coarse_realism": "realism, coarse",
    "classifier_auc": "AUC",
    "coarse_classifier_auc": "AUC, coarse",
    "min_ade_20_8s_m": "minADE_20, m",
    "coarse_acceleration_p95_ratio": "acceleration p95, coarse",
    "standing_share": "standing",
    "companions_near_share": "companions near",
    "agent_contacts_per_min": "touches/min",
}
"""Metrics of `docs/score.md`, and what they are called here."""


def recipe(name: str, options: argparse.Namespace) -> tuple[RunFolder, dict[str, str]]:
    """Return the run folder of one variant, and the options of its `pedzoo fit`."""
    root = options.runs / f"{options.epochs}_epochs" / name.replace(" ", "_").replace(",", "")
    given = {
        "config": CONFIG, "data.fold": options.fold, "seed_everything": "0", "runs": str(root),
        "monitor": "val/unlike", "trainer.max_epochs": str(options.epochs),
        "trainer.check_val_every_n_epoch": str(options.epochs), **PARTS[name],
    }  # fmt: skip
    run = root / CONFIG.replace("/", ".") / f"{options.fold}-seed{given['seed_everything']}"
    return RunFolder(run), given


def trained(run: RunFolder, options: Mapping[str, str]) -> float:
    """Train one variant unless that is done; return its best validation value."""
    if not (run.path / "finished").is_file():
        command = [sys.executable, "-m", "pedzoo.cli.main", "fit"]
        if run.last.is_file():
            command += ["--resume", str(run.path)]
        else:
            command += [word for key, value in options.items() for word in (f"--{key}", value)]
        print(" ".join(command[2:]), flush=True)
        quiet = [*command, "--trainer.enable_progress_bar", "false"]
        subprocess.run(quiet, check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        (run.path / "finished").touch()
    return min(monitored(run.path, "val/unlike").values())


def scored(run: RunFolder, fold: str) -> dict[str, Any]:
    """Score one variant unless that is done; return the report of `pedzoo score`."""
    report = run.path / "score.json"
    if not report.is_file():
        # without the layer in training, it walks under the layer all the same
        command = [sys.executable, "-m", "pedzoo.cli.main", "score", f"{run.best}:safety=true"]
        subprocess.run([*command, "--against", fold, "--json", str(report)], check=True)
    return json.loads(report.read_text())


def page(rows: list[dict[str, Any]], fold: str, epochs: int) -> Iterator[str]:
    """Yield the lines of the page."""
    yield from ("# What each part of the walker is worth", "")
    yield (
        f"Made by `python -m tools.zoo.ablations --fold {fold} --epochs {epochs}`: `{CONFIG}` without "
        f"{fold}, trained for {epochs} epochs of 100 updates (the zoo has 6), one part left out at a time. "
        f"Commit: {', '.join(sorted({row['commit'] for row in rows if 'commit' in row}))}."
    )
    yield (
        f"Each crowd takes the place of all people of {fold} under the safety layer. "
        "[docs/score.md](../../docs/score.md) has the formulas; brackets are 95 % intervals over blocks of "
        "time. The whole has three seeds: what differs less than these is chance."
    )
    yield (
        "Less is better for val/unlike (people of the training scenes), realism, AUC and minADE. The ratio "
        "is best at 1, the last three as those of real people, whose row is the last."
    )
    yield ""
    body = [[row["name"], *([row["unlike"]] if "unlike" in row else ["-"])] for row in rows]
    for line, row in zip(body, rows, strict=True):
        line += [cell(row, key) for key in COLUMNS]
    yield table(["walker", "val/unlike", *COLUMNS.values()], body)


def main() -> None:
    """Train, score and write."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--runs", type=Path, default=Path("runs/ablations"))
    parser.add_argument("--fold", default="zara1", help="the recording that no training sees")
    parser.add_argument("--epochs", type=int, default=6, help="of 100 updates")
    parser.add_argument(
        "--parts", nargs="+", choices=[*PARTS], help="train and score these alone, and write no page"
    )
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time")
    parser.add_argument("--train", action="store_true", help="train, and score nothing")
    options = parser.parse_args()
    names = [name for name in PARTS if not options.parts or name in options.parts]
    recipes = {name: recipe(name, options) for name in names}
    unlikes: dict[str, float] = {}
    with ThreadPoolExecutor(options.jobs) as pool:
        for name, unlike in zip(names, pool.map(lambda one: trained(*one), recipes.values()), strict=True):
            print(f"{name}: val/unlike {unlike:.3f}", flush=True)
            unlikes[name] = unlike
    if options.train:
        return
    rows, real = [], {}
    for name, unlike in unlikes.items():
        report = scored(recipes[name][0], options.fold)
        real, walker = report["rows"][0], report["rows"][-1]
        versions = report["versions"]
        rows.append(walker | {"name": name, "unlike": f"{unlike:.3f}", "commit": versions["commit"]})
    if options.parts:
        return
    out = shipped("checkpoints") / "results" / "ABLATIONS.md"
    out.write_text("\n".join(page([*rows, real], options.fold, options.epochs)) + "\n")
    out.with_suffix(".json").write_text(json.dumps([*rows, real], indent=1) + "\n")
    print(out)


if __name__ == "__main__":
    main()
