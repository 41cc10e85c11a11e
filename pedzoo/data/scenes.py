"""Windows of recorded people, all of a split as tensors, and the scene batch of any of them.

A window is a run of consecutive *distinct* frames of a file (holes in the frame numbers are not looked at),
one for every frame, cut as Social GAN cuts them or keeping all people.

Goal protocols are a forecaster's knowledge of where people go. ``window_end`` is the answer's own last
position and leaks it: untrained interpolation to it scores FDE 0. It is the paper's Table I.
``destination`` is where the person was last recorded, which is what a planner knows; ``planner`` is the
short-term goal that it gives on the way there, as in simulation. ``random_future`` is any later point of the
same track, for training only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from pedzoo.core import geometry
from pedzoo.core.batch import scene_batch
from pedzoo.core.errors import UserError
from pedzoo.core.types import STEP_SECONDS, GoalProtocol
from pedzoo.data.recordings import Recording, Scene
from pedzoo.data.tracks import Tracks
from pedzoo.maps.bank import MapBank

POSITIONS, DIRECTIONS = {"history", "future", "goal"}, {"velocity", "desired_velocity"}
"""The keys that a scene pose moves, and those that it only turns."""


KeptPeople = Literal["complete", "present"]


@dataclass(frozen=True)
class WindowCounts:
    """Windows and people kept and dropped; each person seen at the last observed step counts once."""

    windows: int = 0  # windows kept
    people: int = 0  # people in them
    dropped_lone: int = 0  # people with too few others beside them
    dropped_partial: int = 0  # people not seen in enough of the window (see `cut_windows`)

    def __add__(self, other: WindowCounts) -> WindowCounts:
        """Return the counts of two recordings together."""
        return WindowCounts(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def __str__(self) -> str:
        """Return the line that every run prints."""
        return (
            f"{self.windows} windows with {self.people} people (counted once per window); left out: "
            f"{self.dropped_partial} seen only in part of a window, {self.dropped_lone} with too few others"
        )


@dataclass(frozen=True)
class Windows:
    """Windows of one recording."""

    # rows of the tracks table (W, L) for each person of each window, -1 where they are not seen
    rows: np.ndarray
    end: np.ndarray  # the last row of that person's track (W,)
    offsets: np.ndarray  # where each window's people start in ``rows`` (S + 1,)
    counts: WindowCounts  # kept and dropped windows and people


def cut_windows(
    tracks: Tracks, obs_len: int, pred_len: int, people: KeptPeople = "complete", min_people: int = 2
) -> Windows:
    """Return all windows of ``obs_len + pred_len`` frames, stride 1, people sorted by number.

    ``complete`` keeps ``people`` seen in all frames of a window (Social GAN), ``present`` those seen in the
    last observed frame and in the one before. A window with fewer than ``min_people`` is dropped.
    """
    length = obs_len + pred_len
    frames, step = np.unique(tracks.frame, return_inverse=True)
    person = np.unique(tracks.agent, return_inverse=True)[1]
    start = step - (obs_len - 1)
    here = np.flatnonzero((start >= 0) & (start + length <= len(frames)))
    if people == "complete":
        # the table is sorted, so L rows of one person that span L steps have none missing
        first, last = here - (obs_len - 1), here + pred_len
        keep = (first >= 0) & (last < len(step))
        first, last = first[keep], last[keep]
        keep[keep] = (person[first] == person[last]) & (step[last] - step[first] == length - 1)
        rows = here[keep, None] + np.arange(-obs_len + 1, pred_len + 1)
    else:
        # key of (person, step): increasing over the table, so one search finds any person's row at any step
        key = person * (step.max(initial=0) + 1 + length) + step
        rows = np.empty((len(here), length), dtype=np.int32)
        for column in range(length):  # one at a time: all at once would take eight times the memory
            wanted = key[here] + column - (obs_len - 1)
            index = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
            rows[:, column] = np.where(key[index] == wanted, index, -1)
        keep = rows[:, obs_len - 2] >= 0
        rows = rows[keep]
    partial = len(here) - int(keep.sum())
    here = here[keep]
    window, size = np.unique(start[here], return_inverse=True, return_counts=True)[1:]
    alone = size[window] < min_people
    here, rows, window = here[~alone], rows[~alone], start[here][~alone]
    order = np.lexsort((person[here], window))
    sizes = np.unique(window, return_counts=True)[1]
    last = np.searchsorted(person, person[here[order]], side="right") - 1
    return Windows(
        rows=rows[order].astype(np.int32, copy=False),
        end=last.astype(np.int32),
        offsets=np.concatenate(([0], np.cumsum(sizes))).astype(np.int64),
        counts=WindowCounts(len(sizes), len(order), int(alone.sum()), partial),
    )


def _why_empty(
    recordings: Sequence[Tracks], obs_len: int, pred_len: int, people: KeptPeople, min_people: int
) -> UserError:
    """Return the error for recordings that give no window, with the reason and the way out."""
    length, steps = obs_len + pred_len, [len(np.unique(tracks.frame)) for tracks in recordings]
    recorded = ", ".join(
        f"{tracks.name!r} ({tracks.people} people, {n} steps)"
        for tracks, n in zip(recordings, steps, strict=True)
    )
    if max(steps) < length:
        return UserError(
            f"a window needs obs_len + pred_len = {obs_len} + {pred_len} = {length} steps, but "
            f"there is only {recorded}: record longer, or lower --data.obs_len or --data.pred_len"
        )
    advice = ["--data.keep_people present keeps partly seen people"] * (people == "complete")
    advice += ["--data.min_people 1 keeps lone people"] * (min_people > 1)
    part = "all" if people == "complete" else "enough"
    return UserError(
        f"no window of {length} steps has {min_people} people who are seen in {part} of it: {recorded}; "
        f"{', '.join(advice) or 'record more'}"
    )


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
        """Cut the windows; ``map_ids`` are -1 without a plan. Raises UserError: there is no window."""
        self.obs_len, self.pred_len, self.maps = obs_len, pred_len, maps
        cut = [cut_windows(r.tracks, obs_len, pred_len, people, min_people) for r in recordings]
        if not any(windows.counts.windows for windows in cut):
            raise _why_empty([r.tracks for r in recordings], obs_len, pred_len, people, min_people)
        self.counts = [(r.tracks.name, w.counts) for r, w in zip(recordings, cut, strict=True)]
        # all recordings in one table: row numbers move up by the rows and people before
        rows, end, offsets, before, people_before = [], [], [], 0, 0
        for recording, window in zip(recordings, cut, strict=True):
            rows.append(np.where(window.rows >= 0, window.rows + np.int32(before), -1))
            end.append(window.end + np.int32(before))
            offsets.append(window.offsets[:-1] + people_before)
            before, people_before = before + len(recording.tracks), people_before + len(window.rows)
        self.xy = torch.from_numpy(np.concatenate([r.tracks.xy for r in recordings])).float()
        self.rows = torch.from_numpy(np.concatenate(rows))
        self.end = torch.from_numpy(np.concatenate(end))
        self.offsets = torch.from_numpy(np.concatenate([*offsets, [people_before]]))
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

    @cached_property
    def planned(self) -> tuple[Tensor, Tensor]:
        """Short-term goals and desired velocities of each person of each window, (W, 2) both.

        They are those of `pedzoo.maps.planning.planner.Planner.guidance` at the last observed position, on
        the way to the destination, ``pred_len`` steps ahead. A destination in a wall or outside the floor
        plan is moved to the nearest free place of the way.
        """
        from pedzoo.maps.planning.planner import Planner

        planner, ends = Planner(self.maps, snap=math.inf), self.xy[self.end.long()].double()
        row = self.maps.index(self.map_id).repeat_interleave(self.sizes)
        goal = torch.empty_like(row)
        for number in row.unique().tolist():
            goal[row == number] = planner.add_goals(number, ends[row == number])
        history = _filled(self.xy, self.rows.long()[:, : self.obs_len], self.obs_len)
        speed = _pref_speed(history, self.rows[:, : self.obs_len] >= 0)
        guidance = planner.guidance(
            history[:, -1:],
            goal.unsqueeze(1),
            row,
            geometry.identity_pose(len(row)),
            speed,
            self.pred_len * STEP_SECONDS,
            float(speed.amax()),
        )
        return guidance.goal[:, 0], guidance.desired_velocity[:, 0]

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
        xy = _filled(self.xy, rows, self.obs_len)
        history, future = xy.split((self.obs_len, self.pred_len), dim=2)
        valid, future_valid = seen.split((self.obs_len, self.pred_len), dim=2)
        agents = {"history": history, "valid": valid, "future": future, "future_valid": future_valid}
        agents["velocity"] = (history[..., -1, :] - history[..., -2, :]) / STEP_SECONDS
        agents["pref_speed"] = _pref_speed(history, valid)
        if goal == "planner":
            planned, desired = self.planned
            agents |= {"goal": planned[person], "desired_velocity": desired[person]}
        elif goal != "none":
            last, end = rows[..., self.obs_len - 1], self.end[person].long()
            if goal == "random_future":
                later = torch.rand(last.shape, generator=generator) * (end - last)
                end = torch.minimum(last + 1 + later.long(), end)
            target = xy[..., -1, :] if goal == "window_end" else self.xy[end]
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


def _pref_speed(history: Tensor, valid: Tensor) -> Tensor:
    """Return the mean observed speed (..., 1), m/s, of positions (..., T, 2) that are ``valid`` (..., T)."""
    both = (valid[..., 1:] & valid[..., :-1]).to(history.dtype)
    walked = (history.diff(dim=-2).norm(dim=-1) * both).sum(-1, keepdim=True)
    return walked / (both.sum(-1, keepdim=True).clamp(min=1) * STEP_SECONDS)


def _filled(xy: Tensor, rows: Tensor, obs_len: int) -> Tensor:
    """Return positions (..., L, 2): the latest known at each step, before the first sighting the first."""
    steps, known = torch.arange(rows.shape[-1]), rows >= 0
    if bool(known.all()):
        return xy[rows]
    latest = torch.where(known, steps, -1).cummax(-1).values
    # all people are seen at the last observed step, so the first sighting is there at the latest
    first = torch.where(known, steps, obs_len - 1).amin(-1, keepdim=True)
    step = torch.where(latest >= 0, latest, first)
    return xy[rows.gather(-1, step)]
