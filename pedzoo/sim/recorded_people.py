"""The people of recordings: when each comes and goes, where to, where they stop, and who walks together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor

from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import GOAL_RADIUS, OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO
from pedzoo.data.tracks import Tracks
from pedzoo.maps.planning.planner import Planner
from pedzoo.sim.state import SLOWEST

LONGEST = 2
"""A person is removed after so many times their recorded duration."""

CONTROLLED, SHORT, STAYED, BLOCKED, NO_WAY, LATER = range(6)
"""Role of a recorded person: taken over by the policy, or played back and why."""

REASONS = ("controlled", "too short", "already at the exit", "exit in a wall", "no path to the exit", "later")

HURRY = 1.4
"""m/s: recorded people who began more slowly get as fast as people who like this speed."""

NEAR, TOGETHER, DRIFT = 1.5, 8, 0.5
"""Companions stay within so many metres for so many steps, in which their relative place changes by less."""

FEWEST = 4
"""Frames that companions are seen together at least: one may come into view after the other."""

STANDS, LEAST = 0.1, 5
"""m/s below which people stand, and steps of 0.4 s: shorter stays are part of walking."""

SpeedOf = Literal["observed", "estimated", "track"]

USUAL, _FREE, _PRIOR = 1.3, 1.0, 3
"""Of estimated speeds: m/s where no person walks freely, metres without others, steps that others count."""


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
        stops: The planner's numbers of up to K goals before the exit (P, K) long, -1 after the last.
        pauses: How long they stand at each (P, K), seconds; 0 for no stop.
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
    stops: Tensor
    pauses: Tensor

    def to(self, device: torch.device | str) -> RecordedPeople:
        """Return the people on a device."""
        return RecordedPeople(*(value.to(device) for value in self))

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
    def goals(self) -> Tensor:
        """All goals in turn (P, K + 2) long, -1 after the last, which is the exit."""
        count = (self.pauses > 0).sum(1, keepdim=True)
        ahead = torch.nn.functional.pad(self.stops, (0, 2), value=-1)
        return ahead.scatter(1, count, self.goal_id.unsqueeze(1))

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
    recordings: Sequence[Tracks], rows: Sequence[int], planner: Planner, stops: bool = False, **options: Any
) -> tuple[RecordedPeople, Tensor]:
    """Return the people of `without_goals`, whose exits are goals of the planner where possible.

    ``rows`` are those of the recordings' floor plans in the planner's bank, -1 for none. With ``stops`` the
    places where people stopped are goals, too; see `stops_of`.
    """
    people, xy = without_goals(recordings, **options)
    for number, row in enumerate(rows):
        people = _with_goals(people, people.recording == number, row, planner)
    return _with_stops(people, recordings, rows, planner) if stops else people, xy


def without_goals(
    recordings: Sequence[Tracks], share: float = 1.0, speed: SpeedOf = "observed"
) -> tuple[RecordedPeople, Tensor]:
    """Return the people of recordings, and all rows of their tracks (N, 2), person after person.

    No path is planned: exits are goals, and none is blocked.

    Args:
        recordings: Tracks with a row in every frame of 0.4 s, the first of which is frame 0.
        share: People who could be taken over later than this share of a recording's time are played back.
        speed: ``observed`` for the mean speed of the first 8 rows, ``track`` for that of all, and
            ``estimated`` for what `_estimated` makes of the first 8.
    """
    people = [_of(number, tracks, share, speed) for number, tracks in enumerate(recordings)]
    xy = torch.cat([torch.from_numpy(tracks.xy) for tracks in recordings]).float()
    return RecordedPeople(*map(torch.cat, zip(*people, strict=True))), xy


def _of(number: int, tracks: Tracks, share: float, speed: SpeedOf) -> RecordedPeople:
    agent, begin, count = np.unique(tracks.agent, return_index=True, return_counts=True)
    end = begin + count - 1
    taken = np.minimum(begin + OBS_LEN - 1, end)
    xy, first, last = (torch.from_numpy(part) for part in (tracks.xy, tracks.frame[begin], tracks.frame[end]))
    walked = np.concatenate(([0.0], np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1).cumsum()))
    measured = taken if speed == "observed" else end
    liked = (walked[measured] - walked[begin]) / (np.maximum(measured - begin, 1) * STEP_SECONDS)
    if speed == "estimated":
        liked = np.maximum(liked, _estimated(tracks, begin, taken))
    what = np.where(tracks.frame[begin] > share * tracks.frame.max(), LATER, CONTROLLED)
    group, grouped = companies(xy, torch.from_numpy(begin), first, last)
    none = torch.zeros(len(agent), 0)
    return RecordedPeople(
        recording=torch.full((len(agent),), number),
        agent=torch.from_numpy(agent),
        first=first,
        last=last,
        what=torch.from_numpy(np.where(count <= OBS_LEN, SHORT, what)),
        start=xy[taken],
        exit=xy[end],
        goal=xy[end],
        goal_id=torch.full((len(agent),), -1),
        path_length=torch.zeros(len(agent), dtype=torch.float64),
        pref_speed=torch.from_numpy(liked).clamp_min(SLOWEST).float(),
        group=group,
        grouped=grouped,
        stops=none.long(),
        pauses=none,
    )


def _estimated(tracks: Tracks, begin: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return the speed that people would like (P,), m/s, from their rows ``begin`` to ``taken`` (P,).

    Free steps are those at whose end no person is within 1 m: in a queue there are none. The estimate is the
    mean of a person's free steps and of 3 steps of the crowd's speed, which is the median of all people's.
    """
    of_person = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, len(tracks))))
    step = np.linalg.norm(np.diff(tracks.xy, axis=0, prepend=tracks.xy[:1]), axis=1) / STEP_SECONDS
    row = np.arange(len(tracks))
    seen = (row > begin[of_person]) & (row <= taken[of_person])
    moments = np.column_stack((tracks.frame * 1e4, tracks.xy))  # people of other moments are far away
    free = seen & (KDTree(moments).query(moments, k=2)[0][:, 1] > _FREE)
    walks = free & (step > STANDS)
    usual = float(np.median(step[walks])) if walks.any() else USUAL
    count = np.bincount(of_person[free], minlength=len(begin))
    own = np.bincount(of_person[free], step[free], len(begin))
    return (own + _PRIOR * usual) / (count + _PRIOR)


def companies(xy: Tensor, begin: Tensor, first: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
    """Return the company of each person (P,) long, -1 for alone, and the frame that shows it (P,) long.

    Two people are companions if they are within 1.5 m of each other in all frames in which both are seen
    and neither has been seen for longer than 8 frames: at least 4 frames. In 7 steps their relative place
    changes by less than 0.5 m, in fewer steps by as much less. Companions of companions are of one company.
    Nothing after the frame in which the policy takes over the first of the two is looked at.

    ``xy`` (N, 2) are the rows of the tracks, metres, person after person, one for each frame; ``begin`` the
    first row of each person, ``first`` and ``last`` the frames of their first and last row (P,) long.
    """
    order = first.argsort(stable=True)
    came, number = first[order], torch.arange(len(first))
    count = torch.searchsorted(came, came + OBS_LEN - FEWEST, right=True) - number - 1
    one = number.repeat_interleave(count)
    other = one + 1 + torch.arange(len(one)) - (count.cumsum(0) - count)[one]
    pair = torch.stack((order[one], order[other]))
    start = first[pair].amax(0)
    end = torch.minimum(last[pair], first[pair] + OBS_LEN - 1).amin(0)
    pair, start, end = (value[..., end - start + 1 >= FEWEST] for value in (pair, start, end))
    frames = (start.unsqueeze(1) + torch.arange(OBS_LEN)).minimum(end.unsqueeze(1))
    places = xy[(begin - first)[pair].unsqueeze(2) + frames]
    apart = places[0] - places[1]
    near = (apart.norm(dim=2) <= NEAR).all(1)
    most = DRIFT / (TOGETHER - 1) * (end - start)
    together = near & ((apart[:, -1] - apart[:, 0]).norm(dim=1) < most)
    pair, end = pair[:, together], end[together]
    links = coo_matrix((torch.ones(pair.shape[1]), pair.numpy()), (len(first), len(first)))
    label = torch.from_numpy(connected_components(links, directed=False)[1]).long()
    seen = torch.full_like(first, torch.iinfo(first.dtype).max)
    seen.scatter_reduce_(0, pair.flatten(), end.repeat(2), "amin")
    return torch.where(torch.bincount(label)[label] > 1, label, -1), seen


def stops_of(tracks: Tracks) -> tuple[Tensor, Tensor, Tensor]:
    """Return who stops (S,) long, where (S, 2), metres, and for how long (S,), seconds, person after person.

    A stop is a run of at least 5 steps, after a person is taken over, in which the mean of three positions
    moves by less than 0.1 m/s. People are numbered in the order of their rows.
    """
    row, xy = np.arange(len(tracks)), tracks.xy
    begin, count = np.unique(tracks.agent, return_index=True, return_counts=True)[1:]
    person = np.repeat(np.arange(len(begin)), count)
    first, last = begin[person], (begin + count)[person] - 1
    coarse = (xy[np.maximum(row - 1, first)] + xy + xy[np.minimum(row + 1, last)]) / 3
    step = np.linalg.norm(np.diff(coarse, axis=0, prepend=coarse[:1]), axis=1) / STEP_SECONDS
    stands = (step < STANDS) & (row > first + OBS_LEN - 1)
    goes_on = stands[1:] & stands[:-1] & (person[1:] == person[:-1])
    opens = np.flatnonzero(stands & ~np.append(False, goes_on))
    closes = np.flatnonzero(stands & ~np.append(goes_on, False)) + 1
    opens, closes = opens[closes - opens >= LEAST], closes[closes - opens >= LEAST]
    sums, steps = np.append(np.zeros((1, 2)), xy.cumsum(0), axis=0), torch.from_numpy(closes - opens)
    place = torch.from_numpy(sums[closes] - sums[opens]) / steps.unsqueeze(1)
    return torch.from_numpy(person[opens]), place.float(), steps.double().mul(STEP_SECONDS).float()


def _with_goals(people: RecordedPeople, mine: Tensor, row: int, planner: Planner) -> RecordedPeople:
    """Return the people; those of one recording, ``mine`` (P,) bool, have goals where possible."""
    gone = people.removal[mine & people.controlled]
    if not len(gone):
        return people
    mine = mine & (people.first < gone.max())  # others are never seen
    goal, goal_id, blocked = people.goal.clone(), people.goal_id.clone(), torch.zeros_like(mine)
    if row >= 0:
        goal[mine], near = _settled(planner, goal[mine], row, "exit")
        blocked[mine] = ~near
    with_goal = mine & ~blocked
    goal_id[with_goal] = planner.add_goals(row, goal[with_goal])
    path_length = people.path_length.float()
    path_length[mine] = _ways(planner, people.start[mine].float(), goal_id[mine], row)
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


def _with_stops(
    people: RecordedPeople, recordings: Sequence[Tracks], rows: Sequence[int], planner: Planner
) -> RecordedPeople:
    """Return the people with stops as goals, and the lengths of their ways along all of them.

    Places near walls move as exits do; stops that are too near, or that no path leads to, are left out.
    """
    start, length, found = people.start.float(), people.path_length.clone(), []
    for number, (tracks, row) in enumerate(zip(recordings, rows, strict=True)):
        person, place, pause = stops_of(tracks)
        person = (people.recording == number).nonzero()[:, 0][person]
        kept = people.controlled[person]
        if row >= 0:
            place[kept], near = _settled(planner, place[kept], row, "stop")
            kept[kept.clone()] = near
        person, place, pause = person[kept], place[kept], pause[kept]
        goal = planner.add_goals(row, place)
        kept = _ways(planner, start[person], goal, row).isfinite()
        person, place, pause, goal = person[kept], place[kept], pause[kept], goal[kept]
        begins = torch.ones_like(kept[kept])
        begins[1:] = person[1:] != person[:-1]
        after = torch.where(begins.roll(-1), people.goal_id[person], goal.roll(-1))
        legs = torch.zeros(len(length)).index_add(0, person, _ways(planner, place, after, row))
        legs[person[begins]] += _ways(planner, start[person[begins]], goal[begins], row)
        length = torch.where(legs > 0, legs.to(length), length)
        found.append((person, pause, goal))
    person, pause, goal = map(torch.cat, zip(*found, strict=True))
    slot = torch.arange(len(person)) - torch.searchsorted(person, person)
    stops = people.stops.new_full((len(length), int(slot.max()) + 1 if len(slot) else 0), -1)
    pauses = torch.zeros(stops.shape)
    stops[person, slot], pauses[person, slot] = goal, pause
    return people._replace(path_length=length, stops=stops, pauses=pauses)


def _settled(planner: Planner, place: Tensor, row: int, name: str) -> tuple[Tensor, Tensor]:
    """Return places (N, 2) moved to where ways may lead, and which of them are near enough (N,) bool.

    Those that are too far stay as they were.
    """
    moved = torch.from_numpy(planner.graph(row).settle(place.numpy(), torch.inf, name)[1]).to(place)
    near = (moved - place).norm(dim=1) <= planner.snap
    return moved.where(near.unsqueeze(1), place), near


def _ways(planner: Planner, begin: Tensor, goal: Tensor, row: int) -> Tensor:
    """Return the lengths (N,) of ways on a recording's floor plan to goals (N,) long, metres."""
    map_id = torch.full((len(begin),), planner.bank.grids[row].map_id if row >= 0 else -1)
    return planner.next_waypoints(begin, goal, map_id, identity_pose(len(begin))).distance
