"""SGAN beside the original code of Social GAN: loading, one step, testing and training on the same scenes."""

from __future__ import annotations

import logging
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any, cast

import lightning as L
import torch
from tensordict import TensorDict
from torch import nn

from pedzoo.core.batch import scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.geometry import identity_pose
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.recordings import Split
from pedzoo.maps.bank import MapBank
from pedzoo.metrics.displacement import MinADEScene, MinFDEScene, displacement_error
from pedzoo.models.architectures import sgan as architecture
from pedzoo.models.blocks.discriminator import Discriminator
from pedzoo.train.modules.gan import GANModule
from tools.bench.figures import Measured, Row
from tools.bench.original_sgan import Batch, Original, copy_weights, original
from tools.bench.section import NotGivenError, Section
from tools.bench.turns import Clock, race, seconds_of, versus

SPLITS: tuple[Split, ...] = ("train", "val", "test")
SAMPLES = 20
FOLD, WHERE = "zara1", "zara1 8/8"
AGREED = 1e-4
"""Metres and scores that both may differ by for the same weights and noise."""

BARS = {
    "load the fold": 20.0,
    "one step of 1 scene of 10, VP": 2.0,
    "one step of 1 scene of 200, VP": 8.0,
    "best of 20 on the test set, VP": 8.0,
    "best of 20 on the test set, V": 4.0,
    "D+G iteration, k = 20, VP": 4.0,
    "D+G iteration, k = 20, V": 3.5,
}
"""How many times as fast ours has to be."""


class Sgan(Section):
    """The published hyper-parameters of SGAN-20VP-20, and the same without pooling (SGAN-20V-20).

    Fold zara1, 8 observed and 8 predicted steps, 64 scenes per batch. Before anything is timed, the
    original's weights go into pedzoo's networks and both must give the same answers for the same noise.
    """

    def rows(self) -> Iterator[Row]:
        """Measure beside a checkout."""
        if self.settings.sgan is None:
            raise NotGivenError(
                "needs the original: git clone https://github.com/agrimgupta92/sgan, and --sgan FOLDER"
            )
        with warnings.catch_warnings(), original(self.settings.sgan) as peer:
            warnings.simplefilter("ignore")  # the original's, of an older torch, and Lightning's advice
            yield from self._beside(peer)

    def _beside(self, peer: Original) -> Iterator[Row]:
        now, quick = self.settings.clock, self.settings.quick
        loading, ours, theirs = loaded(peer, self.settings.data, 1 if quick else 3, now)
        yield _row("load the fold", *loading)
        for name, pooling in (("VP", True), ("V", False)):
            peers = peer.networks(pooling)
            generator = architecture.SGAN.of(bottleneck_dim=8 if pooling else 0)
            mine = generator, Discriminator("global" if pooling else "local")
            for old, own in zip(peers, mine, strict=True):
                copy_weights(old, own)
            draws = shuffled(ours, 3 if quick else 9)  # one draw of scenes for both sides
            train = [(peer.batch(theirs["train"], i), ours.sets["train"].batch(i)) for i in draws]
            order = torch.arange(len(ours.sets["test"])).split(64)[: 2 if quick else None]
            test = [(peer.batch(theirs["test"], i), ours.sets["test"].batch(i)) for i in order]
            apart = differences(peers, mine, train[0])
            result = {key: Measured.of([value]) for key, value in apart.items()}
            yield Row("sgan", f"largest difference, {name}", {"data": WHERE}, result)
            if not max(apart.values()) < AGREED:
                raise UserError(f"sgan: the answers differ by {apart}: times of them are not comparable")
            for scenes, people, times in ((1, 10, 300), (1, 200, 15), (64, 10, 30)):
                what = f"one step of {scenes} scene{'s' * (scenes > 1)} of {people}, {name}"
                steps = times // 10 if quick else times
                yield _row(what, *one_step(peer, peers[0], mine[0], (scenes, people), steps, now))
            whole = race(
                lambda mine=mine, test=test: best_of(mine[0], test),
                lambda peers=peers, test=test: peer.best_of(peers[0], [b for b, _ in test], SAMPLES),
                1 if quick else 3,
                now,
            )
            yield _row(f"best of {SAMPLES} on the test set, {name}", *whole)
            yield _row(f"D+G iteration, k = {SAMPLES}, {name}", *iterations(peer, peers, mine, train, now))


def _row(what: str, ours: list[float], theirs: list[float]) -> Row:
    row = Row("sgan", what, {"data": WHERE}, versus(ours, theirs, "original"))
    return replace(row, bars=[row.at_least("times_original", BARS[what])]) if what in BARS else row


def loaded(
    peer: Original, root: str | None, times: int, now: Clock
) -> tuple[tuple[list[float], list[float]], TrajectoryDataModule, dict[str, Any]]:
    """Load train, val and test on both sides: what that took, ours and theirs."""
    results: dict[str, Any] = {}
    try:
        source = EthUcy(FOLD, root)
    except UserError as error:
        raise NotGivenError(f"needs the recordings of ETH/UCY (--data FOLDER): {error}") from error
    with tempfile.TemporaryDirectory() as folder:
        # the original reads folders; numbers keep the files in pedzoo's order
        for split in SPLITS:
            (Path(folder) / split).mkdir()
            for i, file in enumerate(source.files(split)):
                (Path(folder) / split / f"{i}").symlink_to(file.resolve())

        def load_theirs() -> None:
            results["theirs"] = {split: peer.dataset(Path(folder) / split) for split in SPLITS}

        def load_ours() -> None:
            data = results["ours"] = TrajectoryDataModule(FOLD, root)
            with redirect_stdout(StringIO()):
                data.setup()

        taken = race(load_ours, load_theirs, times, now)
    ours, theirs = results["ours"], results["theirs"]
    for split in SPLITS:
        scenes, old = ours.sets[split], theirs[split]
        window = torch.cat((old.obs_traj, old.pred_traj), 2).transpose(1, 2)
        if scenes.offsets.tolist() != [0, *(end for _, end in old.seq_start_end)] or not torch.equal(
            scenes.xy[scenes.rows], window
        ):
            raise UserError(f"sgan: the {split} windows differ: times of them are not comparable")
    return taken, ours, theirs


@torch.no_grad()
def one_step(
    peer: Original, theirs: nn.Module, ours: architecture.SGAN, size: tuple[int, int], times: int, now: Clock
) -> tuple[list[float], list[float]]:
    """Time the next step of some scenes at once."""
    batch = peer.scenes(*size)
    own = as_ours(batch)
    return race(lambda: ours.sample(own, 1, 1), lambda: peer.one_step(theirs, batch), times, now)


@torch.no_grad()
def best_of(ours: architecture.SGAN, batches: list[tuple[Batch, TensorDict]]) -> tuple[float, float]:
    """Return ADE and FDE of the best of 20 per scene."""
    ade, fde = MinADEScene(), MinFDEScene()
    for _, batch in batches:
        agents = cast("TensorDict", batch["agents"])
        error = displacement_error(ours.sample(batch, SAMPLES, 8), agents["history"], agents["future"])
        for metric in (ade, fde):
            metric.update(error, agents["future_valid"])
    return float(ade.compute()), float(fde.compute())


def iterations(
    peer: Original,
    theirs: tuple[nn.Module, nn.Module],
    ours: tuple[architecture.SGAN, Discriminator],
    batches: list[tuple[Batch, TensorDict]],
    now: Clock,
) -> tuple[list[float], list[float]]:
    """Time iterations of one discriminator and one generator step, ours inside Lightning's loop."""
    optimizers = [torch.optim.Adam(network.parameters(), 1e-4) for network in theirs]
    # a generator step of the original takes a fresh batch: the same one serves both sides for both steps
    turns = Turns(lambda i: peer.iteration(theirs, optimizers, (batches[i][0], batches[i][0])), now)
    trainer = L.Trainer(
        accelerator="cpu", max_epochs=1, logger=False, enable_checkpointing=False, enable_progress_bar=False,
        enable_model_summary=False, callbacks=[turns],
    )  # fmt: skip
    loader = torch.utils.data.DataLoader([b for _, b in batches], batch_size=None, collate_fn=lambda b: b)  # type: ignore[arg-type]
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    logger.setLevel(logging.WARNING)  # what devices there are does not belong into a table
    try:
        trainer.fit(GANModule(*ours, lr=1e-4, warmup=0, final_lr=1.0), loader)
    finally:
        logger.setLevel(level)
    # the first iteration of both is slower: memory is being allocated
    return turns.ours[1:], turns.theirs[1:]


class Turns(L.Callback):
    """Runs an iteration of the other program before each of our training loop, and times both."""

    def __init__(self, other: Callable[[int], None], now: Clock) -> None:
        """Take what runs the other program's iteration of a given number, and the clock."""
        self.other, self.now = other, now
        self.theirs: list[float] = []
        self.ours: list[float] = []
        self.start = 0.0

    def on_train_batch_start(
        self, trainer: L.Trainer, pl_module: L.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        """Let the other program go first."""
        self.theirs.append(seconds_of(lambda: self.other(batch_idx), self.now))
        self.start = self.now()

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop our clock."""
        self.ours.append(self.now() - self.start)


@torch.no_grad()
def differences(
    theirs: tuple[nn.Module, nn.Module],
    ours: tuple[architecture.SGAN, Discriminator],
    batches: tuple[Batch, TensorDict],
) -> dict[str, float]:
    """Return the largest differences for the same weights and noise: displacements (m), scores."""
    old, batch = batches
    z = torch.randn(len(batch), 8)
    wanted = theirs[0](old[0], old[2], old[-1], user_noise=z).transpose(0, 1)
    encoded = ours[0].encode(batch, 8)
    got = ours[0].decode(encoded, z[encoded.crowd.scene].unsqueeze(0), 8)[0]
    window = torch.cat((old[2][1:].transpose(0, 1), got), 1)
    position = torch.cat((old[0], old[1]))
    displacement = torch.cat((old[2], wanted.transpose(0, 1)))
    score = theirs[1](position, displacement, old[-1]).squeeze()
    return {
        "displacement_m": float((got - wanted).abs().max()),
        "score": float((ours[1](window, position[0], encoded.crowd) - score).abs().max()),
    }


def shuffled(data: TrajectoryDataModule, batches: int) -> list[torch.Tensor]:
    """Return the scenes (64,) of random batches, as the original draws them."""
    order = torch.randperm(len(data.sets["train"]), generator=torch.Generator().manual_seed(0))
    return list(order.split(64)[:batches])


def as_ours(batch: Batch) -> TensorDict:
    """Return scenes of equal size in the original's form as a scene batch."""
    scenes = len(batch[-1])
    history = batch[0].transpose(0, 1).unflatten(0, (scenes, -1)).contiguous()
    return scene_batch(
        maps=MapBank(),
        map_id=torch.full((scenes, 1), -1),
        pose=identity_pose(scenes),
        history=history,
        valid=torch.ones(history.shape[:3], dtype=torch.bool),
        mask=torch.ones(history.shape[:2], dtype=torch.bool),
        pref_speed=history.new_ones(*history.shape[:2], 1),
    )
