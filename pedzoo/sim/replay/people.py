"""The people of recordings: when each comes and goes, where to, and which of them a policy can take over."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import GOAL_RADIUS, OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO
from pedzoo.data.tracks import Tracks
from pedzoo.maps.planning.planner import Planner
from pedzoo.sim.replay.companions import companies
from pedzoo.sim.replay.stops import STANDS, Stops, stops_of
from pedzoo.sim.state import SLOWEST

USUAL = 1.3
"""m/s: what people like where no person is seen to walk freely."""

LONGEST = 2
"""A person is removed after so many times their recorded duration."""

CONTROLLED, SHORT, STAYED, BLOCKED, NO_WAY, LATER = range(6)
"""Role of a recorded person: taken over by the policy, or played back and why."""

REASONS = ("controlled", "too short", "already at the exit", "exit in a wall", "no path to the exit", "later")

HURRY = 1.4
"""m/s: recorded people who began more slowly get as fast as people who like this speed."""

SpeedOf = Literal["observed", "estimated", "track"]

_FREE = 1.0
"""Metres: people without others so near walk as fast as they like."""

_PRIOR = 3
"""Steps for which the speed of others counts beside one's own free steps."""


class RecordedPeople(NamedTuple):
    """P recorded people; row p is ``person`` p of states and rollouts.

    Times of recordings are seconds since their first row, in frames of 0.4 s.

    Attributes:
        recording: Which recording each is in (P,) long.
        agent: The number that they have there (P,) long.
        first: Frame of their first row (P,) long.
        last: Frame of their last one (P,) long.
        what: ``CONTROLLED`` or why they are played back (P,) long, see `REASONS`.
        start: Where they are when the policy takes over (P, 2), metres.
        exit: Where they are last seen (P, 2), metres.
        goal: The goal: the exit, or the nearest place that one can walk to (P, 2), metres.
        goal_id: The planner's number of it (P,) long, -1 for none.
        path_length: Length of the planner's way from start to goal (P,), metres; 0 without a goal.
        pref_speed: The speed that they like (P,), m/s.
        group: Number of the company that they walk in (P,) long, -1 for alone; see `companies`.
        grouped: Frame that shows it (P,) long: nothing later is needed to know it.
        stop_place: See `Stops.place` (P, K, 2), metres.
        stop_pause: See `Stops.pause` (P, K), seconds.
        stop_id: See `Stops.goal_id` (P, K) long.
    """

    recording: Tensor
    agent: Tensor
    first: Tensor
    last: Tensor
    what: Tensor
    start: Tensor
    exit: Tensor
    goal: Tensor
    goal_id: Tensor
    path_length: Tensor
    pref_speed: Tensor
    group: Tensor
    grouped: Tensor
    stop_place: Tensor
    stop_pause: Tensor
    stop_id: Tensor

    @property
    def stops(self) -> Stops:
        """Where people pause on their way, which is nowhere where that was not asked for."""
        return Stops(self.stop_place, self.stop_pause, self.stop_id)

    @property
    def controlled(self) -> Tensor:
        """Which people the policy takes over (P,) bool."""
        return self.what == CONTROLLED

    @property
    def handover(self) -> Tensor:
        """Frame in which the policy takes them over (P,) long."""
        return self.first + OBS_LEN - 1

    @property
    def removal(self) -> Tensor:
        """Frame in which they are gone at the latest (P,) long."""
        longest = self.handover + LONGEST * (self.last - self.handover)
        return torch.where(self.controlled, longest, self.last)

    @property
    def counts(self) -> dict[str, int]:
        """How many people there are of each kind, those that do not occur left out."""
        number = Counter(self.what.tolist())
        return {name: number[what] for what, name in enumerate(REASONS) if number[what]}


def top_speed_of(pref_speed: Tensor) -> Tensor:
    """Return the top speeds (...) of recorded people, m/s, by what is known of the speeds that they like.

    Their first rows say how fast they begin. In the recording `univ` a quarter of all people walk later at
    more than 1.3 times that.
    """
    return TOP_SPEED_RATIO * pref_speed.clamp_min(HURRY)


def people_of(
    recordings: Sequence[Tracks],
    rows: Sequence[int],
    planner: Planner,
    share: float = 1.0,
    speed: SpeedOf = "observed",
    stops: bool = False,
) -> tuple[RecordedPeople, Tensor]:
    """Return the people of recordings, and all rows of their tracks (N, 2), person after person.

    Args:
        recordings: Tracks with a row in every frame of 0.4 s, the first of which is frame 0.
        rows: Row of each recording's floor plan in the planner's bank, -1 for none.
        planner: Finds the paths; exits become its goals.
        share: People who could be taken over later than this share of a recording's time are played back.
        speed: ``observed`` for the mean speed of the first 8 rows, ``track`` for that of all, and
            ``estimated`` for what `_estimated` makes of the first 8.
        stops: Whether people have the places where they stopped as goals, too; see `stops_of`.
    """
    people, xy = without_goals(recordings, share, speed, stops)
    for number, row in enumerate(rows):
        people = _with_goals(people, people.recording == number, row, planner)
    return _with_stops(people, rows, planner) if stops else people, xy


def without_goals(
    recordings: Sequence[Tracks], share: float = 1.0, speed: SpeedOf = "observed", stops: bool = False
) -> tuple[RecordedPeople, Tensor]:
    """Return what `people_of` returns, before any path is planned: exits are goals, and none is blocked."""
    per_recording = [_of(number, tracks, share, speed, stops) for number, tracks in enumerate(recordings)]
    stopped = Stops.joined([people.stops for people in per_recording])
    columns = [torch.cat(parts) for parts in list(zip(*per_recording, strict=True))[: -len(stopped)]]
    people = RecordedPeople(*[*columns, *stopped])
    xy = torch.cat([torch.from_numpy(tracks.xy) for tracks in recordings])
    return people, xy.float()


def _of(number: int, tracks: Tracks, share: float, speed: SpeedOf, stops: bool) -> RecordedPeople:
    """Return the people of one recording without goals."""
    agent, begin, count = np.unique(tracks.agent, return_index=True, return_counts=True)
    end = begin + count - 1
    taken = np.minimum(begin + OBS_LEN - 1, end)
    first, last = tracks.frame[begin], tracks.frame[end]
    walked = np.concatenate(([0.0], np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1).cumsum()))
    measured = taken if speed == "observed" else end
    seconds = np.maximum(measured - begin, 1) * STEP_SECONDS
    liked = (walked[measured] - walked[begin]) / seconds
    if speed == "estimated":
        liked = np.maximum(liked, _estimated(tracks, begin, taken))
    what = np.where(first > share * tracks.frame.max(), LATER, CONTROLLED)
    what = np.where(count <= OBS_LEN, SHORT, what)

    def places(rows: np.ndarray) -> Tensor:
        return torch.from_numpy(tracks.xy[rows])

    xy, starts, entry, leaving = (torch.from_numpy(value) for value in (tracks.xy, begin, first, last))
    group, grouped = companies(xy, starts, entry, leaving)
    return RecordedPeople(
        recording=torch.full((len(agent),), number),
        agent=torch.from_numpy(agent),
        first=entry,
        last=leaving,
        what=torch.from_numpy(what),
        start=places(taken),
        exit=places(end),
        goal=places(end),
        goal_id=torch.full((len(agent),), -1),
        path_length=torch.zeros(len(agent), dtype=torch.float64),
        pref_speed=torch.from_numpy(liked).clamp_min(SLOWEST).float(),
        group=group,
        grouped=grouped,
        **columns_of(stops_of(tracks, begin, taken) if stops else Stops.none(len(agent))),
    )


def columns_of(stops: Stops) -> dict[str, Tensor]:
    """Return stops as columns of `RecordedPeople`."""
    return {"stop_place": stops.place, "stop_pause": stops.pause, "stop_id": stops.goal_id}


def _estimated(tracks: Tracks, begin: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return the speed that people would like (P,), m/s, from what is seen of them until they are taken over.

    Free steps are those at whose end no person is within 1 m: in a queue there are none. The estimate is the
    mean of a person's free steps and of 3 steps of the crowd's speed, which is the median of all people's.

    Args:
        tracks: Rows in every frame of 0.4 s, person after person.
        begin: First row of each person (P,).
        taken: Row in which they are taken over (P,).
    """
    of_person = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, len(tracks))))
    step = np.linalg.norm(np.diff(tracks.xy, axis=0, prepend=tracks.xy[:1]), axis=1) / STEP_SECONDS
    row = np.arange(len(tracks))
    seen = (row > begin[of_person]) & (row <= taken[of_person])
    moments = np.column_stack((tracks.frame * 1e4, tracks.xy))  # people of other moments are far away
    nearest = KDTree(moments).query(moments, k=2)[0][:, 1]
    free = seen & (nearest > _FREE)
    walks = free & (step > STANDS)
    usual = float(np.median(step[walks])) if walks.any() else USUAL
    count = np.bincount(of_person[free], minlength=len(begin))
    own = np.bincount(of_person[free], step[free], len(begin))
    return (own + _PRIOR * usual) / (count + _PRIOR)


def _with_goals(people: RecordedPeople, mine: Tensor, row: int, planner: Planner) -> RecordedPeople:
    """Return the people; those of one recording, ``mine`` (P,) bool, have goals where possible."""
    gone = people.removal[mine & people.controlled]
    if not len(gone):
        return people
    mine = mine & (people.first < gone.max())  # others are never seen
    goal = people.goal.clone()
    blocked = torch.zeros_like(mine)
    if row >= 0:
        moved = torch.from_numpy(planner.graph(row).settle(goal[mine].numpy(), torch.inf, "exit")[1])
        blocked[mine] = (moved - goal[mine]).norm(dim=1) > planner.snap
        goal[mine] = torch.where(blocked[mine].unsqueeze(1), goal[mine], moved)
    with_goal = mine & ~blocked
    goal_id = people.goal_id.clone()
    goal_id[with_goal] = planner.add_goals(row, goal[with_goal])
    start = people.start[mine].float()
    map_id = torch.full((len(start),), planner.bank.grids[row].map_id if row >= 0 else -1)
    path_length = people.path_length.float()
    path_length[mine] = planner.next_waypoints(
        start, goal_id[mine], map_id, identity_pose(len(start))
    ).distance
    lost = path_length.isinf()
    stayed = ((goal - people.start).norm(dim=1) <= GOAL_RADIUS) & ~blocked
    what = people.what
    for reason, which in ((NO_WAY, lost), (STAYED, stayed), (BLOCKED, blocked)):
        what = torch.where(mine & which & (what == CONTROLLED), reason, what)
    return people._replace(
        what=what,
        goal=goal,
        goal_id=torch.where(lost, -1, goal_id),
        path_length=torch.where(lost, 0.0, path_length).to(people.path_length),
    )


def _with_stops(people: RecordedPeople, rows: Sequence[int], planner: Planner) -> RecordedPeople:
    """Return the people with stops as goals, and the lengths of their ways along all of them.

    Places near walls move as exits do; stops that are too near, or that no path leads to, are left out.
    """
    place, goal_id = people.stop_place.clone(), people.stop_id.clone()
    wanted = (people.stop_pause > 0) & people.controlled.unsqueeze(1)
    at = torch.tensor([planner.bank.grids[row].map_id if row >= 0 else -1 for row in rows])
    for number, row in enumerate(rows):
        mine = wanted & (people.recording == number).unsqueeze(1)
        if row >= 0 and mine.any():
            moved = torch.from_numpy(planner.graph(row).settle(place[mine].numpy(), torch.inf, "stop")[1])
            wanted[mine] = (moved - place[mine]).norm(dim=1) <= planner.snap
            place[mine] = moved.to(place)
        mine &= wanted
        goal_id[mine] = planner.add_goals(row, place[mine])

    def ways(begin: Tensor, goal: Tensor) -> Tensor:
        there = goal >= 0
        length = torch.zeros(there.shape)
        begin, maps = begin[there], at[people.recording].unsqueeze(1).expand_as(goal)[there]
        pose = identity_pose(len(begin))
        length[there] = planner.next_waypoints(begin, goal[there], maps, pose).distance
        return length

    start = people.start.float().unsqueeze(1)
    reached = ways(start.expand_as(place), goal_id).isfinite()
    stops = Stops(place, people.stop_pause, goal_id).only(wanted & reached)
    legs = ways(torch.cat((start, stops.place), 1), stops.goals(people.goal_id)[:, :-1])
    path_length = torch.where(people.controlled, legs.sum(1).to(people.path_length), people.path_length)
    return people._replace(path_length=path_length, **columns_of(stops))
