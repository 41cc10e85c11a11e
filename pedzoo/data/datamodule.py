"""The LightningDataModule: one fold of recordings as scene batches."""

from __future__ import annotations

from typing import cast

import lightning as L
import torch
from lightning.pytorch.utilities import rank_zero_only
from tensordict import TensorDict
from torch.utils.data import DataLoader, Dataset

from pedzoo.data.own_files import OwnFiles
from pedzoo.data.recordings import Recording, Split, open_fold
from pedzoo.data.sampler import BucketSampler, Draw
from pedzoo.data.scenes import SceneSet, augmentation
from pedzoo.data.windows import Counts, People
from pedzoo.errors import UserError
from pedzoo.maps.bank import MapBank
from pedzoo.maps.grid import OccupancyGrid
from pedzoo.types import OBS_LEN, Clock, GoalProtocol


class TrajectoryDataModule(L.LightningDataModule):
    """Recorded people of one fold, as scene batches (see `pedzoo.types`)."""

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
        clock: Clock = "benchmark",
        people: People = "complete",
        min_people: int = 2,
        batch_size: int = 64,
        max_pairs: int = 16384,
        rotate: bool = False,
        mirror: bool = False,
        seed: int = 0,
    ) -> None:
        """Set what `setup` will read.

        Args:
            fold: The test scene (eth, hotel, univ, zara1, zara2), ``embedded``, or ``file.py:Class``.
            root: Folder of the recordings; the environment variable PEDZOO_DATA if not given.
            files: Your own recordings (text or CSV) instead of a fold.
            dt: Seconds between consecutive frame numbers of ``files``.
            split: Shares of the recorded time of ``files`` for train, val and test.
            map: ROS yaml of the floor plan of ``files``.
            homography: Text file of a 3x3 matrix from the positions in ``files`` to world metres.
            obs_len: Observed steps of 0.4 s.
            pred_len: Predicted steps of 0.4 s.
            goal: What people's ``goal`` is; see `pedzoo.data.goals`.
            clock: ``benchmark`` takes every annotated step as 0.4 s, ``true`` resamples to real 0.4 s.
            people: ``complete`` keeps people seen in the whole window, ``present`` also partly seen ones.
            min_people: Windows with fewer people are dropped.
            batch_size: Scenes in a batch, at most.
            max_pairs: Ordered pairs of people in a batch, at most.
            rotate: Turn training scenes at random.
            mirror: Mirror half of the training scenes.
            seed: Of the order of batches and all augmentation.
        """
        super().__init__()
        self.save_hyperparameters()
        if obs_len < 2 or pred_len < 1:
            raise UserError(f"--data.obs_len {obs_len} --data.pred_len {pred_len}: expected at least 2 and 1")
        if min(batch_size, max_pairs, min_people) < 1:
            raise UserError("--data.batch_size, --data.max_pairs and --data.min_people must be at least 1")
        self.fold = fold if files is None else "files"
        self.obs_len, self.pred_len, self.goal = obs_len, pred_len, cast("GoalProtocol", goal)
        self.source = OwnFiles(files, dt, split, map, homography) if files else open_fold(fold, root, clock)
        self.bank = MapBank([])
        self.sets: dict[Split, SceneSet] = {}

    @property
    def protocol(self) -> dict:
        """What every number made with these data depends on."""
        keys = ("obs_len", "pred_len", "goal", "clock", "people", "min_people")
        return {"fold": self.fold} | {key: self.hparams[key] for key in keys}

    def setup(self, stage: str | None = None) -> None:
        """Read the splits of a Lightning stage (``fit``, ``validate``, ``test``; None for all).

        Raises:
            UserError: A split gives no window.
        """
        wanted: dict[str | None, tuple[Split, ...]] = {
            "fit": ("train", "val"), "validate": ("val",), "test": ("test",), None: ("train", "val", "test")
        }  # fmt: skip
        if all(split in self.sets for split in wanted[stage]):
            return
        recordings = {split: self.source.recordings(split) for split in wanted[stage]}
        plans = {r.plan: None for split in recordings.values() for r in split if r.plan}
        grids = {plan: OccupancyGrid.from_ros_yaml(plan) for plan in plans}
        # recorded people walk where the camera did not see the floor: unknown cells are free here
        self.bank = MapBank(list(grids.values()), unknown="free")
        for split, found in recordings.items():
            self.sets[split] = self._scenes(split, found, grids)

    def _scenes(self, split: Split, recordings: list[Recording], grids: dict) -> SceneSet:
        if not recordings:
            raise UserError(f"the {split} split has no recordings: is --data.split {self.hparams['split']!r} right?")
        ids = [self.bank.id_of(grids[r.plan].name) if r.plan else -1 for r in recordings]
        h = self.hparams
        scenes = SceneSet(recordings, ids, self.obs_len, self.pred_len, cast("People", h["people"]), h["min_people"])
        _print_counts(split, self.fold, scenes)
        return scenes

    def train_dataloader(self) -> DataLoader:
        """Return shuffled, augmented batches."""
        return self._loader("train", shuffle=True)

    def val_dataloader(self) -> DataLoader:
        """Return all validation windows in order."""
        return self._loader("val")

    def test_dataloader(self) -> DataLoader:
        """Return all test windows in order."""
        return self._loader("test")

    def _loader(self, split: Split, shuffle: bool = False) -> DataLoader:
        if split not in self.sets:
            self.setup({"train": "fit", "val": "validate", "test": "test"}[split])
        h, scenes = self.hparams, self.sets[split]
        rank, replicas = (self.trainer.global_rank, self.trainer.world_size) if self.trainer else (0, 1)
        sampler = BucketSampler(
            scenes.sizes, h["batch_size"], h["max_pairs"], shuffle, h["seed"], rank, replicas if shuffle else 1
        )
        batches = _Batches(scenes, self.goal, h["rotate"] and shuffle, h["mirror"] and shuffle)
        return DataLoader(batches, sampler=sampler, batch_size=None, collate_fn=_as_it_is)


class _Batches(Dataset):
    """Turns a sampler's draws into scene batches."""

    def __init__(self, scenes: SceneSet, goal: GoalProtocol, rotate: bool, mirror: bool) -> None:
        self.scenes, self.goal, self.rotate, self.mirror = scenes, goal, rotate, mirror

    def __getitem__(self, draw: Draw) -> TensorDict:
        generator = torch.Generator().manual_seed(draw.seed)
        if not (self.rotate or self.mirror):
            return self.scenes.batch(draw.scenes, self.goal, generator=generator)
        first = self.scenes.rows[self.scenes.offsets[draw.scenes], self.scenes.obs_len - 1]
        pose = augmentation(self.scenes.xy[first], self.rotate, self.mirror, generator)
        return self.scenes.batch(draw.scenes, self.goal, pose, generator)


def _as_it_is(batch: TensorDict) -> TensorDict:
    return batch


@rank_zero_only
def _print_counts(split: str, fold: str, scenes: SceneSet) -> None:
    print(f"{fold} {split}: {sum(scenes.counts.values(), Counts())}")
