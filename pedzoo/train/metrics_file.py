"""``metrics.csv``: the metrics of a whole run in one file, also when it was interrupted."""

import csv
import io
import time
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.loggers import Logger
from lightning.pytorch.utilities import rank_zero_only

from pedzoo.core.paths import write_atomically

SECONDS_BETWEEN = 1.0
"""Seconds between two writes, unless a checkpoint is written."""

KEY = "metrics"
"""Of a checkpoint: ``rows``, how many were logged before it, and ``row``, what its epoch has yet to log."""


class MetricsFile(Logger):
    """Keeps the rows of a run and writes them whole or not at all. Lightning's own logger begins anew.

    Attributes:
        path: The file.
        rows: Metrics by name, with ``epoch`` and ``step``.
    """

    def __init__(self, path: Path) -> None:
        """Log into a file; it is not read."""
        super().__init__()
        self.path = path
        self.rows: list[dict[str, Any]] = []
        self._written, self._when = 0, 0.0

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

    @rank_zero_only
    def save(self) -> None:
        """Write what is new, unless it was written just now."""
        if time.monotonic() > self._when + SECONDS_BETWEEN:
            self.write()

    @rank_zero_only
    def finalize(self, status: str) -> None:
        """Write what is new."""
        self.write()

    def write(self) -> None:
        """Write all rows, if some are new."""
        if self._written == len(self.rows):
            return
        text = io.StringIO(newline="")
        table = csv.DictWriter(text, sorted({key for row in self.rows for key in row}))
        table.writeheader()
        table.writerows(self.rows)
        write_atomically(self.path, text.getvalue().encode())
        self._written, self._when = len(self.rows), time.monotonic()


class WholeMetrics(Callback):
    """Gives a resumed run the rows up to its checkpoint, each of them once."""

    def __init__(self, file: MetricsFile, goes_on: bool) -> None:
        """Take the logger. A run that ``goes_on`` has a file already."""
        self.file = file
        self._earlier = rows_of(file.path) if goes_on else []
        self._saved: dict[str, Any] | None = None
        self._at_end = False

    def on_load_checkpoint(self, trainer: L.Trainer, pl_module: L.LightningModule, checkpoint: Any) -> None:
        """Take what the checkpoint says of the rows."""
        self._saved = checkpoint.get(KEY)

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Begin with the rows that were logged before the checkpoint."""
        if self._saved is None:  # of an earlier version
            self.file.rows = [row for row in self._earlier if int(row["epoch"]) < trainer.current_epoch]
            return
        count, last = self._saved["rows"], self._saved["row"]
        self.file.rows = self._earlier[:count]
        if last:  # it may have been logged, or the run ended just before that
            logged = next((row for row in self._earlier[count:] if int(row["epoch"]) == last["epoch"]), last)
            self.file.rows.append(logged)

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Begin an epoch."""
        self._at_end = False

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """End an epoch, before checkpoints are written and before its means are logged."""
        self._at_end = True

    def on_save_checkpoint(self, trainer: L.Trainer, pl_module: L.LightningModule, checkpoint: Any) -> None:
        """Write the file, and into the checkpoint what the file cannot have yet."""
        rows, epoch = self.file.rows, trainer.current_epoch
        logged = {key for row in rows if int(row["epoch"]) == epoch for key in row}
        row = {
            key: float(value)
            for key, value in trainer.callback_metrics.items()
            if self._at_end and key.startswith("train/") and key not in logged
        }
        if row:
            row |= {"epoch": epoch, "step": trainer.fit_loop.total_batch_idx}
        checkpoint[KEY] = {"rows": len(rows), "row": row}
        if trainer.is_global_zero:
            self.file.write()


def rows_of(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a run's metrics without empty cells; none where there is no file."""
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return [{key: value for key, value in row.items() if value} for row in csv.DictReader(file)]
