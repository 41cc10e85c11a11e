"""A training run's folder: its settings, versions, metrics and checkpoints, and its job of Slurm."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import subprocess
from collections.abc import Collection
from datetime import datetime
from difflib import get_close_matches
from itertools import count
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

from pedzoo.core.errors import UserError, need, unknown
from pedzoo.core.machine import versions
from pedzoo.core.paths import PARTS, shipped, write_atomically
from pedzoo.models.zoo.publish import RECORDS

Wandb = Literal["off", "offline", "online"]

LOCK, HOLDER = ".lock", ".in-use"
"""Files of a run folder: the process that trains there has locked the first one, and is named in the second.
Asking for a lock empties its own file."""


def run_name(config: Path) -> str:
    """Return the name of a config file's runs: shipped ones in folders are ``FOLDER.NAME``."""
    home = shipped("configs").resolve()
    inside = config.resolve().is_relative_to(home)
    name = config.resolve().relative_to(home) if inside else Path(config.name)
    return ".".join(name.with_suffix("").parts)


class RunFolder:
    """``runs/<config>/<data>-seed<seed>``, with ``-2``, ``-3``, ... where that exists.

    It has checkpoints of the ``last`` epoch and of the ``best`` validation, and the logger ``metrics``.
    """

    def __init__(self, path: Path, goes_on: bool = False) -> None:
        """Stand for a folder, existing or not; an earlier run in it ``goes_on`` or not."""
        self.path, self.goes_on = path, goes_on
        self.last = path / "checkpoints" / "last.ckpt"
        self.best = path / "checkpoints" / "best.ckpt"
        self.metrics = MetricsFile(path / "metrics.csv")
        self._lock = FileLock(path / LOCK)

    @classmethod
    def claim(cls, base: Path) -> RunFolder:
        """Create ``base``, or the first free of ``base-2``, ``base-3``, ... and return it.

        A Slurm job that is run again gets the folder in which it was, to go on there.
        """
        if rank_zero_only.rank:
            # a further process of a distributed run: the first one chooses, and it alone writes
            path = Path(os.environ.get("PEDZOO_RUN", base))
            return cls(path, _left_by_this_job(path))
        for number in count(1):
            path = base.with_name(f"{base.name}-{number}") if number > 1 else base
            try:
                path.mkdir(parents=True)
                break
            except OSError as error:
                if not isinstance(error, FileExistsError) or not path.parent.is_dir():
                    why = f"cannot make the run folder {str(path)!r} ({error.strerror})"
                    raise UserError(f"{why}: name another place as --runs") from error
                if _left_by_this_job(path):
                    break
        os.environ["PEDZOO_RUN"] = str(path)
        return cls(path, _left_by_this_job(path))

    @classmethod
    def resume(cls, path: str | Path) -> RunFolder:
        """Return an earlier run's folder. Raises UserError: it has no configuration or no checkpoint."""
        run = cls(Path(path), goes_on=True)
        for file in (run.path / "config.yaml", run.last):
            if not file.is_file():
                raise UserError(f"cannot resume {str(path)!r}: it has no {file.relative_to(run.path)}")
        return run

    @rank_zero_only
    def begin(self) -> None:
        """Lock the folder until `end`, and copy earlier records aside. Raises UserError: it is in use."""
        named = self.path / HOLDER
        try:
            self._lock.acquire(blocking=False)
        except Timeout as error:
            holder = named.read_text() if named.is_file() else "another process"
            raise UserError(
                f"run {str(self.path)!r} is in use by {holder}: wait until it ends, or end it, then resume"
            ) from error
        holder = f"process {os.getpid()} on {gethostname()} since {datetime.now():%F %T}"
        write_atomically(named, holder.encode())
        if self.goes_on:
            for part in self.path.rglob(PARTS):
                part.unlink()
            stored = self.path / f"before-resume-{len(list(self.path.glob('before-resume-*'))) + 1}"
            stored.mkdir()
            for name in RECORDS:
                if (self.path / name).is_file():
                    shutil.copy2(self.path / name, stored)

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
        (self.path / HOLDER).unlink(missing_ok=True)
        if not any(file.is_file() and file.name != LOCK for file in self.path.rglob("*")):
            shutil.rmtree(self.path, ignore_errors=True)
            for parent in list(self.path.parents)[:2]:
                if parent.is_dir() and not any(parent.iterdir()):
                    parent.rmdir()
        self._lock.release()

    def trainer_options(self, plugins: Any) -> dict[str, Any]:
        """Return the trainer's options that keep all of a run in its folder, whole, beside ``plugins``.

        Lightning looks there for checkpoints that Slurm asked for, and not in the working directory.
        """
        own = plugins if isinstance(plugins, list) else [plugins] if plugins else []
        saves = any(isinstance(plugin, CheckpointIO) for plugin in own)
        return {"default_root_dir": str(self.path), "plugins": own if saves else [*own, WholeCheckpoints()]}

    def loggers(self, wandb: Wandb) -> list[Logger]:
        """Return the logger of ``metrics.csv``, and that of Weights & Biases where it is wanted."""
        result: list[Logger] = [self.metrics]
        if wandb != "off":
            need("wandb", "--wandb")
            name = f"{self.path.parent.name}/{self.path.name}"
            # its process may have been started in another folder
            home = self.path.absolute()
            result.append(WandbLogger(project="pedzoo", name=name, save_dir=home, offline=wandb == "offline"))
        return result

    def callbacks(
        self, config: dict[str, Any], argv: list[str], monitor: str | None, mode: str
    ) -> list[Callback]:
        """Return the callbacks that write the records and, unless ``monitor`` is None, checkpoints."""
        recorder = RunRecorder(self, config, argv, monitor)
        if monitor is None:
            return [recorder]
        common: dict[str, Any] = {"dirpath": self.last.parent, "enable_version_counter": False}
        best = ModelCheckpoint(filename=self.best.stem, monitor=monitor, mode=mode, **common)
        # Lightning's own last one is written with the best one; this one after every epoch, validated or not
        last = ModelCheckpoint(filename=self.last.stem, save_on_train_epoch_end=True, **common)
        return [recorder, best, last]


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


class MetricsFile(Logger):
    """Writes ``metrics.csv`` whole or not at all. Lightning's own logger removes the file of an earlier run.

    Its ``rows`` are metrics by name, with ``epoch`` and ``step``.
    """

    def __init__(self, path: Path) -> None:
        """Log into a file; it is not read."""
        super().__init__()
        self.path = path
        self.rows: list[dict[str, Any]] = []

    @property
    def name(self) -> str:
        """The run's folder."""
        return self.path.parent.name

    @property
    def version(self) -> str:
        """Nothing: a folder has one run."""
        return ""

    @property
    def save_dir(self) -> str:
        """Where callbacks put their files."""
        return str(self.path.parent)

    def log_hyperparams(self, *args: Any, **settings: Any) -> None:
        """Do nothing: they are in ``config.yaml``."""

    @rank_zero_only
    def log_metrics(self, metrics: dict[str, float], step: int | None = None) -> None:
        """Add a row."""
        self.rows.append({**metrics, "step": step})
        text = io.StringIO(newline="")
        table = csv.DictWriter(text, sorted({key for row in self.rows for key in row}))
        table.writeheader()
        table.writerows(self.rows)
        write_atomically(self.path, text.getvalue().encode())


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a run's metrics without empty cells; none where there is no file."""
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return [{key: value for key, value in row.items() if value} for row in csv.DictReader(file)]


class RunRecorder(Callback):
    """Writes configuration and versions after the first step, and looks after metrics and validations.

    What fails before the first step leaves nothing in a new run, and in a resumed one the options that it
    had. A resumed run keeps the rows of the epochs before its checkpoint. The last of ``max_epochs`` is
    validated, whatever ``check_val_every_n_epoch`` says. A metric to monitor that is not logged is refused:
    before the first step where it is a misspelling of one that is. Not all are known by then.
    """

    def __init__(self, run: RunFolder, config: dict[str, Any], argv: list[str], monitor: str | None) -> None:
        """Record a run of the resolved ``config``, started by the command line ``argv``."""
        self.run, self.config, self.argv, self.monitor = run, config, argv, monitor
        self._earlier = rows_of(run.metrics.path) if run.goes_on else []
        self._written = self._validated = False

    def on_fit_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Say where the run goes: data and model are known to fit together by now."""
        if trainer.is_global_zero:
            print(f"run folder: {self.run.path}", flush=True)

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Take over the rows of a resumed run, which has no sanity check, and look for a misspelling."""
        self.run.metrics.rows = [row for row in self._earlier if int(row["epoch"]) < trainer.current_epoch]
        self._check_monitor({key for row in self._earlier for key in row}, may_come=True)

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Let Lightning validate the last epoch, where it is known beforehand which one that is."""
        last = trainer.current_epoch + 1 == trainer.max_epochs
        if self.monitor and last and trainer.check_val_every_n_epoch is not None:
            trainer.check_val_every_n_epoch = 1

    def on_train_batch_end(self, trainer: L.Trainer, pl_module: L.LightningModule, *_: Any) -> None:
        """Write ``config.yaml`` and ``versions.json``, once."""
        if trainer.is_global_zero and not self._written:
            settings = yaml.safe_dump(self.config, sort_keys=False)
            record = {"command": self.argv, "versions": versions(), **_job_record()}
            write_atomically(self.run.path / "config.yaml", settings.encode())
            write_atomically(self.run.path / "versions.json", f"{json.dumps(record, indent=2)}\n".encode())
            self._written = True

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Look for a misspelling; after a training, for the metric itself."""
        self._validated |= not trainer.sanity_checking
        if trainer.sanity_checking or (self.monitor or "").startswith(("val/", "rollout/")):
            self._check_monitor(trainer.callback_metrics, may_come=trainer.sanity_checking)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Look for a metric of the training, which is there behind the validation of an epoch."""
        if self._validated:
            self._check_monitor(trainer.callback_metrics)

    def _check_monitor(self, known: Collection[str], may_come: bool = False) -> None:
        """Refuse a metric that is not among those known; if others may come, a misspelling alone."""
        if self.monitor is None or self.monitor in known:
            return
        # those of rollouts are checked with their scenarios
        new = self.monitor.startswith("rollout/") or not get_close_matches(self.monitor, known, 1, 0.8)
        if not (may_come and new):
            raise unknown("metric to --monitor", self.monitor, known)


def run_again() -> str:
    """Ask Slurm to run the job again, and return in words what came of it."""
    job = str(_job())
    try:
        asked = subprocess.run(
            ["scontrol", "requeue", job], capture_output=True, text=True, timeout=60, check=False
        )
        why = asked.stderr.strip() if asked.returncode else ""
    except (OSError, subprocess.TimeoutExpired) as error:
        why = str(error)
    return f"Slurm does not run job {job} again ({why})" if why else f"Slurm runs job {job} again"


def _job() -> str | None:
    """Return the number of the Slurm job of this process, which it keeps when it is run again."""
    array = os.environ.get("SLURM_ARRAY_JOB_ID")
    return f"{array}_{os.environ.get('SLURM_ARRAY_TASK_ID')}" if array else os.environ.get("SLURM_JOB_ID")


def _job_record() -> dict[str, dict[str, str | int]]:
    """Return what ``versions.json`` says of the job that this process is in; nothing outside of Slurm."""
    restarts = int(os.environ.get("SLURM_RESTART_COUNT") or 0)
    return {"slurm": {"job": job, "restarts": restarts}} if (job := _job()) else {}


def _left_by_this_job(run: Path) -> bool:
    """Return whether the run in a folder was begun by this process' job before it was run again."""
    file, here = run / "versions.json", _job_record().get("slurm")
    if here is None or not file.is_file():
        return False
    try:
        record = json.loads(file.read_text())["slurm"]
        return record["job"] == here["job"] and record["restarts"] < here["restarts"]
    except (ValueError, LookupError, TypeError):
        return False
