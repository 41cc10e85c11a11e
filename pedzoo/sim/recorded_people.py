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
from torch.nn.functional import pad

from pedzoo.core.geometry import identity_pose
from pedzoo.core.types import GOAL_RADIUS, OBS_LEN, STEP_SECONDS, TOP_SPEED_RATIO
from pedzoo.data.tracks import Tracks
from pedzoo.maps.planning.planner import Planner
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

NEAR, TOGETHER, DRIFT = 1.5, 8, 0.5
"""Companions stay within so many metres for so many steps, in which their relative place changes by less."""

FEWEST = 4
"""Frames that companions are seen together at least: one may come into view after the other."""

STANDS, LEAST = 0.1, 5
"""m/s below which people stand, and steps of 0.4 s: shorter stays are part of walking."""

SpeedOf = Literal["observed", "estimated", "track"]

_FREE = 1.0
"""Metres: people without others so near walk as fast as they like."""

_PRIOR = 3
"""Steps for which the speed of others counts beside one's own free steps."""


class Stops(NamedTuple):
    """Up to K stops of each of P people, in order: goals with a pause for those who replay them.

    Attributes:
        place: Where they are (P, K, 2), metres.
        pause: For how long (P, K), seconds; 0 for no stop.
        goal_id: The planner's numbers of the places (P, K) long, -1 for none.
    """

    place: Tensor
    pause: Tensor
    goal_id: Tensor

    @classmethod
    def none(cls, people: int, device: torch.device | str = "cpu") -> Stops:
        """Return those of people who never stop."""
        nothing = torch.zeros(people, 0, device=device)
        return cls(nothing.unsqueeze(2).expand(-1, -1, 2), nothing, nothing.long())

    @classmethod
    def joined(cls, parts: list[Stops]) -> Stops:
        """Return the stops of several recordings, one after the other."""
        most = max(part.pause.shape[1] for part in parts)
        columns = []
        for column, missing in zip(zip(*parts, strict=True), (0.0, 0.0, -1), strict=True):
            sides = [(*(0, 0) * (one.dim() - 2), 0, most - one.shape[1]) for one in column]
            columns.append(torch.cat([pad(*pair, value=missing) for pair in zip(column, sides, strict=True)]))
        return cls(*columns)

    def only(self, which: Tensor) -> Stops:
        """Return the stops for which ``which`` (P, K) bool, those of each person in order from the first."""
        order = (~which).long().argsort(dim=1, stable=True)
        left = which.gather(1, order)
        width = int(left.sum(1).max()) if which.numel() else 0
        order, left = order[:, :width], left[:, :width]
        return Stops(
            self.place.gather(1, order.unsqueeze(2).expand(-1, -1, 2)) * left.unsqueeze(2),
            self.pause.gather(1, order) * left,
            self.goal_id.gather(1, order).where(left, -1),
        )

    def goals(self, exit: Tensor) -> Tensor:
        """Return all goals in turn (P, K + 2) long, -1 after the last, for the numbers of exits (P,)."""
        count = (self.pause > 0).sum(1, keepdim=True)
        return pad(self.goal_id, (0, 2), value=-1).scatter(1, count, exit.unsqueeze(1))


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
        stops: Where they pause on their way, which is nowhere where that was not asked for.
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
    stops: Stops

    def to(self, device: torch.device | str) -> RecordedPeople:
        """Return the people on a device."""
        stops = Stops(*(value.to(device) for value in self.stops))
        return RecordedPeople(*(value.to(device) for value in self[:-1]), stops=stops)

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
    recordings: Sequence[Tracks], rows: Sequence[int], planner: Planner, **options: Any
) -> tuple[RecordedPeople, Tensor]:
    """Return the people of `without_goals`, whose exits and stops are goals of the planner where possible.

    ``rows`` are those of the recordings' floor plans in the planner's bank, -1 for none.
    """
    people, xy = without_goals(recordings, **options)
    for number, row in enumerate(rows):
        people = _with_goals(people, people.recording == number, row, planner)
    return _with_stops(people, rows, planner) if options.get("stops") else people, xy


def without_goals(
    recordings: Sequence[Tracks], share: float = 1.0, speed: SpeedOf = "observed", stops: bool = False
) -> tuple[RecordedPeople, Tensor]:
    """Return the people of recordings, and all rows of their tracks (N, 2), person after person.

    No path is planned: exits are goals, and none is blocked.

    Args:
        recordings: Tracks with a row in every frame of 0.4 s, the first of which is frame 0.
        share: People who could be taken over later than this share of a recording's time are played back.
        speed: ``observed`` for the mean speed of the first 8 rows, ``track`` for that of all, and
            ``estimated`` for what `_estimated` makes of the first 8.
        stops: Whether people have the places where they stopped as goals, too; see `stops_of`.
    """
    per_recording = [_of(number, tracks, share, speed, stops) for number, tracks in enumerate(recordings)]
    *columns, stopped = zip(*per_recording, strict=True)
    people = RecordedPeople(*map(torch.cat, columns), stops=Stops.joined([*stopped]))
    return people, torch.cat([torch.from_numpy(tracks.xy) for tracks in recordings]).float()


def _of(number: int, tracks: Tracks, share: float, speed: SpeedOf, stops: bool) -> RecordedPeople:
    """Return the people of one recording without goals."""
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
    return RecordedPeople(
        torch.full((len(agent),), number),
        torch.from_numpy(agent),
        first,
        last,
        torch.from_numpy(np.where(count <= OBS_LEN, SHORT, what)),
        xy[taken],
        exit=xy[end],
        goal=xy[end],
        goal_id=torch.full((len(agent),), -1),
        path_length=torch.zeros(len(agent), dtype=torch.float64),
        pref_speed=torch.from_numpy(liked).clamp_min(SLOWEST).float(),
        **dict(zip(("group", "grouped"), companies(xy, torch.from_numpy(begin), first, last), strict=True)),
        stops=stops_of(tracks, begin, taken) if stops else Stops.none(len(agent)),
    )


def _estimated(tracks: Tracks, begin: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return the speed that people would like (P,), m/s, from what is seen of them until they are taken over.

    Free steps are those at whose end no person is within 1 m: in a queue there are none. The estimate is the
    mean of a person's free steps and of 3 steps of the crowd's speed, which is the median of all people's.
    ``begin`` and ``taken`` (P,) are people's first rows, and those in which they are taken over.
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


def stops_of(tracks: Tracks, begin: np.ndarray, taken: np.ndarray) -> Stops:
    """Return the stops of people after they are taken over, without numbers of goals.

    A stop is a run of at least 5 steps in which the mean of three positions moves by less than 0.1 m/s.

    ``begin`` and ``taken`` (P,) are people's first rows, and those in which they are taken over.
    """
    row, rows, xy = np.arange(len(tracks)), len(tracks), tracks.xy
    person = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, rows)))
    first, last = begin[person], np.append(begin[1:], rows)[person] - 1
    coarse = (xy[np.maximum(row - 1, first)] + xy + xy[np.minimum(row + 1, last)]) / 3
    step = np.linalg.norm(np.diff(coarse, axis=0, prepend=coarse[:1]), axis=1) / STEP_SECONDS
    stands = (step < STANDS) & (row > taken[person])
    goes_on = stands[1:] & stands[:-1] & (person[1:] == person[:-1])
    opens = np.flatnonzero(stands & ~np.append(False, goes_on))
    closes = np.flatnonzero(stands & ~np.append(goes_on, False))
    long = closes - opens + 1 >= LEAST
    opens, closes = opens[long], closes[long]
    sums, steps, of = np.append(np.zeros((1, 2)), xy.cumsum(0), axis=0), closes - opens + 1, person[opens]
    number = np.arange(len(of)) - np.searchsorted(of, of)
    place = np.zeros((len(begin), int(number.max(initial=-1)) + 1, 2))
    pause = np.zeros(place.shape[:2])
    place[of, number] = (sums[closes + 1] - sums[opens]) / steps[:, None]
    pause[of, number] = steps * STEP_SECONDS
    ids = torch.full(pause.shape, -1)
    return Stops(torch.from_numpy(place).float(), torch.from_numpy(pause).float(), ids)


def _with_goals(people: RecordedPeople, mine: Tensor, row: int, planner: Planner) -> RecordedPeople:
    """Return the people; those of one recording, ``mine`` (P,) bool, have goals where possible."""
    gone = people.removal[mine & people.controlled]
    if not len(gone):
        return people
    mine = mine & (people.first < gone.max())  # others are never seen
    goal, goal_id, blocked = people.goal.clone(), people.goal_id.clone(), torch.zeros_like(mine)
    if row >= 0:
        moved = torch.from_numpy(planner.graph(row).settle(goal[mine].numpy(), torch.inf, "exit")[1])
        blocked[mine] = (moved - goal[mine]).norm(dim=1) > planner.snap
        goal[mine] = torch.where(blocked[mine].unsqueeze(1), goal[mine], moved)
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


def _with_stops(people: RecordedPeople, rows: Sequence[int], planner: Planner) -> RecordedPeople:
    """Return the people with stops as goals, and the lengths of their ways along all of them.

    Places near walls move as exits do; stops that are too near, or that no path leads to, are left out.
    """
    place, pause, goal_id = people.stops
    place, goal_id = place.clone(), goal_id.clone()
    wanted = (pause > 0) & people.controlled.unsqueeze(1)
    for number, row in enumerate(rows):
        mine = wanted & (people.recording == number).unsqueeze(1)
        if row >= 0 and mine.any():
            moved = torch.from_numpy(planner.graph(row).settle(place[mine].numpy(), torch.inf, "stop")[1])
            wanted[mine] = (moved - place[mine]).norm(dim=1) <= planner.snap
            place[mine] = moved.to(place)
        mine &= wanted
        goal_id[mine] = planner.add_goals(row, place[mine])

    def ways(begin: Tensor, goal: Tensor) -> Tensor:
        length = torch.zeros(goal.shape)
        for number, row in enumerate(rows):
            mine = (goal >= 0) & (people.recording == number).unsqueeze(1)
            length[mine] = _ways(planner, begin[mine], goal[mine], row)
        return length

    start = people.start.float().unsqueeze(1)
    reached = ways(start.expand_as(place), goal_id).isfinite()
    stops = Stops(place, pause, goal_id).only(wanted & reached)
    legs = ways(torch.cat((start, stops.place), 1), stops.goals(people.goal_id)[:, :-1])
    path_length = torch.where(people.controlled, legs.sum(1).to(people.path_length), people.path_length)
    return people._replace(path_length=path_length, stops=stops)


def _ways(planner: Planner, begin: Tensor, goal: Tensor, row: int) -> Tensor:
    """Return the lengths (N,) of ways on a recording's floor plan to goals (N,) long, metres."""
    map_id = torch.full((len(begin),), planner.bank.grids[row].map_id if row >= 0 else -1)
    return planner.next_waypoints(begin, goal, map_id, identity_pose(len(begin))).distance
