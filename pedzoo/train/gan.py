"""Training as in Social GAN (Gupta et al., CVPR 2018); its variety loss is in `models/blocks/variety.py`."""

from typing import Any, cast

import torch
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from tensordict import TensorDict
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from pedzoo.core.batch import agents_of
from pedzoo.core.errors import UserError, at_least_zero
from pedzoo.models.architectures.sgan import SGAN, Encoded
from pedzoo.models.base import true_displacements
from pedzoo.models.blocks.people.crowd import Crowd
from pedzoo.models.blocks.variety import Discriminator
from pedzoo.train.module import ForecastModule


class GANModule(ForecastModule):
    """Variety loss plus a discriminator on trajectories; weight 0 turns it off and skips it."""

    generator: SGAN

    def __init__(
        self,
        generator: SGAN,
        discriminator: Discriminator,
        lr_discriminator: float = 1e-3,
        adversarial_weight: float = 1.0,
        **options: Any,
    ) -> None:
        """Take a generator, a discriminator and their optimisation.

        Args:
            generator: The model.
            discriminator: Judges trajectories.
            lr_discriminator: Learning rate of the discriminator's Adam, constant as published.
            adversarial_weight: Weight of the adversarial loss beside the variety loss.
            options: Of the generator's optimisation and of validation; see `ForecastModule`.
        """
        super().__init__(generator, **options)
        if not hasattr(generator, "variety"):
            raise UserError(f"{type(generator).__name__} has no variety loss: train it with PlainModule")
        at_least_zero("--model.", lr_discriminator=lr_discriminator)
        self.automatic_optimization = False
        self.discriminator = discriminator
        self.lr_discriminator, self.adversarial_weight = lr_discriminator, adversarial_weight

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Return one Adam each; the generator's learning rate is set at every iteration."""
        return [
            torch.optim.Adam(self.generator.parameters(), self.lr),
            torch.optim.Adam(self.discriminator.parameters(), self.lr_discriminator),
        ]

    def steps_per_iteration(self) -> float:
        """Return how many optimizer steps one iteration makes."""
        return 2 if self.adversarial_weight else 1

    def training_step(self, batch: TensorDict, batch_idx: int) -> None:
        """Make one discriminator and one generator step on a batch."""
        g_optimizer, d_optimizer = cast("list[Any]", self.optimizers())
        generator, random, judged, log = self.generator, self.random(), bool(self.adversarial_weight), {}
        # the generator is the same in both steps, and so is all of it that does not depend on the noise
        encoded = generator.encode(batch, agents_of(batch)["future"].shape[2])
        if judged:
            self.toggle_optimizer(d_optimizer)
            log["discriminator"] = loss = self.discriminator_loss(batch, random, encoded)
            d_optimizer.zero_grad()
            self.manual_backward(loss)
            for group in d_optimizer.param_groups:
                group["lr"] = self.lr_discriminator
            d_optimizer.step()
            self.untoggle_optimizer(d_optimizer)
        self.toggle_optimizer(g_optimizer)
        loss, fake = generator.variety(batch, random, encoded, sample=judged)
        log["variety"] = loss / len(batch)
        if fake is not None and judged:
            observed, start = _observed(batch, encoded.crowd)
            score = self.discriminator.of_futures(observed, fake.unsqueeze(0), start, encoded.crowd)
            adversarial = _cross_entropy(score, _soft_one(score, random), _known(batch, encoded.crowd))
            log["adversarial"] = adversarial
            loss = loss + self.adversarial_weight * adversarial
        g_optimizer.zero_grad()
        self.manual_backward(loss)
        if self.clip:
            torch.nn.utils.clip_grad_norm_(generator.parameters(), self.clip)
        self.set_lr(g_optimizer, self.lr)
        g_optimizer.step()
        self.untoggle_optimizer(g_optimizer)
        self.iteration += 1
        self.show("loss", log["variety"])
        self.log_means(log, len(batch), sync_dist=True)

    def discriminator_loss(
        self, batch: TensorDict, random: torch.Generator, encoded: Encoded | None = None
    ) -> Tensor:
        """Return the loss of telling real from generated windows, judged in one batch of twice the scenes.

        ``encoded`` is the result of the generator's ``encode`` for this batch, if computed already.
        """
        agents, generator = agents_of(batch), self.generator
        steps = agents["future"].shape[2]
        with torch.no_grad():
            encoded = encoded or generator.encode(batch, steps)
            made = generator.decode(encoded, generator.draw(encoded, 1, random), steps)[0]
        crowd = encoded.crowd
        futures = torch.stack((crowd.pack(true_displacements(batch)), made))
        observed, start = _observed(batch, crowd)
        both = Crowd.of(torch.cat((agents["mask"], agents["mask"])))
        real, false = self.discriminator.of_futures(observed, futures, start, both).chunk(2)
        known, label = _known(batch, crowd), _soft_one(real, random)
        return _cross_entropy(real, label, known) + _cross_entropy(false, torch.zeros_like(false), known)


def _observed(batch: TensorDict, crowd: Crowd) -> tuple[Tensor, Tensor]:
    """Return observed displacements (P, 7, 2) and where they start (P, 2)."""
    history = crowd.pack(agents_of(batch)["history"])
    return history.diff(dim=1), history[:, 0]


def _known(batch: TensorDict, crowd: Crowd) -> Tensor:
    """Return which people were seen in the whole window (P,): filled-in positions are no person's walk."""
    agents = agents_of(batch)
    return crowd.pack(torch.cat((agents["valid"], agents["future_valid"]), -1).all(-1))


def _cross_entropy(score: Tensor, label: Tensor, known: Tensor) -> Tensor:
    """Return the mean cross entropy over the ``known`` people (P,)."""
    wrong = binary_cross_entropy_with_logits(score, label, reduction="none")
    return (wrong * known).sum() / known.sum().clamp(min=1)


def _soft_one(score: Tensor, random: torch.Generator) -> Tensor:
    """Return the smoothed label of real people: one number from U(0.7, 1.2) for the whole batch."""
    return torch.full_like(score, 0.7 + 0.5 * float(torch.rand((), generator=random)))
