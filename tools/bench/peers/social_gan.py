"""The original Social GAN as a peer of `pedzoo bench`: a generator's step of training, and twenty futures.

    git clone https://github.com/agrimgupta92/sgan ../sgan
    SGAN=../sgan pedzoo bench train forecast --peer tools/bench/peers/social_gan.py

Nothing of it is copied or changed: what no longer works on today's torch is replaced at run time. Scenes are
random walks of the sizes that are asked about; the networks are those of SGAN-20VP-20.
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from answering import Sizes, Step, TimedCase, serve
from torch import Tensor

FOLDER = "SGAN"
"""The variable with the checkout."""

ARGS = Namespace(
    obs_len=8, pred_len=8, best_k=20, l2_loss_weight=1.0, clipping_threshold_g=2.0, clipping_threshold_d=0.0
)


def cases(asked: Sizes) -> list[TimedCase]:
    """Return training and sampling for the sizes that are asked about."""
    torch.set_num_threads(1)
    works = {"train": ("Social GAN's generator, best of 20", training)}
    works["forecast"] = ("sgan.zara1", sampling)
    return [
        TimedCase(section, name, lambda work=work, b=b, a=a: work(b, a), b, a)
        for section, (name, work) in works.items()
        for b, a in asked.get(section, [])
    ]


def original() -> tuple[Any, Any]:
    """Return the original's modules of training and networks; ends the peer where there are none."""
    folder = Path(os.environ.get(FOLDER, "")).resolve()
    if not (folder / "sgan" / "models.py").is_file():
        sys.exit(f"{str(folder)!r} is no checkout of Social GAN: set {FOLDER}=FOLDER")
    sys.path[:0] = [str(folder), str(folder / "scripts")]
    attrdict = ModuleType("attrdict")  # no longer imports, and only reads checkpoints
    attrdict.AttrDict = dict  # pyright: ignore[reportAttributeAccessIssue]
    sys.modules.setdefault("attrdict", attrdict)
    torch.Tensor.cuda = lambda self, *_, **__: self  # pyright: ignore[reportAttributeAccessIssue]
    return import_module("train"), import_module("sgan.models")


def generator(models: Any) -> Any:
    """Return the generator of SGAN-20VP-20."""
    sizes = {"embedding_dim": 16, "encoder_h_dim": 32, "decoder_h_dim": 32, "mlp_dim": 64}
    sizes["bottleneck_dim"] = 8
    noise = {"noise_dim": (8,), "noise_mix_type": "global"}
    pooling = {"pooling_type": "pool_net", "pool_every_timestep": False, "batch_norm": False}
    return models.TrajectoryGenerator(8, 8, **sizes, **noise, **pooling)


def walks(scenes: int, people: int) -> tuple[Tensor, ...]:
    """Return a batch of random walks in the original's form."""
    rows = scenes * people
    steps = 0.4 * torch.randn(16, rows, 2)
    place = steps.cumsum(0) + 5 * torch.randn(rows, 2)
    start = torch.arange(0, rows, people)
    ends = torch.stack((start, start + people), 1)
    return place[:8], place[8:], steps[:8], steps[8:], torch.zeros(rows), torch.ones(rows, 16), ends


def training(scenes: int, people: int) -> Step:
    """Return one step of the generator's training; the discriminator judges the best sample."""
    train, models = original()
    own = generator(models)
    judge = models.TrajectoryDiscriminator(
        8, 8, embedding_dim=16, h_dim=48, mlp_dim=64, batch_norm=False, d_type="global"
    )
    losses = import_module("sgan.losses")
    optimizer, batch = torch.optim.Adam(own.parameters(), 1e-4), walks(scenes, people)
    return lambda: train.generator_step(ARGS, batch, own, judge, losses.gan_g_loss, optimizer)


def sampling(scenes: int, people: int) -> Step:
    """Return twenty futures of all scenes, one after the other as its evaluation draws them."""
    own, batch = generator(original()[1]), walks(scenes, people)

    @torch.no_grad()
    def step() -> None:
        for _ in range(20):
            own(batch[0], batch[2], batch[-1])

    return step


if __name__ == "__main__":
    serve("Social GAN", {"torch": torch.__version__}, cases)
