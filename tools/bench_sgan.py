"""Times pedzoo's SGAN beside the original code, in one process and on the same scenes.

    git clone https://github.com/agrimgupta92/sgan ../peer/sgan
    python tools/bench_sgan.py --peer ../peer/sgan [--data-root ../shared/data/eth_ucy] [--json FILE]

The fold is zara1, 8 observed and 8 predicted steps, 64 scenes per batch; hyper-parameters are those of the
published SGAN-20VP-20 checkpoint, and the same without pooling and with a local discriminator (SGAN-20V-20).
One thread; both sides take turns, numbers are medians. Before anything is timed, the original's weights go
into pedzoo's networks and both must give the same answers for the same noise.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, cast

import lightning as L
import torch
from sgan_peer import Batch, Peer, copy_weights
from side_by_side import Row, Turns, race, report, row
from tensordict import TensorDict
from torch import nn

from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.recordings import Split
from pedzoo.metrics.displacement import MinADEScene, MinFDEScene, displacement_error
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.blocks.discriminator import Discriminator
from pedzoo.train.gan import GANModule

SPLITS: tuple[Split, ...] = ("train", "val", "test")
SAMPLES = 20


def main() -> None:
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peer", required=True, help="checkout of agrimgupta92/sgan")
    parser.add_argument("--data-root", default="../shared/data/eth_ucy", help="folder with splits.json")
    parser.add_argument("--json", help="also write the table to this file")
    parser.add_argument(
        "--iterations", type=int, default=9, help="D+G iterations per side (the first is dropped)"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore")  # the original's, of an older torch, and Lightning's advice
    peer = Peer(Path(options.peer))

    loading, ours, theirs = time_loading(peer, options.data_root)
    rows, agreement = [loading], {}
    for name, pooling in (("VP", True), ("V", False)):
        peers = peer.networks(pooling)
        mine = SGAN(bottleneck_dim=8 if pooling else 0), Discriminator("global" if pooling else "local")
        for original, own in zip(peers, mine, strict=True):
            copy_weights(original, own)
        # one draw of scenes for both sides
        draws = _shuffled(ours, options.iterations)
        train = [(peer.batch(theirs["train"], i), ours.sets["train"].batch(i)) for i in draws]
        order = torch.arange(len(ours.sets["test"])).split(64)
        test = [(peer.batch(theirs["test"], i), ours.sets["test"].batch(i)) for i in order]
        agreement[name] = differences(peer, peers, mine, train[0])
        rows += time_scenes(peer, name, peers[0], mine[0])
        rows += time_test(peer, name, peers[0], mine[0], test)
        rows += time_training(peer, name, peers, mine, train)
    report("SGAN, zara1 8/8, one thread", rows, agreement, options.json)


def time_loading(peer: Peer, root: str) -> tuple[Row, TrajectoryDataModule, dict[str, Any]]:
    """Load train, val and test on both sides; returns also what was loaded."""
    with tempfile.TemporaryDirectory() as folder:
        # the original reads folders; numbers keep the files in pedzoo's order
        source = EthUcy("zara1", root)
        for split in SPLITS:
            (Path(folder) / split).mkdir()
            for i, file in enumerate(source.files[split]):
                (Path(folder) / split / f"{i}").symlink_to((source.root / file).resolve())

        def load_theirs() -> dict[str, Any]:
            return {split: peer.dataset(Path(folder) / split) for split in SPLITS}

        def load_ours() -> TrajectoryDataModule:
            data = TrajectoryDataModule("zara1", root)
            with redirect_stdout(StringIO()):
                data.setup()
            return data

        loading, (theirs, ours) = race("load the fold", 20.0, load_theirs, load_ours, 3)
    for split in SPLITS:
        scenes, original = ours.sets[split], theirs[split]
        window = torch.cat((original.obs_traj, original.pred_traj), 2).transpose(1, 2)
        if scenes.offsets.tolist() != [0, *(end for _, end in original.seq_start_end)] or not torch.equal(
            scenes.xy[scenes.rows], window
        ):
            raise SystemExit(f"the {split} windows differ: these numbers would not be comparable")
    return loading, ours, theirs


def time_scenes(peer: Peer, name: str, theirs: nn.Module, ours: SGAN) -> list[Row]:
    """Time the next step of one scene, and of many at once."""
    rows = []
    for scenes, people, bar, times in ((1, 10, 2.0, 300), (1, 200, 8.0, 15), (64, 10, None, 30)):
        batch = peer.scenes(scenes, people)
        own = _as_ours(batch)
        label = f"one step of {scenes} scene{'s' * (scenes > 1)} of {people}, {name}"
        with torch.no_grad():
            found, _ = race(
                label,
                bar if name == "VP" else None,
                lambda batch=batch: peer.one_step(theirs, batch),
                lambda own=own: ours.sample(own, 1, 1),
                times,
            )
        rows.append(found)
    return rows


def time_test(
    peer: Peer, name: str, theirs: nn.Module, ours: SGAN, batches: list[tuple[Batch, TensorDict]]
) -> list[Row]:
    """Time best-of-20 ADE and FDE on the whole test set."""

    @torch.no_grad()
    def our_pass() -> tuple[float, float]:
        ade, fde = MinADEScene(), MinFDEScene()
        for _, batch in batches:
            agents = cast("TensorDict", batch["agents"])
            error = displacement_error(ours.sample(batch, SAMPLES, 8), agents["history"], agents["future"])
            for metric in (ade, fde):
                metric.update(error, agents["future_valid"])
        return float(ade.compute()), float(fde.compute())

    label, bar = f"best of {SAMPLES} on the test set, {name}", 8.0 if name == "VP" else 4.0
    found, _ = race(label, bar, lambda: peer.best_of(theirs, [b for b, _ in batches], SAMPLES), our_pass, 3)
    return [found]


def time_training(
    peer: Peer,
    name: str,
    theirs: tuple[nn.Module, nn.Module],
    ours: tuple[SGAN, Discriminator],
    batches: list[tuple[Batch, TensorDict]],
) -> list[Row]:
    """Time iterations of one discriminator and one generator step, ours inside Lightning's loop."""
    optimizers = [torch.optim.Adam(network.parameters(), 1e-4) for network in theirs]
    # a generator step of the original takes a fresh batch: the same one serves both sides for both steps
    clock = Turns(lambda i: peer.iteration(theirs, optimizers, (batches[i][0], batches[i][0])))
    trainer = L.Trainer(
        accelerator="cpu", max_epochs=1, logger=False, enable_checkpointing=False, enable_progress_bar=False,
        enable_model_summary=False, callbacks=[clock],
    )  # fmt: skip
    loader = torch.utils.data.DataLoader([b for _, b in batches], batch_size=None, collate_fn=lambda b: b)  # type: ignore[arg-type]
    trainer.fit(GANModule(*ours, lr=1e-4, warmup=0, final_lr=1.0), loader)
    bar = 4.0 if name == "VP" else 3.5
    # the first iteration of both is slower: memory is being allocated
    return [row(f"D+G iteration, k = {SAMPLES}, {name}", bar, clock.theirs[1:], clock.ours[1:])]


@torch.no_grad()
def differences(
    peer: Peer,
    theirs: tuple[nn.Module, nn.Module],
    ours: tuple[SGAN, Discriminator],
    batches: tuple[Batch, TensorDict],
) -> dict[str, float]:
    """Return the largest differences for the same weights and noise: displacements (m), scores."""
    original, batch = batches
    z = torch.randn(len(batch), 8)
    wanted = theirs[0](original[0], original[2], original[-1], user_noise=z).transpose(0, 1)
    encoded = ours[0].encode(batch, 8)
    got = ours[0].decode(encoded, z[encoded.crowd.scene].unsqueeze(0), 8)[0]
    window = torch.cat((original[2][1:].transpose(0, 1), got), 1)
    position = torch.cat((original[0], original[1]))
    displacement = torch.cat((original[2], wanted.transpose(0, 1)))
    score = theirs[1](position, displacement, original[-1]).squeeze()
    return {
        "displacement_m": float((got - wanted).abs().max()),
        "score": float((ours[1](window, position[0], encoded.crowd) - score).abs().max()),
    }


def _shuffled(data: TrajectoryDataModule, batches: int) -> list[torch.Tensor]:
    """Return the scenes (64,) of random batches, as the original draws them."""
    order = torch.randperm(len(data.sets["train"]), generator=torch.Generator().manual_seed(0))
    return list(order.split(64)[:batches])


def _as_ours(batch: Batch) -> TensorDict:
    """Return scenes of equal size in the original's form as a scene batch."""
    scenes = len(batch[-1])
    history = batch[0].transpose(0, 1).unflatten(0, (scenes, -1)).contiguous()
    agents = {"history": history, "mask": torch.ones(history.shape[:2], dtype=torch.bool)}
    return TensorDict({"agents": TensorDict(agents, batch_size=history.shape[:2])}, batch_size=scenes)


if __name__ == "__main__":
    main()
