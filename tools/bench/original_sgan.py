"""The original Social GAN, imported from a checkout and made to run on today's torch without a GPU.

Nothing of it is copied or changed: what no longer works is replaced at run time.
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor, nn

from pedzoo.core.errors import UserError

Batch = tuple[Tensor, ...]


class Original:
    """The original's data, networks and steps.

    Attributes:
        args: The options that its scripts would have parsed.
    """

    def __init__(self) -> None:
        """Import the package ``sgan`` and its two scripts; `original` makes them known."""
        self.models, self.losses = import_module("sgan.models"), import_module("sgan.losses")
        self.data = import_module("sgan.data.trajectories")
        self.train, self.test = import_module("train"), import_module("evaluate_model")
        self.args = Namespace(
            obs_len=8,
            pred_len=8,
            best_k=20,
            l2_loss_weight=1.0,
            clipping_threshold_g=2.0,
            clipping_threshold_d=0.0,
        )

    def dataset(self, folder: Path) -> Any:
        """Return its dataset of the files in ``folder``, in the order of their names."""
        with _sorted_folders():
            return self.data.TrajectoryDataset(str(folder), obs_len=8, pred_len=8)

    def batch(self, dataset: Any, scenes: Tensor) -> Batch:
        """Return its batch of these scenes (B,)."""
        # its encoder takes views of what older versions of torch had laid out contiguously
        return tuple(
            part.contiguous() for part in self.data.seq_collate([dataset[i] for i in scenes.tolist()])
        )

    def scenes(self, count: int, people: int) -> Batch:
        """Return a batch of ``count`` random scenes of ``people`` in its form."""
        rows = count * people
        obs = torch.randn(8, rows, 2).mul(0.4).cumsum(0) + torch.randn(rows, 2) * 5
        rel = torch.cat((torch.zeros(1, rows, 2), obs.diff(dim=0)))
        start = torch.arange(0, rows, people)
        return (
            obs,
            obs,
            rel,
            rel,
            torch.zeros(rows),
            torch.ones(rows, 16),
            torch.stack((start, start + people), 1),
        )

    def networks(self, pooling: bool) -> tuple[nn.Module, nn.Module]:
        """Return generator and discriminator of SGAN-20VP-20 or, without ``pooling``, SGAN-20V-20."""
        generator = self.models.TrajectoryGenerator(
            8, 8, embedding_dim=16, encoder_h_dim=32, decoder_h_dim=32, mlp_dim=64, noise_dim=(8,),
            noise_mix_type="global", pooling_type="pool_net" if pooling else None, pool_every_timestep=False,
            bottleneck_dim=8, batch_norm=False,
        )  # fmt: skip
        discriminator = self.models.TrajectoryDiscriminator(
            8,
            8,
            embedding_dim=16,
            h_dim=48,
            mlp_dim=64,
            batch_norm=False,
            d_type="global" if pooling else "local",
        )
        for network in (generator, discriminator):
            network.apply(self.train.init_weights)
        return generator, discriminator

    def iteration(
        self, networks: tuple[nn.Module, nn.Module], optimizers: Any, batches: tuple[Batch, Batch]
    ) -> None:
        """Do one step of the discriminator and one of the generator, each on its own batch."""
        generator, discriminator = networks
        self.train.discriminator_step(
            self.args, batches[0], generator, discriminator, self.losses.gan_d_loss, optimizers[1]
        )
        self.train.generator_step(
            self.args, batches[1], generator, discriminator, self.losses.gan_g_loss, optimizers[0]
        )

    def best_of(self, generator: nn.Module, batches: list[Batch], samples: int) -> tuple[float, float]:
        """Return ADE and FDE of the best of ``samples`` per scene, as its evaluation does."""
        ade, fde = self.test.evaluate(self.args, batches, generator, samples)
        return float(ade), float(fde)

    def one_step(self, generator: nn.Module, batch: Batch, noise: Tensor | None = None) -> Tensor:
        """Return the next displacements (P, 2); ``noise`` (B, 8)."""
        generator.decoder.seq_len = 1  # type: ignore[union-attr]
        try:
            return generator(batch[0], batch[2], batch[-1], user_noise=noise)[0]
        finally:
            generator.decoder.seq_len = 8  # type: ignore[union-attr]


@contextmanager
def original(checkout: Path) -> Iterator[Original]:
    """Let the code of a checkout run within the block.

    Raises:
        UserError: The folder is no checkout of it.
    """
    check(checkout)
    # evaluate_model.py needs attrdict, which no longer imports, only to read checkpoints
    attrdict = ModuleType("attrdict")
    attrdict.AttrDict = dict  # type: ignore[attr-defined]
    sys.modules.setdefault("attrdict", attrdict)
    folders = [str(checkout.resolve()), str(checkout.resolve() / "scripts")]
    with (
        patch.object(sys, "path", [*folders, *sys.path]),
        patch.object(torch.Tensor, "cuda", lambda self, *_, **__: self),
    ):
        yield Original()


def check(checkout: Path) -> None:
    """Raise the error that a folder gives which is no checkout of the original."""
    if not (checkout / "sgan" / "models.py").is_file():
        raise UserError(
            f"{str(checkout)!r} is no checkout of Social GAN: "
            "git clone https://github.com/agrimgupta92/sgan and give its folder"
        )


@contextmanager
def _sorted_folders() -> Iterator[None]:
    """Let ``os.listdir`` sort, so that scenes have the same numbers on both sides."""
    plain = os.listdir
    os.listdir = lambda path=".": sorted(plain(path))  # type: ignore[assignment]
    try:
        yield
    finally:
        os.listdir = plain


NAMES = {
    "encoder.encoder.": "encoder.lstm.",
    "encoder.spatial_embedding.": "encoder.embedding.",
    "pool_net.spatial_embedding.": "pooling.embedding.",
    "pool_net.mlp_pre_pool.": "pooling.mlp.",
    "mlp_decoder_context.": "to_decoder.",
    "decoder.decoder.": "decoder.lstm.",
    "decoder.spatial_embedding.": "decoder.embedding.",
    "decoder.hidden2pos.": "decoder.output.",
    "real_classifier.": "classifier.",
}
"""How the original calls a parameter, and how pedzoo does."""


def copy_weights(original: nn.Module, ours: nn.Module) -> None:
    """Put the weights of an original network into pedzoo's; every one must find its place."""
    renamed = {}
    for key, value in original.state_dict().items():
        old = next(prefix for prefix in NAMES if key.startswith(prefix))
        renamed[NAMES[old] + key.removeprefix(old)] = value
    ours.load_state_dict(renamed)
