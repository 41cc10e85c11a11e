"""A callback for trainings in several processes: each writes down its weights at the end."""

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback


class Witness(Callback):
    """Writes ``weights-RANK.pt`` into the working directory."""

    def on_fit_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        torch.save(pl_module.state_dict(), f"weights-{trainer.global_rank}.pt")
