"""Folders of runs, as fit leaves them."""

import json
from pathlib import Path
from typing import Any

import torch
import yaml

from helpers.batches import random_weights
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.zoo.loading import config_of

PROTOCOL = {"fold": "zara1", "obs_len": 8, "pred_len": 8, "goal": "window_end", "clock": "benchmark"}


OPTIONS: dict[str, Any] = {"goal_dim": 4, "goal_protocol": "window_end"}


def make_run(runs: Path, seed: int = 0, values: tuple[float, ...] = (0.3, 0.2), **changed: Any) -> Path:
    """Make the folder of a run that validated every third epoch, as fit does; return best.ckpt."""
    run = runs / "sgan_goal" / f"zara1-seed{seed}"
    (run / "checkpoints").mkdir(parents=True)
    model = random_weights(SGAN.of(**OPTIONS), seed=seed)
    content = {
        "pedzoo": config_of(model, protocol=PROTOCOL),
        "state_dict": {f"generator.{key}": value for key, value in model.state_dict().items()},
        "epoch": 3 * len(values) - 1,
        "global_step": 60,
    }
    torch.save(content, run / "checkpoints" / "best.ckpt")
    data: dict[str, Any] = {"fold": "zara1", "files": None, "root": f"/somewhere/{seed}"}
    config = {"seed_everything": seed, "monitor": "val/ade", "monitor_mode": "min", "runs": str(runs)}
    config |= {"model": {"lr": 0.001}, "data": data}
    (run / "config.yaml").write_text(yaml.safe_dump(config | changed))
    command = ["pedzoo", "fit", "--config", "sgan_goal", "--seed_everything", str(seed), "--runs", str(runs)]
    command += ["--data.fold=zara1", "--model.lr=0.001", "--rollout.scenarios", "null"]
    (run / "versions.json").write_text(json.dumps({"command": command, "versions": {"torch": "2.13.0"}}))
    rows = ["epoch,step,train/loss,val/ade"]
    for i, value in enumerate(values):
        rows += [f"{3 * i},{10 * i},0.5,", f"{3 * i + 2},{10 * i + 9},,{value}"]
    (run / "metrics.csv").write_text("\n".join(rows) + "\n")
    return run / "checkpoints" / "best.ckpt"
