"""Checks that the metric which chooses the best checkpoint is logged, as early as that can be known."""

from collections.abc import Iterable
from difflib import get_close_matches

import lightning as L
from lightning.pytorch.callbacks import Callback

from pedzoo.core.errors import unknown


class KnownMonitor(Callback):
    """Refuses a metric that is not logged: before the first step where it is a misspelling of one that is.

    Not all metrics are known by then: the first validation after a training logs more than the sanity check.
    """

    def __init__(self, monitor: str, earlier: Iterable[str] = ()) -> None:
        """Check ``monitor``; a resumed run has no sanity check, and logged the ``earlier`` metrics."""
        self.monitor, self.earlier = monitor, set(earlier)
        self._validated = False

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Look for a misspelling among the metrics of a resumed run."""
        self._refuse_misspelling(self.earlier)

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Look for a misspelling; after a training, for the metric itself."""
        known = set(trainer.callback_metrics)
        if trainer.sanity_checking:
            self._refuse_misspelling(known)
            return
        self._validated = True
        if self.monitor.startswith(("val/", "rollout/")):
            self._refuse_unknown(known)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Look for a metric of the training, which is there behind the validation of an epoch."""
        if self._validated:
            self._refuse_unknown(set(trainer.callback_metrics))

    def _refuse_misspelling(self, known: set[str]) -> None:
        rollouts = self.monitor.startswith("rollout/")  # checked with their scenarios, which may be new ones
        if not rollouts and get_close_matches(self.monitor, known, n=1, cutoff=0.8):
            self._refuse_unknown(known)

    def _refuse_unknown(self, known: set[str]) -> None:
        if self.monitor not in known:
            raise unknown("metric to --monitor", self.monitor, known)
