"""A training run's folder: its settings, versions, metrics and checkpoints."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any, Literal

import lightning as L
import yaml
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, Logger, WandbLogger
from lightning.pytorch.utilities import rank_zero_only

from pedzoo.core.errors import UserError
from pedzoo.core.machine import versions
from pedzoo.core.paths import shipped

Wandb = Literal["off", "offline", "online"]


def run_name(config: Path) -> str:
    """Return the name of a config file's runs: shipped ones in folders are ``FOLDER.NAME``."""
    home = shipped("configs").resolve()
    inside = config.resolve().is_relative_to(home)
    name = config.resolve().relative_to(home) if inside else Path(config.name)
    return ".".join(name.with_suffix("").parts)


class RunFolder:
    """``runs/<config>/<data>-seed<seed>``, with ``-2``, ``-3``, ... where that exists."""

    def __init__(self, path: Path) -> None:
        """Stand for a folder, existing or not."""
        self.path = path
        self.last = path / "checkpoints" / "last.ckpt"
        self.best = path / "checkpoints" / "best.ckpt"

    @classmethod
    def claim(cls, base: Path) -> RunFolder:
        """Create ``base``, or the first free of ``base-2``, ``base-3``, ... and return it."""
        if rank_zero_only.rank:
            # a further process of a distributed run: the first one chooses, and it alone writes
            return cls(Path(os.environ.get("PEDZOO_RUN", base)))
        number, path = 1, base
        while True:
            try:
                path.mkdir(parents=True)
                break
            except FileExistsError:
                number += 1
                path = base.with_name(f"{base.name}-{number}")
        os.environ["PEDZOO_RUN"] = str(path)
        return cls(path)

    @classmethod
    def resume(cls, path: str | Path) -> RunFolder:
        """Return the folder of an earlier run that can be continued.

        Raises:
            UserError: It has no configuration or no checkpoint.
        """
        run = cls(Path(path))
        for file in (run.path / "config.yaml", run.last):
            if not file.is_file():
                raise UserError(f"cannot resume {str(path)!r}: it has no {file.relative_to(run.path)}")
        return run

    @rank_zero_only
    def keep_earlier(self) -> None:
        """Copy the records of the runs so far aside: a resumed run writes its own in their place."""
        records = [self.path / name for name in ("config.yaml", "versions.json", "metrics.csv")]
        stored = self.path / f"before-resume-{len(list(self.path.glob('before-resume-*'))) + 1}"
        stored.mkdir()
        for record in records:
            if record.is_file():
                shutil.copy2(record, stored)

    @rank_zero_only
    def discard_if_empty(self) -> None:
        """Remove the folder of a run that failed before it wrote anything, and its empty parents."""
        if not any(file.is_file() for file in self.path.rglob("*")):
            shutil.rmtree(self.path, ignore_errors=True)
            for parent in list(self.path.parents)[:2]:
                if parent.is_dir() and not any(parent.iterdir()):
                    parent.rmdir()

    def loggers(self, wandb: Wandb) -> list[Logger]:
        """Return the CSV logger, and Weights & Biases' where it is wanted."""
        root, name, version = self.path.parent.parent, self.path.parent.name, self.path.name
        result: list[Logger] = [CSVLogger(root, name, version)]
        if wandb != "off":
            result.append(
                WandbLogger(
                    project="pedzoo", name=f"{name}/{version}", save_dir=self.path, offline=wandb == "offline"
                )
            )
        return result

    def callbacks(
        self, config: dict[str, Any], argv: list[str], monitor: str | None, mode: str
    ) -> list[Callback]:
        """Return the callbacks that write the records and, unless ``monitor`` is None, checkpoints."""
        result: list[Callback] = [Record(self, config, argv)]
        if monitor is None:
            return result
        common: dict[str, Any] = {"dirpath": self.last.parent, "enable_version_counter": False}
        best = ModelCheckpoint(filename=self.best.stem, monitor=monitor, mode=mode, **common)
        # Apart from the best one, so that it is written after every epoch, validated or not.
        last = ModelCheckpoint(filename=self.last.stem, save_on_train_epoch_end=True, **common)
        return [*result, best, last]


def finish_wandb(succeeded: bool) -> None:
    """Flush the values of Weights & Biases; the next run of this process begins another one."""
    import wandb

    if wandb.run is not None:
        wandb.finish(exit_code=int(not succeeded))


class Record(Callback):
    """Writes configuration and versions."""

    def __init__(self, run: RunFolder, config: dict[str, Any], argv: list[str]) -> None:
        """Record a run of the resolved ``config``, started by the command line ``argv``."""
        self.run, self.config, self.argv = run, config, argv

    def on_fit_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write ``config.yaml`` and ``versions.json``: data and model are known to fit together by now."""
        if trainer.is_global_zero:
            print(f"run folder: {self.run.path}", flush=True)
            (self.run.path / "config.yaml").write_text(yaml.safe_dump(self.config, sort_keys=False))
            record = {"command": self.argv, "versions": versions()}
            (self.run.path / "versions.json").write_text(json.dumps(record, indent=2) + "\n")
