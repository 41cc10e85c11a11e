"""A training run's folder: its settings, versions, metrics and checkpoints."""

from __future__ import annotations

import io
import json
import os
import shutil
from datetime import datetime
from pathlib import Path
from socket import gethostname
from typing import Any, Literal

import lightning as L
import torch
import yaml
from filelock import FileLock, Timeout
from lightning.fabric.plugins import CheckpointIO, TorchCheckpointIO
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import Logger, WandbLogger
from lightning.pytorch.utilities import rank_zero_only

from pedzoo.core.errors import UserError, need
from pedzoo.core.machine import versions
from pedzoo.core.paths import PARTS, shipped, write_atomically
from pedzoo.models.zoo.publish import RECORDS
from pedzoo.train.metrics_file import MetricsFile, WholeMetrics, rows_of
from pedzoo.train.monitor import KnownMonitor
from pedzoo.train.slurm import job_record, left_by_this_job

Wandb = Literal["off", "offline", "online"]

LOCK = ".lock"
"""File of a run folder that the process which trains there has locked."""


def run_name(config: Path) -> str:
    """Return the name of a config file's runs: shipped ones in folders are ``FOLDER.NAME``."""
    home = shipped("configs").resolve()
    inside = config.resolve().is_relative_to(home)
    name = config.resolve().relative_to(home) if inside else Path(config.name)
    return ".".join(name.with_suffix("").parts)


class RunFolder:
    """``runs/<config>/<data>-seed<seed>``, with ``-2``, ``-3``, ... where that exists.

    Attributes:
        path: The folder.
        last: Checkpoint of the last epoch.
        best: Checkpoint of the best validation.
        goes_on: Whether an earlier run is continued.
    """

    def __init__(self, path: Path, goes_on: bool = False) -> None:
        """Stand for a folder, existing or not."""
        self.path, self.goes_on = path, goes_on
        self.last = path / "checkpoints" / "last.ckpt"
        self.best = path / "checkpoints" / "best.ckpt"
        self._lock, self._metrics = FileLock(path / LOCK), MetricsFile(path / "metrics.csv")

    @classmethod
    def claim(cls, base: Path) -> RunFolder:
        """Create ``base``, or the first free of ``base-2``, ``base-3``, ... and return it.

        A Slurm job that is run again gets the folder in which it was, to go on there.
        """
        number, path = 1, base
        if rank_zero_only.rank:
            # a further process of a distributed run: the first one chooses, and it alone writes
            path = Path(os.environ.get("PEDZOO_RUN", base))
            return cls(path, goes_on=left_by_this_job(path))
        while True:
            try:
                path.mkdir(parents=True)
                break
            except OSError as error:
                if not isinstance(error, FileExistsError) or not path.parent.is_dir():
                    why = f"cannot make the run folder {str(path)!r} ({error.strerror})"
                    raise UserError(f"{why}: name another place as --runs") from error
                if left_by_this_job(path):
                    os.environ["PEDZOO_RUN"] = str(path)
                    return cls(path, goes_on=True)
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
        run = cls(Path(path), goes_on=True)
        for file in (run.path / "config.yaml", run.last):
            if not file.is_file():
                raise UserError(f"cannot resume {str(path)!r}: it has no {file.relative_to(run.path)}")
        return run

    @rank_zero_only
    def begin(self) -> None:
        """Lock the folder until `end` or the end of this process, and copy earlier records aside.

        Raises:
            UserError: Another process is training in this folder.
        """
        try:
            self._lock.acquire(blocking=False)
        except Timeout as error:
            holder = self._holder.read_text() if self._holder.is_file() else "another process"
            raise UserError(
                f"run {str(self.path)!r} is in use by {holder}: wait until it ends, or end it, then resume"
            ) from error
        holder = f"process {os.getpid()} on {gethostname()} since {datetime.now():%F %T}"
        write_atomically(self._holder, holder.encode())
        if self.goes_on:
            for part in self.path.rglob(PARTS):
                part.unlink()
            self._keep_earlier()

    @rank_zero_only
    def forget(self) -> None:
        """Remove the records of a run that began and has no checkpoint: `end` finds an empty folder then."""
        if not self.goes_on and not any(self.path.rglob("*.ckpt")):
            for name in RECORDS:
                (self.path / name).unlink(missing_ok=True)

    @rank_zero_only
    def end(self) -> None:
        """Unlock the folder. That of a run that failed before it wrote anything is removed."""
        if not self._lock.is_locked:
            return
        self._holder.unlink(missing_ok=True)
        files = [file for file in self.path.rglob("*") if file.is_file() and file.name != LOCK]
        if not files:
            shutil.rmtree(self.path, ignore_errors=True)
            for parent in list(self.path.parents)[:2]:
                if parent.is_dir() and not any(parent.iterdir()):
                    parent.rmdir()
        self._lock.release()

    @property
    def _holder(self) -> Path:
        """A file beside the lock that names its holder: asking for the lock empties the lock's own file."""
        return self.path / ".in-use"

    def _keep_earlier(self) -> None:
        """Copy the records of the runs so far aside: a resumed run writes its own in their place."""
        stored = self.path / f"before-resume-{len(list(self.path.glob('before-resume-*'))) + 1}"
        stored.mkdir()
        for name in RECORDS:
            if (self.path / name).is_file():
                shutil.copy2(self.path / name, stored)

    def trainer_options(self, plugins: Any) -> dict[str, Any]:
        """Return the trainer's options that keep all of a run in its folder, whole, beside ``plugins``.

        Lightning looks there for checkpoints that Slurm asked for, and not in the working directory.
        """
        own = plugins if isinstance(plugins, list) else [plugins] if plugins else []
        saves = any(isinstance(plugin, CheckpointIO) for plugin in own)
        return {"default_root_dir": str(self.path), "plugins": own if saves else [*own, WholeCheckpoints()]}

    def loggers(self, wandb: Wandb) -> list[Logger]:
        """Return the logger of ``metrics.csv``, and that of Weights & Biases where it is wanted."""
        name, version = self.path.parent.name, self.path.name
        result: list[Logger] = [self._metrics]
        if wandb != "off":
            need("wandb", "--wandb")
            result.append(
                WandbLogger(
                    project="pedzoo",
                    name=f"{name}/{version}",
                    # its process may have been started in another folder
                    save_dir=self.path.absolute(),
                    offline=wandb == "offline",
                )
            )
        return result

    def callbacks(
        self, config: dict[str, Any], argv: list[str], monitor: str | None, mode: str
    ) -> list[Callback]:
        """Return the callbacks that write the records and, unless ``monitor`` is None, checkpoints."""
        result: list[Callback] = [RunRecorder(self, config, argv), WholeMetrics(self._metrics, self.goes_on)]
        if monitor is None:
            return result
        common: dict[str, Any] = {"dirpath": self.last.parent, "enable_version_counter": False}
        best = ModelCheckpoint(filename=self.best.stem, monitor=monitor, mode=mode, **common)
        # Apart from the best one, so that it is written after every epoch, validated or not.
        last = ModelCheckpoint(filename=self.last.stem, save_on_train_epoch_end=True, **common)
        earlier = rows_of(self._metrics.path) if self.goes_on else []
        known = KnownMonitor(monitor, {key for row in earlier for key in row})
        return [*result, ValidatesLast(), known, best, last]


def finish_wandb(succeeded: bool) -> None:
    """Flush the values of Weights & Biases; the next run of this process begins another one."""
    import wandb

    if wandb.run is not None:
        wandb.finish(exit_code=int(not succeeded))


class WholeCheckpoints(TorchCheckpointIO):
    """Writes checkpoints whole or not at all. Lightning's own way goes through TMPDIR, often another disk."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint."""
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        write_atomically(Path(path), buffer.getbuffer())


class ValidatesLast(Callback):
    """Validates the last of ``max_epochs``, too, whatever ``check_val_every_n_epoch`` says.

    A training that ends by steps, time or early stopping has no last epoch that is known beforehand.
    """

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Let Lightning validate this epoch, if it is the last one."""
        last = trainer.current_epoch + 1 == trainer.max_epochs
        if last and trainer.check_val_every_n_epoch is not None:
            trainer.check_val_every_n_epoch = 1


class RunRecorder(Callback):
    """Writes configuration and versions after the first step.

    What fails before leaves nothing in a new run, and in a resumed one the options that it had.
    """

    def __init__(self, run: RunFolder, config: dict[str, Any], argv: list[str]) -> None:
        """Record a run of the resolved ``config``, started by the command line ``argv``."""
        self.run, self.config, self.argv = run, config, argv
        self._written = False

    def on_fit_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Say where the run goes: data and model are known to fit together by now."""
        if trainer.is_global_zero:
            print(f"run folder: {self.run.path}", flush=True)

    def on_train_batch_end(self, trainer: L.Trainer, pl_module: L.LightningModule, *_: Any) -> None:
        """Write ``config.yaml`` and ``versions.json``, once."""
        if trainer.is_global_zero and not self._written:
            settings = yaml.safe_dump(self.config, sort_keys=False)
            record = {"command": self.argv, "versions": versions(), **job_record()}
            write_atomically(self.run.path / "config.yaml", settings.encode())
            write_atomically(self.run.path / "versions.json", f"{json.dumps(record, indent=2)}\n".encode())
            self._written = True
