"""Excerpts of recorded crowds: all people of some seconds, with those who come and go meanwhile."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from pedzoo.core.geometry import identity_pose, move_to_scene
from pedzoo.core.types import GOAL_RADIUS, OBS_LEN, STEP_SECONDS
from pedzoo.data.tracks import Tracks
from pedzoo.maps.planning.planner import Planner
from pedzoo.sim.recorded_people import LONGEST, people_of
from pedzoo.sim.scenario import SLOWEST


class RecordedCrowd(NamedTuple):
    """A recording of P people in F frames of 0.4 s.

    Attributes:
        xy: Positions (P, F, 2), metres; 0 where a person is not there.
        there: Where one is (P, F) bool.
        first: Frame of the first row (P,) long.
        last: Of the last one (P,) long.
        walks: Which people a policy can take over (P,) bool.
        start: Where they are then (P, 2), metres.
        exit: Where they are last seen (P, 2), metres.
        goal: The exit, or the nearest place that one can walk to (P, 2), metres.
        goal_id: The planner's number of it (P,) long.
        path_length: Of the planner's way from start to goal (P,), metres.
        head: Their first 8 rows (P, 8, 2), metres.
        pref_speed: The speed that they like (P,), m/s.
        group: Number of the company that they walk in (P,) long, -1 for alone, and ...
        grouped: ... the frame that shows it (P,) long, see `pedzoo.sim.recorded_people`.
        map_id: The floor plan, -1 for none.
    """

    xy: Tensor
    there: Tensor
    first: Tensor
    last: Tensor
    walks: Tensor
    start: Tensor
    exit: Tensor
    goal: Tensor
    goal_id: Tensor
    path_length: Tensor
    head: Tensor
    pref_speed: Tensor
    group: Tensor
    grouped: Tensor
    map_id: int

    @classmethod
    def of(cls, tracks: Tracks, map_id: int, planner: Planner) -> "RecordedCrowd":
        """Return the crowd of tracks that have a row in every frame, on a floor plan, -1 for none."""
        people, rows = people_of([tracks], planner.map_rows(torch.tensor([map_id])).tolist(), planner)
        count = people.last - people.first + 1
        person = torch.arange(len(count)).repeat_interleave(count)
        begin = count.cumsum(0) - count
        frame = torch.arange(len(rows)) - begin[person] + people.first[person]
        xy = rows.new_zeros(len(count), int(people.last.max()) + 1, 2)
        there = torch.zeros(xy.shape[:2], dtype=torch.bool)
        xy[person, frame], there[person, frame] = rows, True
        head = (begin.unsqueeze(1) + torch.arange(OBS_LEN)).minimum((begin + count - 1).unsqueeze(1))
        far = (people.goal - people.start).norm(dim=1) > GOAL_RADIUS
        return cls(
            xy,
            there,
            people.first,
            people.last,
            people.controlled & far,
            people.start.float(),
            people.exit.float(),
            people.goal.float(),
            people.goal_id,
            people.path_length.float(),
            rows[head],
            people.pref_speed,
            people.group,
            people.grouped.minimum(people.last),
            map_id,
        )

    @property
    def frames(self) -> int:
        """F."""
        return self.xy.shape[1]

    def annotated_anew(self, deviation: Tensor, random: torch.Generator) -> "RecordedCrowd":
        """Return the crowd as if its positions had been marked less exactly.

        Goals stay. How people began to walk, and the speed that they like, are those of the new positions.

        Args:
            deviation: Standard deviation of each person's white noise (P,), metres.
            random: Draws it.
        """
        noise = deviation.view(-1, 1, 1) * torch.randn(self.xy.shape, generator=random)
        xy = torch.where(self.there.unsqueeze(2), self.xy + noise, self.xy)
        rows = (self.first.unsqueeze(1) + torch.arange(OBS_LEN)).minimum(self.last.unsqueeze(1))
        head = xy[torch.arange(len(xy)).unsqueeze(1), rows]
        liked = (head.diff(dim=1).norm(dim=2).mean(1) / STEP_SECONDS).clamp_min(SLOWEST)
        pref_speed = torch.where(self.walks & (deviation > 0), liked, self.pref_speed)
        return self._replace(xy=xy, head=head, start=head[:, -1], pref_speed=pref_speed)


class Excerpts(NamedTuple):
    """B excerpts of A people and L frames, in which the first 8 frames are only observed.

    Attributes:
        xy: Recorded positions (B, A, L, 2), metres; 0 where a person is not there.
        there: Where one is (B, A, L) bool.
        taken: Frame in which a policy takes people over (B, A) long; may be before the excerpt.
        last: Frame of their last row (B, A) long.
        walks: Which people a policy moves at all (B, A) bool.
        start: This and what follows (B, A, ...) as of `RecordedCrowd`; ``grouped`` is a frame of the excerpt.
        map_id: Floor plans (B,) long.
        pose: Scene poses (B, 4).
    """

    xy: Tensor
    there: Tensor
    taken: Tensor
    last: Tensor
    walks: Tensor
    start: Tensor
    exit: Tensor
    goal: Tensor
    goal_id: Tensor
    path_length: Tensor
    head: Tensor
    pref_speed: Tensor
    group: Tensor
    grouped: Tensor
    map_id: Tensor
    pose: Tensor

    @property
    def until(self) -> Tensor:
        """Frame in which simulated people are taken out at the latest (B, A) long, as in a replay."""
        return self.taken + LONGEST * (self.last - self.taken)

    def to(self, device: torch.device | str) -> "Excerpts":
        """Return the excerpts on a device."""
        return Excerpts(*(value.to(device) for value in self))

    def repeated(self, times: int) -> "Excerpts":
        """Return the excerpts so many times, one after the other."""
        return Excerpts(*(value.repeat(times, *[1] * (value.dim() - 1)) for value in self))


def excerpts(
    crowd: RecordedCrowd, begin: Sequence[int], steps: int, mirrored: Sequence[bool] = ()
) -> Excerpts:
    """Return the excerpts of 8 + ``steps`` frames that begin at frames ``begin`` (B,) of a recording.

    ``mirrored``: which of them are mirrored, with their floor plans.
    """
    length = OBS_LEN + steps
    frames = torch.tensor(begin).unsqueeze(1) + torch.arange(length)
    inside = (frames >= 0) & (frames < crowd.frames)
    there = crowd.there[:, frames.clamp(0, crowd.frames - 1)] & inside  # (P, B, L)
    listed = [seen.any(1).nonzero()[:, 0] for seen in there.unbind(1)]
    most = max(1, max(map(len, listed)))
    slot = torch.stack([functional.pad(some, (0, most - len(some)), value=-1) for some in listed])
    pad, slot = slot < 0, slot.clamp_min(0)
    scene = torch.arange(len(frames)).unsqueeze(1)
    there = there[slot, scene] & ~pad.unsqueeze(2)
    xy = crowd.xy[slot.unsqueeze(2), frames.clamp(0, crowd.frames - 1).unsqueeze(1)]
    pose = identity_pose(len(frames))
    pose[:, 1] = 1.0 - 2.0 * torch.tensor(mirrored or [False] * len(frames)).float()
    places = torch.cat(
        (
            xy.flatten(1, 2),
            crowd.start[slot],
            crowd.exit[slot],
            crowd.goal[slot],
            crowd.head[slot].flatten(1, 2),
        ),
        1,
    )
    sizes = [most * length, most, most, most, most * OBS_LEN]
    xy, start, exit, goal, head = move_to_scene(places, pose).split(sizes, 1)
    offset = frames[:, :1]
    return Excerpts(
        xy.unflatten(1, (most, length)) * there.unsqueeze(3),
        there,
        crowd.first[slot] + OBS_LEN - 1 - offset,
        crowd.last[slot] - offset,
        crowd.walks[slot] & ~pad,
        start,
        exit,
        goal,
        crowd.goal_id[slot].masked_fill(pad, -1),
        crowd.path_length[slot],
        head.unflatten(1, (most, OBS_LEN)),
        crowd.pref_speed[slot],
        crowd.group[slot].masked_fill(pad, -1),
        crowd.grouped[slot] - offset,
        torch.full((len(frames),), crowd.map_id),
        pose,
    )
