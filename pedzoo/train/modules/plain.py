"""Training by the model's own loss alone: squared errors, variety losses, evidence bounds."""

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor
from torch.optim import Optimizer

from pedzoo.train.modules.module import ForecastModule


class PlainModule(ForecastModule):
    """Minimises ``generator.loss(batch)``."""

    by_loss = True

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; `set_lr` sets its learning rate at every iteration."""
        return torch.optim.Adam(self.generator.parameters(), self.lr)

    def training_step(self, batch: TensorDict, batch_idx: int) -> Tensor:
        """Return the loss of a batch, summed over its scenes."""
        loss = self.generator.loss(batch, self.random())
        per_scene = loss.detach() / len(batch)
        self.log("train/loss", per_scene, on_step=False, on_epoch=True, batch_size=len(batch), sync_dist=True)
        self.show("loss", per_scene)
        return loss

    def on_after_backward(self) -> None:
        """Count the iteration: not at its very end, where checkpoints may have been written already."""
        self.iteration += 1

    def on_before_optimizer_step(self, optimizer: Optimizer) -> None:
        """Clip the gradient and set the learning rate."""
        if self.clip:
            torch.nn.utils.clip_grad_norm_(self.generator.parameters(), self.clip)
        self.set_lr(optimizer, self.lr, int(self.iteration) - 1)
