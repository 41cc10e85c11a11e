"""Training in the loop: the network walks through scenes, and what comes of it is differentiated.

Full backpropagation through time over the environment, observations included, beside the forecasting loss on
recordings and their imitation step by step.
"""

from __future__ import annotations

from typing import Any, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor, nn
from torch.optim import Optimizer

from pedzoo.errors import UserError
from pedzoo.models.base import Forecaster, agents_of
from pedzoo.models.walker import Walker
from pedzoo.train.imitation import Imitation
from pedzoo.train.loop_losses import LoopLosses
from pedzoo.train.mixture import Course, Mixture
from pedzoo.train.module import ForecastModule
from pedzoo.train.segments import unrolled


class LoopModule(ForecastModule):
    """A segment of an environment and a batch of recordings in every update.

    An update whose gradient is not finite is left out, and counted as ``train/skipped``.
    """

    skipped: Tensor

    def __init__(
        self,
        generator: Forecaster,
        courses: list[Course],
        walking: LoopLosses,
        imitation: Imitation,
        steps: int = 25,
        keep: int = 3,
        forecast_weight: float = 1.0,
        **options: Any,
    ) -> None:
        """Take a generator and where it walks.

        Args:
            generator: The model.
            courses: Scenarios to train in.
            walking: What walking costs.
            imitation: What it costs to walk differently from recorded people.
            steps: Of 0.4 s in a segment.
            keep: Segments after which an episode is given up.
            forecast_weight: Weight of the generator's own loss on recordings, per person.
            options: Of the optimisation and of validation; see `ForecastModule`.

        Raises:
            UserError: A number is out of range.
        """
        super().__init__(generator, **options)
        if min(steps, keep) < 1:
            raise UserError(f"steps {steps}, keep {keep}: expected at least 1")
        self.walking, self.imitation = walking, imitation
        self.steps, self.keep, self.forecast_weight = steps, keep, forecast_weight
        for part in generator.modules():
            if isinstance(part, nn.Dropout):
                part.p = 0.0  # who learns to walk without seeing walls now and then stays away from all doors
        self.walker = Walker(generator)
        self.mixture = Mixture(courses, self.seed)
        self.register_buffer("skipped", torch.zeros((), dtype=torch.long))

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return Adam; `set_lr` sets its learning rate at every iteration."""
        return torch.optim.Adam(self.generator.parameters(), self.lr)

    def training_step(self, batch: dict[str, TensorDict], batch_idx: int) -> Tensor:
        """Return the loss of a segment and of two batches of recordings."""
        data = cast("Any", self.trainer).datamodule
        terms = self._walk()
        self.generator.bind(data.bank)
        if self.forecast_weight:
            people = agents_of(batch["forecast"])["mask"].sum()
            loss = self.generator.loss(batch["forecast"], self.random())
            terms["forecast"] = self.forecast_weight * loss / people
        imitated = self.imitation(self.generator, self.walker.noise_of, batch["unrolled"], self.random())
        terms["imitation"] = imitated.pop("loss")
        self._log(terms | {f"imitation/{name}": value for name, value in imitated.items()})
        return torch.stack(list(terms.values())).sum()

    def _walk(self) -> dict[str, Tensor]:
        """Return the terms of a segment."""
        running = self.mixture.at(int(self.iteration), self.current_epoch)
        seen = running.begin(self.keep)
        self.walker.bind(running.env.bank)
        noise = self.walker.noise_of(seen)
        segment = unrolled(running.env, self.walker, seen, self.steps)
        running.end(segment.done)
        for name in ("touched", "grazed"):
            self._log({name: getattr(segment, name).any(0).any(1).float().mean()})
        return self.walking(segment, running.env.bank, noise)

    def _log(self, values: dict[str, Tensor]) -> None:
        for name, value in values.items():
            self.log(f"train/{name}", value.detach(), on_step=False, on_epoch=True, batch_size=1)

    def on_after_backward(self) -> None:
        """Count the iteration, and leave out what is not finite."""
        self.iteration += 1
        gradients = [p.grad for p in self.generator.parameters() if p.grad is not None]
        if not all(bool(gradient.isfinite().all()) for gradient in gradients):
            self.skipped += 1
            for parameter in self.generator.parameters():
                parameter.grad = None  # which Adam passes over
        self._log({"skipped": self.skipped.float()})

    def on_before_optimizer_step(self, optimizer: Optimizer) -> None:
        """Clip the gradient and set the learning rate."""
        if self.clip:
            torch.nn.utils.clip_grad_norm_(self.generator.parameters(), self.clip)
        self.set_lr(optimizer, self.lr, int(self.iteration) - 1)

    def teardown(self, stage: str) -> None:
        """Close the environments."""
        self.mixture.close()
