"""Train the robots in checkpoints/, and make their cards.

    python tools/zoo/robots.py train | export | measure [--only circle,orca] [--runs FOLDER] [--epochs N]

``train`` runs ``pedzoo fit`` for every robot as a user would, one after the other: it skips what is finished
and resumes what was interrupted. ``export`` writes weights and card of every run that has a best checkpoint.
``measure`` adds the suite ``robots``, among the robot's own people, to cards without numbers.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from msgspec.structs import replace
from safetensors.torch import save

from pedzoo.core.paths import CARD, WEIGHTS, sha256_of, shipped, write_atomically
from pedzoo.eval.cards import measure_robot
from pedzoo.models.zoo.card import ModelCard, read_card, write_card
from pedzoo.models.zoo.loading import read_weights
from pedzoo.train.run import RunFolder

ROOMS = ["--config", "robot/rooms", "--model.people"]
PEOPLE = {
    "orca": "orca",
    "social_force": "social_force:preset=indoor",
    "sgan": "approach_net_goal_map.indoor",
    "mix": "orca:share=0.34+social_force:preset=indoor,share=0.33+approach_net_goal_map.indoor:share=0.33",
}
"""Among whom robots in rooms are trained, by name."""

SEEDS = 3
"""Trainings of each of these."""

ROBOTS = {
    "circle": ["--config", "robot/ppo"],
    "circle_diff_drive": ["--config", "robot/ppo", "--model.robot", "diff_drive"],
    "crowd": ["--config", "robot/crowd"],
    "mix_diff_drive": [*ROOMS, PEOPLE["mix"], "--model.robot", "diff_drive"],
    **{
        f"{name}-seed{seed}" if seed else name: [*ROOMS, people, "--seed_everything", str(seed)]
        for seed in range(SEEDS)
        for name, people in PEOPLE.items()
    },
}
"""Options of ``pedzoo fit`` by name: among whom, and with which body."""


def fit(words: list[str], log: Path) -> None:
    """Run ``pedzoo fit`` in a process of its own, which writes into a log; ends where it fails."""
    command = [sys.executable, "-m", "pedzoo.cli.main", "fit", *words, "--trainer.enable_progress_bar=false"]
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as out:
        done = subprocess.run(command, stdout=out, stderr=out, env=os.environ | {"OMP_NUM_THREADS": "1"})
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed: see {log}")


def fit_whole(run: RunFolder, options: Mapping[str, str], log: Path) -> None:
    """Train a run with these options, or go on with it where it was interrupted; mark it as finished."""
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    fit(["--resume", str(run.path)] if run.last.is_file() else words, log)
    (run.path / "finished").touch()


def is_finished(run: RunFolder) -> bool:
    """Return whether a run was trained to its end."""
    return (run.path / "finished").is_file()


def over_seeds(by_seed: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Return the mean of every metric, its standard deviation (None of one seed), and all values."""
    found = {key: [metrics[key] for metrics in by_seed] for key in by_seed[0]}
    return {
        "metrics": {key: statistics.fmean(values) for key, values in found.items()},
        "spread": {key: statistics.stdev(v) if len(v) > 1 else None for key, v in found.items()},
        "per_seed": found,
    }


def with_spread(row: Mapping[str, Any], key: str, digits: int = 4) -> str:
    """Return the mean of a metric and its standard deviation behind ±, nothing where there is none."""
    spread = row.get("spread", {}).get(key)
    text = f"{row['metrics'][key]:.{digits}f}" if key in row["metrics"] else ""
    return text + (f" ± {spread:.{digits}f}" if spread is not None else "")


def train(name: str, runs: Path, epochs: int | None) -> None:
    """Train one robot."""
    run = run_of(name, runs)
    if run and is_finished(run):
        return
    words = ["--resume", str(run.path)] if run else [*ROBOTS[name], "--runs", str(runs / name)]
    fit([*words, *(["--trainer.max_epochs", str(epochs)] if epochs else [])], runs / f"{name}.log")
    run = run_of(name, runs)
    assert run
    (run.path / "finished").touch()


def run_of(name: str, runs: Path) -> RunFolder | None:
    """Return the run of a robot that has a checkpoint, if there is one."""
    folders = [RunFolder(path) for path in sorted((runs / name).glob("*/*"))]
    return next((one for one in folders if one.last.is_file()), None)


def export(name: str, runs: Path) -> None:
    """Write weights and card of a robot; numbers that the card has stay, if the weights do."""
    if (run := run_of(name, runs)) is None:
        print(f"{name}: not trained")
        return
    checkpoint = torch.load(run.best, weights_only=True)
    parts = [*sorted(run.path.glob("before-resume-*")), run.path]
    known = [yaml.safe_load((part / "config.yaml").read_text()) for part in parts]
    record, settings = json.loads((parts[0] / "versions.json").read_text()), known[-1]
    weights = read_weights(str(run.best))
    assert weights is not None
    config, state = weights.config, {key: value.contiguous() for key, value in weights.state.items()}
    home = shipped("checkpoints") / f"robot_ppo.{name}"
    home.mkdir(exist_ok=True)
    earlier = read_card(home / CARD) if (home / CARD).is_file() else None
    write_atomically(home / WEIGHTS, save(state, {"config": json.dumps(config, sort_keys=True)}))
    digest = sha256_of(home / WEIGHTS)
    value = float(next(iter(checkpoint["callbacks"].values()))["best_model_score"])
    scenarios, people = ", ".join(config["protocol"]["scenarios"]), config["protocol"].get("crowd")
    source = f"{scenarios}: people of {people}, who see the robot"
    if scenarios.startswith("crowdnav"):
        source = "CrowdNav's circle crossing: people of ORCA who do not see the robot"
    command, seed = record["command"], settings["seed_everything"]
    name_of_config = command[command.index("--config") + 1] if "--config" in command else None
    for option in ("--runs", "--trainer.enable_progress_bar"):  # say nothing of the weights
        if option in command:
            at = command.index(option)
            command = command[:at] + command[at + 2 :]
    epochs = ", then ".join(str(one["trainer"]["max_epochs"]) for one in known)
    training = dict.fromkeys(("fold", "clock", "goal")) | {"config": name_of_config, "seed": seed}
    training |= {"seeds": {seed: value}, "chosen_by": settings["monitor"], "value": value}
    training |= {"step": checkpoint["global_step"], "epoch": checkpoint["epoch"], "command": command}
    training |= {"overrides": {"trainer.max_epochs": epochs}}
    terms = "simulated: no recordings, but for those that people of the zoo learned from"
    card = ModelCard(
        name=home.name,
        architecture=config["architecture"],
        sha256=digest,
        size=(home / WEIGHTS).stat().st_size,
        config=config,
        training=training,
        data={"recordings": [], "source": source, "terms": terms, "citation": ""},
        evaluations=earlier.evaluations if earlier and earlier.sha256 == digest else [],
        versions=record["versions"],
        licence="MIT",
        file=WEIGHTS,
        url=None,
    )
    write_card(card, home / CARD)
    print(f"{home.name}: {settings['monitor']} {value:.3f} after epoch {checkpoint['epoch']}")


def measure(name: str) -> None:
    """Add numbers to a card that has none."""
    path = shipped("checkpoints") / f"robot_ppo.{name}" / CARD
    card = read_card(path)
    if not card.evaluations:
        known = card.config["protocol"]
        report = measure_robot(card.name, known["crowd"], known["robot"])
        write_card(replace(card, evaluations=[report]), path)
        print(f"{card.name}: measured")


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("command", choices=("train", "export", "measure"))
    parser.add_argument("--only", default=",".join(ROBOTS), help="Names, between commas.")
    parser.add_argument("--runs", type=Path, default=Path("runs/robots"), help="Folder of the run folders.")
    parser.add_argument("--epochs", type=int, help="Instead of the config's.")
    options = parser.parse_args()
    for name in options.only.split(","):
        if options.command == "train":
            train(name, options.runs, options.epochs)
        elif options.command == "export":
            export(name, options.runs)
        else:
            measure(name)


if __name__ == "__main__":
    main()
