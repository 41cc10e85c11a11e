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
import os
import platform
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import lightning as L
import torch
from rich.console import Console
from rich.table import Table
from sgan_peer import Batch, Peer, copy_weights
from tensordict import TensorDict
from torch import nn

from pedzoo.cli.output import write_json
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.metrics.displacement import MinADEScene, MinFDEScene, displacement_error
from pedzoo.models.architectures.sgan import SGAN
from pedzoo.models.blocks.discriminator import Discriminator
from pedzoo.train.gan import GANModule
from pedzoo.versions import versions

SPLITS = ("train", "val", "test")
SAMPLES = 20
Row = dict[str, Any]


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

    rows, ours, theirs = time_loading(peer, options.data_root)
    agreement = {}
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
    report(rows, agreement, options.json)


def time_loading(peer: Peer, root: str) -> tuple[list[Row], TrajectoryDataModule, dict[str, Any]]:
    """Load train, val and test on both sides; returns also what was loaded."""
    with tempfile.TemporaryDirectory() as folder:
        # the original reads folders; numbers keep the files in pedzoo's order
        source = EthUcy("zara1", root)
        for split in SPLITS:
            (Path(folder) / split).mkdir()
            for i, file in enumerate(source.fold[split]):
                (Path(folder) / split / f"{i}").symlink_to((source.root / file).resolve())

        def load_theirs() -> dict[str, Any]:
            return {split: peer.dataset(Path(folder) / split) for split in SPLITS}

        def load_ours() -> TrajectoryDataModule:
            data = TrajectoryDataModule("zara1", root)
            with redirect_stdout(StringIO()):
                data.setup()
            return data

        rows, (theirs, ours) = race("load the fold", 20.0, load_theirs, load_ours, 3)
    for split in SPLITS:
        scenes, original = ours.sets[split], theirs[split]
        window = torch.cat((original.obs_traj, original.pred_traj), 2).transpose(1, 2)
        if scenes.offsets.tolist() != [0, *(end for _, end in original.seq_start_end)] or not torch.equal(
            scenes.xy[scenes.rows], window
        ):
            raise SystemExit(f"the {split} windows differ: these numbers would not be comparable")
    return [rows], ours, theirs


def time_scenes(peer: Peer, name: str, theirs: nn.Module, ours: SGAN) -> list[Row]:
    """Time the next step of a single scene."""
    rows = []
    for people, bar, times in ((10, 2.0, 300), (200, 8.0, 15)):
        batch = peer.scene(people)
        own = _as_ours(batch)
        with torch.no_grad():
            row, _ = race(
                f"one scene of {people}, {name}",
                bar if name == "VP" else None,
                lambda batch=batch: peer.one_step(theirs, batch),
                lambda own=own: ours.sample(own, 1, 1),
                times,
            )
        rows.append(row)
    return rows


def time_test(
    peer: Peer, name: str, theirs: nn.Module, ours: SGAN, batches: list[tuple[Batch, TensorDict]]
) -> list[Row]:
    """Time best-of-20 ADE and FDE on the whole test set."""

    @torch.no_grad()
    def our_pass() -> tuple[float, float]:
        ade, fde = MinADEScene(), MinFDEScene()
        for _, batch in batches:
            agents = batch["agents"]
            error = displacement_error(ours.sample(batch, SAMPLES, 8), agents["history"], agents["future"])
            for metric in (ade, fde):
                metric.update(error, agents["future_valid"])
        return float(ade.compute()), float(fde.compute())

    label, bar = f"best of {SAMPLES} on the test set, {name}", 8.0 if name == "VP" else 4.0
    row, _ = race(label, bar, lambda: peer.best_of(theirs, [b for b, _ in batches], SAMPLES), our_pass, 3)
    return [row]


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
    clock = _Turns(lambda i: peer.iteration(theirs, optimizers, (batches[i][0], batches[i][0])))
    trainer = L.Trainer(
        accelerator="cpu", max_epochs=1, logger=False, enable_checkpointing=False, enable_progress_bar=False,
        enable_model_summary=False, callbacks=[clock],
    )  # fmt: skip
    loader = torch.utils.data.DataLoader([b for _, b in batches], batch_size=None, collate_fn=lambda b: b)  # type: ignore[arg-type]
    trainer.fit(GANModule(*ours, lr=1e-4, warmup=0, final_lr=1.0), loader)
    bar = 4.0 if name == "VP" else 3.5
    # the first iteration of both is slower: memory is being allocated
    return [_row(f"D+G iteration, k = {SAMPLES}, {name}", bar, clock.theirs[1:], clock.ours[1:])]


class _Turns(L.Callback):
    """Runs an iteration of the original before each of ours, and times both."""

    def __init__(self, original: Callable[[int], None]) -> None:
        self.original = original
        self.theirs: list[float] = []
        self.ours: list[float] = []
        self.start = 0.0

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: Any, i: int) -> None:
        """Let the original go first."""
        self.theirs.append(_seconds(lambda: self.original(i)))
        self.start = time.perf_counter()

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: Any, batch: Any, i: int
    ) -> None:
        """Stop our clock."""
        self.ours.append(time.perf_counter() - self.start)


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
    window = torch.cat((original[2].transpose(0, 1), got), 1)
    position = torch.cat((original[0], original[1]))
    displacement = torch.cat((original[2], wanted.transpose(0, 1)))
    score = theirs[1](position, displacement, original[-1]).squeeze()
    return {
        "displacement_m": float((got - wanted).abs().max()),
        "score": float((ours[1](window, position[0], encoded.crowd) - score).abs().max()),
    }


def race(
    what: str, bar: float | None, theirs: Callable[[], Any], ours: Callable[[], Any], times: int
) -> tuple[Row, tuple[Any, Any]]:
    """Time two functions in turns, after one run of each that is not counted; returns also its results."""
    results = theirs(), ours()
    seconds = [(_seconds(theirs), _seconds(ours)) for _ in range(times)]
    return _row(what, bar, [a for a, _ in seconds], [b for _, b in seconds]), results


def _seconds(function: Callable[[], Any]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def _row(what: str, bar: float | None, theirs: list[float], ours: list[float]) -> Row:
    peer, mine = 1e3 * statistics.median(theirs), 1e3 * statistics.median(ours)
    print(f"{what}: {peer:.3g} ms, {mine:.3g} ms", file=sys.stderr)
    return {
        "what": what,
        "peer_ms": peer,
        "pedzoo_ms": mine,
        "ratio": peer / mine,
        "bar": bar,
        "n": len(ours),
    }


def _shuffled(data: TrajectoryDataModule, batches: int) -> list[torch.Tensor]:
    """Return the scenes (64,) of random batches, as the original draws them."""
    order = torch.randperm(len(data.sets["train"]), generator=torch.Generator().manual_seed(0))
    return list(order.split(64)[:batches])


def _as_ours(batch: Batch) -> TensorDict:
    """Return one scene of the original's form as a scene batch."""
    history = batch[0].transpose(0, 1).unsqueeze(0).contiguous()
    agents = {"history": history, "mask": torch.ones(history.shape[:2], dtype=torch.bool)}
    return TensorDict({"agents": TensorDict(agents, batch_size=history.shape[:2])}, batch_size=1)


def report(rows: list[Row], agreement: dict[str, dict[str, float]], file: str | None) -> None:
    """Print the table, and write it."""
    table = Table("what", "original, ms", "pedzoo, ms", "times", "bar", title="SGAN, zara1 8/8, one thread")
    for row in rows:
        bar = (
            "" if row["bar"] is None else f"{row['bar']:g} {'ok' if row['ratio'] >= row['bar'] else 'MISSED'}"
        )
        table.add_row(
            row["what"], f"{row['peer_ms']:.4g}", f"{row['pedzoo_ms']:.4g}", f"{row['ratio']:.1f}", bar
        )
    console = Console(width=110)
    console.print(table)
    for name, found in agreement.items():
        console.print(f"largest difference, same weights and noise, {name}: " + str(found))
    machine = {"cpu": _cpu(), "system": platform.platform(), "load": f"{os.getloadavg()[0]:.1f}"}
    console.print(" ".join(f"{k} {v}" for k, v in (versions() | machine).items()))
    if file:
        content = {
            "command": "bench_sgan",
            "versions": versions(),
            "machine": machine,
            "agreement": agreement,
        }
        write_json(file, content | {"rows": rows})


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )


if __name__ == "__main__":
    main()
