"""Trainers that print nothing, and what two trainings ended with."""

import os
from pathlib import Path
from typing import Any

import lightning as L
import pytest
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from torch.utils._pytree import tree_flatten

from pedzoo.cli.main import main

SHORT = [f"--trainer.{key}=1" for key in ("max_epochs", "limit_val_batches", "check_val_every_n_epoch")]
SHORT += ["--trainer.limit_train_batches=2", "--trainer.enable_progress_bar=false"]
"""Options of one epoch of two updates, with a validation."""

LIGHTNING_MARKS = [
    pytest.mark.filterwarnings(f"ignore:.*{said}")
    for said in (
        "does not have many workers",
        "callbacks used to create the checkpoint",
        "Checkpoint directory .* exists and is not empty",
        "no pre-optimization state was saved",
        "is smaller than the logging interval",
    )
]
"""Warnings of Lightning's that say nothing about such short trainings."""

FIT = ["fit", "--config", "sgan_nopool", "--data.fold=embedded", "--data.loading.batch_size=8", *SHORT]
FIT += ["--model.samples=2"]
"""A training of a second, and ..."""

RUN = Path("runs/sgan_nopool/embedded-seed0")
"""... its folder."""

LAST = RUN / "checkpoints" / "last.ckpt"

ROOT = Path(__file__).parents[2]


def environment(**variables: str) -> dict[str, str]:
    """Return the environment of a command line of its own, with the tests' modules."""
    inherited = {key: value for key, value in os.environ.items() if key not in ("LOCAL_RANK", "PEDZOO_RUN")}
    return inherited | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])} | variables


def quiet_trainer(*callbacks: Callback, **options: Any) -> L.Trainer:
    """Return a trainer on the CPU that logs nowhere, and saves if a callback does."""
    quiet = {"enable_progress_bar": False, "enable_model_summary": False, "logger": False}
    quiet["enable_checkpointing"] = any(isinstance(one, ModelCheckpoint) for one in callbacks)
    own: dict[str, Any] = {"accelerator": "cpu", "log_every_n_steps": 1} | quiet | options
    return L.Trainer(callbacks=list(callbacks), **own)


def fitted(*words: str) -> Path:
    """Train by the command line and return the new run folder."""
    before = set(Path().glob("runs/*/*"))
    assert main(["fit", *words]) == 0
    (run,) = set(Path().glob("runs/*/*")) - before
    return run


def last(run: Path) -> Path:
    """Return the last checkpoint of a run."""
    return run / "checkpoints" / "last.ckpt"


def assert_same_end(first: Path, second: Path) -> dict[str, Any]:
    """Check that two checkpoints have bit-equal weights and optimizer states; return the first one."""
    one, two = (torch.load(path, weights_only=True) for path in (first, second))
    for key in ("state_dict", "optimizer_states"):
        (ours, shape), (theirs, other) = tree_flatten(one[key]), tree_flatten(two[key])
        assert shape == other and sum(torch.is_tensor(value) for value in ours) > 10
        assert all(
            torch.equal(a, b) if torch.is_tensor(a) else a == b for a, b in zip(ours, theirs, strict=True)
        )
    assert one["global_step"] == two["global_step"] and one["epoch"] == two["epoch"]
    return one
