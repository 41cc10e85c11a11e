"""Small trainings in the loop."""

from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import Callback

from helpers.training import quiet_trainer
from pedzoo.data.datamodule import ImitationWindows, Loading, TrajectoryDataModule
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.train.closed_loop.imitation import Imitation
from pedzoo.train.closed_loop.in_the_loop import LoopModule
from pedzoo.train.closed_loop.loop_losses import LoopLosses
from pedzoo.train.closed_loop.segments import Course

MEETING = "hallway:people=2,jitter=0"


def small() -> SGAN:
    """Return an untrained controller, which walks straight to its goal."""
    torch.manual_seed(0)
    return SGAN.of(
        embedding_dim=8, encoder_dim=16, decoder_dim=16, mlp_dim=16, noise_dim=4, noise="agent", goal_dim=8,
        goal_protocol="window_end", frame="way", residual="bent_line", approach_dim=8, trait_dim=8, best_k=2,
    )  # fmt: skip


def module(model: SGAN | None = None, walking: LoopLosses | None = None, **options: Any) -> LoopModule:
    """Return a training of two people who walk towards each other."""
    defaults: dict[str, Any] = {"imitation": Imitation(displacement=0.1, distribution=0.0), "steps": 10}
    defaults |= {"forecast_weight": 0.1, "lr": 3e-3, "warmup": 1, "samples": 2, "max_segments": 1}
    torch.manual_seed(0)  # the run's seed
    courses = [Course(MEETING, scenes=6)]
    return LoopModule(model or small(), courses, walking or LoopLosses(), **defaults | options)


def train(trained: LoopModule, updates: int, *callbacks: Callback, scenes: int = 4) -> L.Trainer:
    """Train for some updates of one epoch, without validation."""
    trainer = quiet_trainer(*callbacks, max_epochs=1, limit_train_batches=updates, limit_val_batches=0)
    windows = ImitationWindows(steps=scenes, batch_size=scenes)
    trainer.fit(trained, TrajectoryDataModule(goal="window_end", loading=Loading(scenes), imitated=windows))
    return trainer
