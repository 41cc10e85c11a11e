"""All windows of a split as tensors, and the scene batch of any of them."""

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core import geometry
from pedzoo.core.batch import scene_batch
from pedzoo.core.types import STEP_SECONDS, GoalProtocol
from pedzoo.data.goals import recorded_goals
from pedzoo.data.recordings import Recording, Scene
from pedzoo.data.windows import KeptPeople, cut_windows, why_empty
from pedzoo.maps.bank import MapBank

POSITIONS, DIRECTIONS = {"history", "future", "goal"}, {"velocity", "desired_velocity"}
"""The keys that a scene pose moves, and those that it only turns."""


class SceneSet:
    """The windows of some recordings, tensorised once.

    Attributes:
        xy: Positions (N, 2) float32 of all recordings.
        rows: Rows of ``xy`` (W, L) int32 for each person of each window, -1 where they are not seen.
        end: Row of the last recorded position (W,) int32 of that person.
        offsets: Where each scene's people start in ``rows`` (S + 1,).
        map_id: Floor plan of each scene (S,), -1 for none.
        maps: The bank of these floor plans.
        recording: Number of the recording that each scene is of (S,).
        counts: Each recording's name, and its kept and dropped windows and people.
    """

    def __init__(
        self,
        recordings: Sequence[Recording | Scene],
        map_ids: Sequence[int],
        maps: MapBank,
        obs_len: int,
        pred_len: int,
        people: KeptPeople = "complete",
        min_people: int = 2,
    ) -> None:
        """Cut the windows of all recordings, see `cut_windows`; ``map_ids`` are -1 without a floor plan.

        Raises:
            UserError: No recording gives a single window.
        """
        self.obs_len, self.pred_len, self.maps = obs_len, pred_len, maps
        cut = [cut_windows(r.tracks, obs_len, pred_len, people, min_people) for r in recordings]
        if not any(windows.counts.windows for windows in cut):
            raise why_empty([r.tracks for r in recordings], obs_len, pred_len, people, min_people)
        self.counts = [(r.tracks.name, w.counts) for r, w in zip(recordings, cut, strict=True)]
        # all recordings in one table: row numbers move up by the rows and people before
        rows_before = np.cumsum([0] + [len(r.tracks) for r in recordings], dtype=np.int32)
        people_before = np.cumsum([0] + [len(w.rows) for w in cut])
        rows = [np.where(w.rows >= 0, w.rows + n, -1) for w, n in zip(cut, rows_before, strict=False)]
        end = [w.end + n for w, n in zip(cut, rows_before, strict=False)]
        offsets = [w.offsets[:-1] + n for w, n in zip(cut, people_before, strict=False)]
        self.xy = torch.from_numpy(np.concatenate([r.tracks.xy for r in recordings])).float()
        self.rows = torch.from_numpy(np.concatenate(rows))
        self.end = torch.from_numpy(np.concatenate(end))
        self.offsets = torch.from_numpy(np.concatenate([*offsets, people_before[-1:]]))
        windows = torch.tensor([w.counts.windows for w in cut])
        self.map_id = torch.repeat_interleave(torch.tensor(list(map_ids)), windows)
        self.recording = torch.repeat_interleave(torch.arange(len(windows)), windows)

    def __len__(self) -> int:
        """Return the number of scenes S."""
        return len(self.map_id)

    @property
    def sizes(self) -> Tensor:
        """People in each scene (S,)."""
        return self.offsets.diff()

    def speeds(self) -> Tensor:
        """Return the current speed (W,) of each person of each window, m/s."""
        before, last = self.rows[:, self.obs_len - 2 : self.obs_len].long().unbind(1)
        return (self.xy[last] - self.xy[before]).norm(dim=1) / STEP_SECONDS

    def batch(
        self,
        scenes: Tensor,
        goal: GoalProtocol = "none",
        pose: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> TensorDict:
        """Return the scene batch of the scenes numbered ``scenes`` (B,), see `pedzoo.core.batch`.

        The goal protocol ``none`` leaves ``goal`` and ``desired_velocity`` out. ``pose`` (B, 4) are scene
        poses as `augmentation` draws them; ``generator`` draws the later points of ``random_future``.
        """
        sizes = self.offsets[scenes + 1] - self.offsets[scenes]
        slot = torch.arange(int(sizes.max()))
        mask = slot < sizes.unsqueeze(1)
        person = (self.offsets[scenes].unsqueeze(1) + slot).where(mask, self.offsets[scenes].unsqueeze(1))
        rows = self.rows[person].long()  # (B, A, L)
        seen = (rows >= 0) & mask.unsqueeze(2)
        last = rows[..., self.obs_len - 1]
        xy = _filled(self.xy, rows, self.obs_len)
        history, future = xy.split((self.obs_len, self.pred_len), dim=2)
        valid, future_valid = seen.split((self.obs_len, self.pred_len), dim=2)
        agents = {"history": history, "valid": valid, "future": future, "future_valid": future_valid}
        agents["velocity"] = (history[..., -1, :] - history[..., -2, :]) / STEP_SECONDS
        agents["pref_speed"] = _mean_speed(history, valid)
        if goal != "none":
            target = recorded_goals(goal, self.xy, last, self.end[person].long(), xy[..., -1, :], generator)
            to_goal = target - history[..., -1, :]
            agents["goal"] = target
            agents["desired_velocity"] = agents["pref_speed"] * torch.nn.functional.normalize(to_goal, dim=-1)
        if pose is None:
            pose = geometry.identity_pose(len(scenes))
        else:
            agents |= {key: geometry.move_to_scene(agents[key], pose) for key in POSITIONS & agents.keys()}
            agents |= {key: geometry.turn_to_scene(agents[key], pose) for key in DIRECTIONS & agents.keys()}
        return scene_batch(
            maps=self.maps, map_id=self.map_id[scenes].unsqueeze(1), pose=pose, mask=mask, **agents
        )


def augmentation(
    centres: Tensor, rotate: bool, mirror: bool, generator: torch.Generator | None = None
) -> Tensor:
    """Draw scene poses (B, 4): turns about centres (B, 2), and a mirror image for half of them."""
    scenes = len(centres)
    pose = geometry.identity_pose(scenes)
    if rotate:
        pose[:, 0] = torch.rand(scenes, generator=generator) * 2 * torch.pi
    if mirror:
        pose[:, 1] = torch.randint(2, (scenes,), generator=generator) * 2.0 - 1.0
    pose[:, 2:] = centres - geometry.turn_to_scene(centres, pose)
    return pose


def _filled(xy: Tensor, rows: Tensor, obs_len: int) -> Tensor:
    """Return positions (B, A, L, 2): the latest known at each step, before the first sighting the first."""
    if bool((rows >= 0).all()):
        return xy[rows]
    steps = torch.arange(rows.shape[-1])
    known = rows >= 0
    latest = torch.where(known, steps, -1).cummax(-1).values
    # all people are seen at the last observed step, so the first sighting is there at the latest
    first = torch.where(known, steps, obs_len - 1).amin(-1, keepdim=True)
    step = torch.where(latest >= 0, latest, first)
    return xy[rows.gather(-1, step)]


def _mean_speed(history: Tensor, valid: Tensor) -> Tensor:
    both = (valid[..., 1:] & valid[..., :-1]).to(history.dtype)
    walked = (history.diff(dim=2).norm(dim=-1) * both).sum(-1, keepdim=True)
    return walked / (both.sum(-1, keepdim=True).clamp(min=1) * STEP_SECONDS)
