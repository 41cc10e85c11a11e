"""The LightningDataModule: one fold of recordings as scene batches."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import lightning as L
import numpy as np
import torch
from lightning.pytorch.utilities import rank_zero_only
from tensordict import TensorDict
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from pedzoo.core.errors import UserError
from pedzoo.core.types import OBS_LEN, GoalProtocol, TimeBase
from pedzoo.data.recordings import (
    OWN_FILES,
    OpenFold,
    OwnFiles,
    Recording,
    Scene,
    Split,
    find_fold,
    grids_of,
    open_fold,
)
from pedzoo.data.scenes import KeptPeople, SceneSet, WindowCounts, augmentation
from pedzoo.data.tracks import Tracks
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid

STAGES: dict[Split, str] = {"train": "fit", "val": "validate", "test": "test"}
"""Lightning's name for the stage that needs a split."""

PROTOCOL = ("fold", "obs_len", "pred_len", "goal", "clock", "keep_people", "min_people")
"""Options of the data on which every number that is made with them depends."""


@dataclass(frozen=True)
class Loading:
    """How batches of training are made: no number of an evaluation depends on it.

    Attributes:
        batch_size: Scenes in a batch, at most.
        max_pairs: Ordered pairs of people in a batch, at most.
        rotate: Turn training scenes at random.
        mirror: Mirror half of the training scenes.
        seed: Of the order of batches and all augmentation.
    """

    batch_size: int = 64
    max_pairs: int = 16384
    rotate: bool = False
    mirror: bool = False
    seed: int = 0


@dataclass(frozen=True)
class ImitationWindows:
    """Further training windows, for a controller that imitates the walks of their people.

    With them training batches are ``{"forecast": as without, "unrolled": these windows}``. They keep all
    present people, lone people too, and have the goal ``destination``. They are on the true clock for every
    ``clock``: speeds and accelerations are imitated.

    Attributes:
        steps: Predicted steps of these windows; 0 for no such windows.
        batch_size: Scenes in a batch of these, at most; ``max_pairs`` changes in proportion.
        one_recording_per_batch: A batch of these is of one recording: recordings differ in the accuracy of
            positions, and so in their apparent accelerations.
    """

    steps: int = 0
    batch_size: int = 64
    one_recording_per_batch: bool = False


class TrajectoryDataModule(L.LightningDataModule):
    """Recorded people of one fold, as scene batches (see `pedzoo.core.batch`)."""

    def __init__(
        self,
        fold: str = "embedded",
        root: str | None = None,
        files: list[str] | None = None,
        dt: float | None = None,
        split: str = "0.7,0.15,0.15",
        map: str | None = None,
        homography: str | None = None,
        obs_len: int = OBS_LEN,
        pred_len: int = 8,
        goal: GoalProtocol = "none",
        clock: TimeBase = "benchmark",
        keep_people: KeptPeople = "complete",
        min_people: int = 2,
        hold_out: str | None = None,
        loading: Loading = Loading(),
        imitated: ImitationWindows = ImitationWindows(),
    ) -> None:
        """Set the data that `setup` will read.

        Args:
            fold: The test scene (eth, hotel, univ, zara1, zara2), ``embedded``, or ``file.py:Class:fold``.
            root: Folder of the recordings; PEDZOO_DATA, or what `pedzoo download` brought, if not given.
            files: Your own recordings instead of a fold.
            dt: Seconds between consecutive frame numbers of ``files``; None where these say it.
            split: Shares of the recorded time of ``files`` for train, val and test.
            map: The floor plan of ``files``: a ROS map yaml, or a name as ``apartment.7``.
            homography: Text file of a 3x3 matrix from the positions in ``files`` to world metres.
            obs_len: Observed steps of 0.4 s.
            pred_len: Predicted steps of 0.4 s.
            goal: Protocol of people's ``goal``; see `pedzoo.data.scenes`.
            clock: ``benchmark`` takes every annotated step as 0.4 s, ``true`` resamples to real 0.4 s.
            keep_people: ``complete``: people seen in the whole window; ``present``: also partly seen ones.
            min_people: Windows with fewer people are dropped.
            hold_out: A second scene that training leaves out, by the name of its fold, and that validation is
                on; None for the later minutes of the training scenes. For choices such as the length of
                training, without a look at the test scene.
            loading: How batches are made.
            imitated: Further training windows.
        """
        given = {key: value for key, value in locals().items() if key not in ("self", "__class__")}
        super().__init__()
        # as plain values: checkpoints and loggers keep them
        self.save_hyperparameters(given | {"loading": asdict(loading), "imitated": asdict(imitated)})
        if obs_len < 2 or pred_len < 1:
            raise UserError(f"--data.obs_len {obs_len} --data.pred_len {pred_len}: expected at least 2 and 1")
        counts = {
            "min_people": min_people,
            "loading.batch_size": loading.batch_size,
            "loading.max_pairs": loading.max_pairs,
            "imitated.batch_size": imitated.batch_size,
        }
        if wrong := [name for name, count in counts.items() if count < 1]:
            raise UserError(f"--data.{wrong[0]} {counts[wrong[0]]}: expected at least 1")
        if imitated.steps < 0:
            raise UserError(
                f"--data.imitated.steps {imitated.steps}: expected steps of 0.4 s, or 0 for no such windows"
            )
        own = {"dt": dt, "map": map, "homography": homography}
        if not files and any(own.values()):
            given = " and ".join(f"--data.{name}" for name, value in own.items() if value)
            raise UserError(f"{given} given without --data.files: the fold {fold!r} has its own")
        self.fold = OWN_FILES if files else fold
        self.obs_len, self.pred_len = obs_len, pred_len
        self.goal: GoalProtocol = goal
        self.keep_people: KeptPeople = keep_people
        self.min_people = min_people
        self.loading, self.imitated = loading, imitated
        self.source = OwnFiles(files, dt, split, map, homography) if files else open_fold(fold, root, clock)
        self._grids: dict[Path | OccupancyGrid, OccupancyGrid] = {}
        self.bank = MapBank([])
        self.sets: dict[Split, SceneSet] = {}
        self.unrolled: SceneSet | None = None

    @cached_property
    def _real(self) -> OwnFiles | OpenFold:
        """The source on the true clock."""
        true = self.hparams["files"] or self.hparams["clock"] == "true"
        return self.source if true else open_fold(self.fold, self.hparams["root"], "true")

    @property
    def protocol(self) -> dict:
        """Settings of the data on which every number made with them depends."""
        own = {"clock": "true"} if self.fold == OWN_FILES else {}  # always resampled to a real 0.4 s
        return {key: self.hparams[key] for key in PROTOCOL} | {"fold": self.fold} | own

    def setup(self, stage: str | None = None) -> None:
        """Read the splits of a Lightning stage, None for all. Raises UserError: one has no window."""
        wanted: dict[str | None, tuple[Split, ...]] = {
            "fit": ("train", "val"), "validate": ("val",), "test": ("test",), None: ("train", "val", "test")
        }  # fmt: skip
        missing: list[Split] = [split for split in wanted[stage] if split not in self.sets]
        recordings = {split: self._recordings(self.source, split) for split in missing}
        steps = self.imitated.steps if "train" in missing else 0
        real: list[Recording] = []
        if steps:
            real = recordings["train"] if self._real is self.source else self._recordings(self._real, "train")
        every = [one for part in (*recordings.values(), real) for one in part]
        if new := grids_of(one for one in every if one.plan not in self._grids):
            self._grids |= new
            # recorded people walk where the camera did not see the floor: unknown cells are free here
            self.bank = MapBank([grid.at_home() for grid in self._grids.values()], unknown="free")
        for split in missing:
            part = recordings[split]
            self.sets[split] = self._scenes(part, self.pred_len, self.keep_people, self.min_people)
            _print_counts(f"{self.fold} {split}", self.sets[split])
        if steps:
            self.unrolled = self._scenes(real, steps, "present", 1)
            _print_counts(f"{self.fold} train, unrolled for {steps} steps", self.unrolled)

    def _recordings(self, source: OwnFiles | OpenFold, split: Split) -> list[Recording]:
        """Return the recordings of a split of a source, with a scene held out where one is."""
        scene = self.hparams["hold_out"]
        if scene is None or split == "test":
            return source.recordings(split)
        fold = None if self.hparams["files"] else find_fold(scene)
        tested = tuple(fold.tested or ()) if fold and fold.name != self.fold else ()
        parts: tuple[Split, ...] = ("train",) if split == "train" else ("train", "val")
        every = [one for part in parts for one in source.recordings(part)]
        # a part of a recording begins with the name of the whole
        held = [one.tracks.name.startswith(tested) for one in every]
        if not any(held):
            raise UserError(
                f"--data.hold_out {scene}: expected another scene of the recordings of {self.fold!r}"
            )
        return [one for one, out in zip(every, held, strict=True) if out == (split == "val")]

    def crowds(self, split: Split) -> list[tuple[Tracks, int, float]]:
        """Return the recordings of a split on the true clock, with ``map_id`` of floor plan, and weight.

        Their frame is that of the floor plan in the bank, see `pedzoo.data.recordings.Scene`.
        """
        recordings = self._recordings(self._real, split)
        placed = zip(self._at_home(recordings), recordings, strict=True)
        return [(scene.tracks, map_id, one.weight) for (scene, map_id), one in placed]

    def _at_home(self, recordings: list[Recording]) -> list[tuple[Scene, int]]:
        """Return the scene of every recording, and the ``map_id`` of its floor plan."""
        scenes = [Scene.of(one.tracks, self._grids[one.plan] if one.plan else None) for one in recordings]
        return [(scene, scene.grid.map_id if scene.grid else -1) for scene in scenes]

    def _scenes(
        self, recordings: list[Recording], steps: int, people: KeptPeople, min_people: int
    ) -> SceneSet:
        scenes, map_ids = zip(*self._at_home(recordings), strict=True)
        return SceneSet(scenes, map_ids, self.bank, self.obs_len, steps, people, min_people)

    def train_dataloader(self) -> Any:
        """Return shuffled, augmented batches; with windows to imitate two loaders, which Lightning joins."""
        forecast = self._loader("train", shuffle=True)
        if self.unrolled is None:
            return forecast
        groups = self.unrolled.recording if self.imitated.one_recording_per_batch else None
        unrolled = self._batches(self.unrolled, "destination", self.imitated.batch_size, True, groups)
        return {"forecast": forecast, "unrolled": unrolled}

    def recorded(self, split: Split) -> DataLoader:
        """Return all windows of a split in order, as they were recorded."""
        return self._loader(split)

    def val_dataloader(self) -> DataLoader:
        """Return all validation windows in order."""
        return self._loader("val")

    def test_dataloader(self) -> DataLoader:
        """Return all test windows in order."""
        return self._loader("test")

    def _loader(self, split: Split, shuffle: bool = False) -> DataLoader:
        if split not in self.sets:
            self.setup(STAGES[split])
        return self._batches(self.sets[split], self.goal, self.loading.batch_size, shuffle)

    def _batches(
        self, scenes: SceneSet, goal: GoalProtocol, size: int, shuffle: bool, groups: Tensor | None = None
    ) -> DataLoader:
        own, rank, replicas = self.loading, 0, 1
        # every process evaluates all windows: nothing is counted twice or left out
        if shuffle and self.trainer:
            rank, replicas = self.trainer.global_rank, self.trainer.world_size
        pairs = max(1, own.max_pairs * size // own.batch_size)
        sampler = BucketSampler(scenes.sizes, size, pairs, shuffle, own.seed, rank, replicas, groups)
        batches = _Batches(scenes, goal, own.rotate and shuffle, own.mirror and shuffle)
        return DataLoader(batches, sampler=sampler, batch_size=None, collate_fn=_as_it_is)


class Draw(NamedTuple):
    """One batch to come: its scenes (B,) and the seed of everything random about it."""

    scenes: Tensor
    seed: int


class BucketSampler(DistributedSampler[Draw]):
    """Batches of scenes of similar crowd size, so that padding is small and pooling runs over few groups.

    Scenes are ordered by size with ties in random order and cut into batches, which come in random order. An
    epoch depends on nothing but ``seed`` and its number. Without ``shuffle`` all epochs are the same.

    It is a `DistributedSampler`, though nothing is inherited, so that Lightning leaves it alone: of others it
    takes each process's share, which would be a share of the share.
    """

    def __init__(
        self,
        sizes: Tensor,
        batch_size: int,
        max_pairs: int,
        shuffle: bool,
        seed: int = 0,
        rank: int = 0,
        replicas: int = 1,
        groups: Tensor | None = None,
    ) -> None:
        """Cut the batches.

        Args:
            sizes: People in each scene (S,).
            batch_size: Scenes in a batch, at most.
            max_pairs: Ordered pairs of people in a batch, at most.
            shuffle: Another order in every epoch.
            seed: Of the order.
            rank: Of the process.
            replicas: Processes, each of which gets its share.
            groups: Which scenes may be in a batch together (S,) long: those of the same number; None for all.
        """
        self.sizes = sizes.numpy()
        self.groups = np.zeros_like(self.sizes) if groups is None else groups.numpy()
        self.shuffle, self.seed, self.rank, self.replicas = shuffle, seed, rank, replicas
        self.epoch = 0
        self.cuts: list[tuple[int, int]] = []
        for group in np.unique(self.groups):
            start = int((self.groups < group).sum())
            sizes_here = np.sort(self.sizes[self.groups == group])
            end = start + len(sizes_here)
            pairs = np.zeros(end + 1, dtype=np.int64)
            pairs[start + 1 :] = np.cumsum(sizes_here.astype(np.int64) ** 2)
            while start < end:  # a scene with more than ``max_pairs`` pairs stands alone
                most = int(np.searchsorted(pairs, pairs[start] + max_pairs, side="right")) - 1
                stop = min(max(most, start + 1), start + batch_size, end)
                self.cuts.append((start, stop))
                start = stop

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch; Lightning calls this."""
        self.epoch = epoch

    def __len__(self) -> int:
        """Return the number of batches, the same in every epoch and for every rank."""
        return -(-len(self.cuts) // self.replicas)

    def __iter__(self) -> Iterator[Draw]:
        """Yield the batches of the current epoch."""
        random = np.random.default_rng((self.seed, self.epoch if self.shuffle else 0))
        tie = random.permutation(len(self.sizes)) if self.shuffle else np.arange(len(self.sizes))
        order = np.lexsort((tie, self.sizes, self.groups))
        batches = random.permutation(len(self.cuts)) if self.shuffle else np.arange(len(self.cuts))
        seeds = random.integers(2**62, size=len(self.cuts))
        for i in np.resize(batches, len(self) * self.replicas)[self.rank :: self.replicas]:
            start, stop = self.cuts[i]
            yield Draw(torch.from_numpy(order[start:stop]), int(seeds[i]))


class _Batches(Dataset[TensorDict]):
    """Turns a sampler's draws into scene batches."""

    def __init__(self, scenes: SceneSet, goal: GoalProtocol, rotate: bool, mirror: bool) -> None:
        self.scenes, self.rotate, self.mirror = scenes, rotate, mirror
        self.goal: GoalProtocol = goal

    def __getitem__(self, draw: Draw) -> TensorDict:
        generator = torch.Generator().manual_seed(draw.seed)
        if not (self.rotate or self.mirror):
            return self.scenes.batch(draw.scenes, self.goal, generator=generator)
        first = self.scenes.rows[self.scenes.offsets[draw.scenes], self.scenes.obs_len - 1]
        pose = augmentation(self.scenes.xy[first], self.rotate, self.mirror, generator)
        return self.scenes.batch(draw.scenes, self.goal, pose, generator)


def _as_it_is(batch: Any) -> Any:
    return batch


@rank_zero_only
def _print_counts(what: str, scenes: SceneSet) -> None:
    # a wrong clock or unit shows in the speed: people walk at about 1.3 m/s
    speed = float(scenes.speeds().median())
    total = sum((counts for _, counts in scenes.counts), WindowCounts())
    print(f"{what}: {total}; median speed {speed:.2f} m/s")
    empty = [name for name, counts in scenes.counts if not counts.windows]
    if empty:
        print(f"{what}: no window in {', '.join(empty)}")
