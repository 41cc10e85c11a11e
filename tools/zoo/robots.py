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
import subprocess
import sys
from pathlib import Path
from typing import Any

import torch
import yaml
from msgspec.structs import replace
from safetensors.torch import save

from pedzoo.core.fetch import sha256_of
from pedzoo.core.paths import CARD, WEIGHTS, shipped, write_atomically
from pedzoo.eval.cards import measure_robot
from pedzoo.models.zoo.card import ModelCard, read_card, write_card
from pedzoo.policies.robots._weights import PREFIX
from pedzoo.train.run import RunFolder

ROOMS = ["--config", "robot/rooms", "--model.people"]
PEOPLE = {
    "orca": "orca",
    "social_force": "social_force:preset=indoor",
    "sgan": "sgan_goal_map.indoor",
    "mix": "orca:share=0.34+social_force:preset=indoor,share=0.33+sgan_goal_map.indoor:share=0.33",
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


def train(name: str, runs: Path, epochs: int | None) -> None:
    """Train one robot in a process of its own."""
    run = run_of(name, runs)
    if run and (run.path / "finished").is_file():
        return
    command = [sys.executable, "-m", "pedzoo.cli.main", "fit", "--trainer.enable_progress_bar", "false"]
    command += ["--resume", str(run.path)] if run else [*ROBOTS[name], "--runs", str(runs / name)]
    command += ["--trainer.max_epochs", str(epochs)] if epochs else []
    log = runs / f"{name}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as out:
        code = subprocess.run(
            command, stdout=out, stderr=out, env=os.environ | {"OMP_NUM_THREADS": "1"}
        ).returncode
    if code:
        raise SystemExit(f"{' '.join(command)} failed: see {log}")
    run = run_of(name, runs)
    assert run
    (run.path / "finished").touch()


def run_of(name: str, runs: Path) -> RunFolder | None:
    """Return the run of a robot that has a checkpoint, if there is one."""
    folders = [RunFolder(path) for path in sorted((runs / name).glob("*/*"))]
    return next((one for one in folders if one.last.is_file()), None)


def export(name: str, runs: Path) -> None:
    """Write weights and card of a robot; numbers that the card has stay, if the weights do."""
    run = run_of(name, runs)
    if not run:
        print(f"{name}: not trained")
        return
    checkpoint = torch.load(run.best, weights_only=True)
    settings = _settings(run.path)
    earlier = sorted(run.path.glob("before-resume-*"))
    record = json.loads(((earlier or [run.path])[0] / "versions.json").read_text())
    epochs = [_settings(part)["trainer"]["max_epochs"] for part in (*earlier, run.path)]
    protocol = checkpoint["pedzoo"]["protocol"]
    config = {**checkpoint["pedzoo"], "protocol": protocol}
    state = {
        key.removeprefix(PREFIX): value.contiguous()
        for key, value in checkpoint["state_dict"].items()
        if key.startswith(PREFIX)
    }
    home = shipped("checkpoints") / f"robot_ppo.{name}"
    home.mkdir(exist_ok=True)
    earlier_card = read_card(home / CARD) if (home / CARD).is_file() else None
    write_atomically(home / WEIGHTS, save(state, {"config": json.dumps(config, sort_keys=True)}))
    digest = sha256_of(home / WEIGHTS)
    value = next(iter(checkpoint["callbacks"].values()))["best_model_score"]
    card = ModelCard(
        name=home.name,
        architecture=config["architecture"],
        sha256=digest,
        size=(home / WEIGHTS).stat().st_size,
        config=config,
        training=_training(checkpoint, settings, record["command"], value, epochs),
        data={
            "recordings": [],
            "source": _source(protocol),
            "terms": "simulated: no recordings, but for those that people of the zoo learned from",
            "citation": "",
        },
        evaluations=earlier_card.evaluations if earlier_card and earlier_card.sha256 == digest else [],
        versions=record["versions"],
        licence="MIT",
        file=WEIGHTS,
        url=None,
    )
    write_card(card, home / CARD)
    print(f"{home.name}: {settings['monitor']} {float(value):.3f} after epoch {checkpoint['epoch']}")


def measure(name: str) -> None:
    """Add numbers to a card that has none."""
    path = shipped("checkpoints") / f"robot_ppo.{name}" / CARD
    card = read_card(path)
    if not card.evaluations:
        known = card.config["protocol"]
        report = measure_robot(card.name, known["crowd"], known["robot"])
        write_card(replace(card, evaluations=[report]), path)
        print(f"{card.name}: measured")


def _settings(folder: Path) -> dict[str, Any]:
    return yaml.safe_load((folder / "config.yaml").read_text())


def _training(
    checkpoint: Any, settings: Any, command: list[str], value: Any, epochs: list[int]
) -> dict[str, Any]:
    seed = settings["seed_everything"]
    name = command[command.index("--config") + 1] if "--config" in command else None
    for option in ("--runs", "--trainer.enable_progress_bar"):  # say nothing of the weights
        if option in command:
            at = command.index(option)
            command = command[:at] + command[at + 2 :]
    return {
        **dict.fromkeys(("fold", "clock", "goal")),
        "config": name,
        "seed": seed,
        "seeds": {seed: float(value)},
        "chosen_by": settings["monitor"],
        "value": float(value),
        "step": checkpoint["global_step"],
        "epoch": checkpoint["epoch"],
        "command": command,
        "overrides": {"trainer.max_epochs": ", then ".join(map(str, epochs))},
    }


def _source(protocol: dict[str, Any]) -> str:
    if protocol["scenarios"][0].startswith("crowdnav"):
        return "CrowdNav's circle crossing: people of ORCA who do not see the robot"
    return f"{', '.join(protocol['scenarios'])}: people of {protocol['crowd']}, who see the robot"


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
