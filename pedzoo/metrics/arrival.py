"""Whether and when people arrive, and by which way.

Pure functions over the 0.1 s trace of closed-loop episodes, and the metrics made of them. E episodes of A
people (padded), T trace points; point t is the end of the t-th 0.1 s after the warm start. Functions take
what `pedzoo.sim.rollout.Rollout` holds under the same names.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool1d

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics.contacts import begins, untouched
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, of_sums, once, ratio, share
from pedzoo.sim.rollout import Rollout

STILL_POINTS, STILL_METRES, AWAY = round(5.0 / TRACE_SECONDS), 0.1, 0.5
"""Trace points (5 s), metres in them, and metres to the goal: less movement, farther away, is a deadlock."""


def arrived_in_time(reached: Tensor, goals: int, late: Tensor, failed: Tensor, mask: Tensor) -> Tensor:
    """Return which people have reached all goals in time (E, A) bool; none in an episode that failed."""
    return (reached[..., -1] >= goals) & ~late & ~failed.unsqueeze(1) & mask


def finish_seconds(reached: Tensor, goals: int) -> Tensor:
    """Return when each person had reached all goals (E, A), seconds, infinite where they never had."""
    missing = (reached < goals).sum(-1)
    seconds = (missing + 1).double() * TRACE_SECONDS
    return torch.where(missing < reached.shape[-1], seconds, torch.inf)


def episode_seconds(seconds: Tensor, success: Tensor, mask: Tensor) -> Tensor:
    """Return when the last person had finished (E,), seconds; infinite unless all had in time."""
    all_in_time = (success | ~mask).all(1)
    last = seconds.masked_fill(~mask, 0.0).amax(1)
    return torch.where(all_in_time, last, torch.inf)


def seconds_per_goal(seconds: Tensor, reached: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return the time that all people of an episode walked (E,), seconds, and the goals they reached (E,).

    0 and 0 unless all finished in time, after ``seconds`` (E,), see `episode_seconds`. People who finish
    early walk on to further goals: their time and those goals count.
    """
    known = seconds.isfinite()
    goals = reached[..., -1].where(mask, 0).sum(1)
    return (seconds * mask.sum(1)).where(known, 0.0), goals.where(known, 0)


def planned_metres(planned: Tensor, reached: Tensor, goals: int) -> Tensor:
    """Return the length of the planner's paths of all goals that each person had to reach (E, A), metres.

    ``planned`` (E, A, T): all until the one being walked to. People who never reached all goals have theirs
    until the goal they had at the end.
    """
    last = (reached < goals).sum(-1, keepdim=True).clamp_max(reached.shape[-1] - 1)
    return planned.gather(2, last).squeeze(2)


def walked_metres(path: Tensor, scored: Tensor, reached: Tensor, goals: int) -> Tensor:
    """Return how far each person walked until they had reached all goals (E, A), metres."""
    until = reached[..., :-1] < goals  # the step in which the last goal is reached counts
    counts = torch.cat((torch.ones_like(scored[..., :1]), until), dim=2) & scored
    return path.diff(dim=2).norm(dim=-1).where(counts, 0.0).sum(2)


def weighted(success: Tensor, least: Tensor, taken: Tensor) -> Tensor:
    """Return each person's success weighted by effort (E, A): ``S * least / max(least, taken)``.

    With lengths of the planned and of the walked path this is SPL (Anderson et al., "On evaluation of
    embodied navigation agents", 2018, arXiv 1807.06757). With times it is STL: iGibson takes ORCA's time as
    the least, pedzoo that of the planned path at the preferred speed.
    """
    most = torch.maximum(least, taken)
    return torch.where(most > 0, least / most, 1.0).where(success, 0.0)


def fewest_goals(reached: Tensor, mask: Tensor) -> Tensor:
    """Return how many goals the person with the fewest reached in each episode (E,) long."""
    last = reached[..., -1]
    return last.masked_fill(~mask, int(last.max())).amin(1)


def most_goals(reached: Tensor, mask: Tensor) -> Tensor:
    """Return how many goals the person with the most reached in each episode (E,) long."""
    return reached[..., -1].masked_fill(~mask, 0).amax(1)


def deadlocked(trace: Tensor, goal: Tensor, scored: Tensor) -> Tensor:
    """Return which people once stayed within 0.1 m for 5 s, more than 0.5 m from the goal (E, A) bool.

    They are ``scored`` all of the 5 s, and do not come back to a place within them. Current goals: (E, A, T,
    2), metres; people are away from theirs when the 5 s begin, too, so that waiting at a goal is no deadlock.
    """
    return stuck(trace, goal, scored).any(-1)


def stuck(trace: Tensor, goal: Tensor, scored: Tensor) -> Tensor:
    """Return at which points 5 s end that make a person `deadlocked` (E, A, T) bool; same arguments."""
    result = torch.zeros_like(scored)
    if trace.shape[2] <= STILL_POINTS:
        return result
    before, after = trace[:, :, :-STILL_POINTS], trace[:, :, STILL_POINTS:]
    still = (after - before).norm(dim=-1) < STILL_METRES
    away = (trace - goal).norm(dim=-1) > AWAY
    away = away[..., :-STILL_POINTS] & away[..., STILL_POINTS:]
    count = scored.cumsum(2)
    stayed = count[..., STILL_POINTS:] - count[..., :-STILL_POINTS] == STILL_POINTS
    result[:, :, STILL_POINTS:] = still & away & stayed
    episode, agent = result.any(-1).nonzero(as_tuple=True)
    if len(episode):  # few: the person may have been elsewhere between now and 5 s ago
        place = trace[episode, agent].transpose(1, 2)
        most, least = (max_pool1d(side, STILL_POINTS + 1, stride=1) for side in (place, -place))
        extent = most + least
        result[episode, agent, STILL_POINTS:] &= extent.norm(dim=1) < STILL_METRES
    return result


class ScoredSpans(NamedTuple):
    """When people are scored who come and go: it makes values of persons of values of slots.

    In a replay a slot has one person after the other, each scored without a gap until they leave. Run r of R
    is the r-th such time of a slot. Where a slot has fewer, the last ones are empty.

    Attributes:
        number: Which run each point is in (E, A, T) long, 0 for points that are in none, runs from 1 on.
        count: R.
    """

    number: Tensor
    count: int

    @classmethod
    def of(cls, scored: Tensor) -> ScoredSpans:
        """Find the runs of people who are ``scored`` (E, A, T) bool."""
        number = begins(scored).cumsum(2)
        return cls(number.where(scored, 0), int(number.max()) if number.numel() else 0)

    @property
    def there(self) -> Tensor:
        """Which runs there are (E, A, R) bool."""
        return self.sums(torch.ones_like(self.number)) > 0

    def sums(self, value: Tensor) -> Tensor:
        """Return the sums over each run's points (E, A, R) of values at every point (E, A, T)."""
        result = value.new_zeros(*value.shape[:2], self.count + 1)
        return result.scatter_add_(2, self.number, value)[..., 1:]

    def any(self, value: Tensor) -> Tensor:
        """Return in which runs (E, A, R) something is true at any point (E, A, T)."""
        return self.sums(value.long()) > 0

    def last(self, value: Tensor) -> Tensor:
        """Return the value (E, A, T) at the last point of each run (E, A, R)."""
        after = torch.cat((self.number[..., 1:], torch.zeros_like(self.number[..., :1])), dim=2)
        return self.sums(value.where(self.number != after, 0))


class _Walks(NamedTuple):
    """Times and paths of people to all goals; (E, A) each, or (E, A, R) for the R runs of a replay's slots.

    Attributes:
        there: Which people are counted: not those who stay where the episode begins.
        arrived: Which of them arrived in time.
        planned: Length of the planner's paths, metres.
        walked: Length of the path that they walked, metres.
        needed: Seconds of free walking, each planned path at the preferred speed. Not of replays.
        taken: Seconds until they arrived, infinite for people who did not. Not of replays.
    """

    there: Tensor
    arrived: Tensor
    planned: Tensor
    walked: Tensor
    needed: Tensor
    taken: Tensor


@once
def _walks(rollout: Rollout) -> _Walks:
    if rollout.replayed:
        runs = ScoredSpans.of(rollout.scored)
        arrived = runs.there & (runs.last(rollout.reached) >= rollout.goals)
        steps = rollout.path.diff(dim=2).norm(dim=-1).where(rollout.underway, 0.0)
        planned, walked, none = runs.last(rollout.planned), runs.sums(steps), torch.empty(0)
        return _Walks(runs.there, arrived & ~rollout.failed[:, None, None], planned, walked, none, none)
    reached, goals = rollout.reached, rollout.goals
    mask = rollout.mask & ((reached[..., 0] < goals) | (rollout.planned[..., -1] > 0))
    arrived = arrived_in_time(reached, goals, rollout.overdue, rollout.failed, mask)
    planned = planned_metres(rollout.planned, reached, goals)
    walked = walked_metres(rollout.path, rollout.scored, reached, goals)
    seconds = finish_seconds(reached, goals)
    return _Walks(mask, arrived, planned, walked, planned / rollout.pref_speed, seconds - rollout.stood)


@metric()
def success(rollout: Rollout) -> Ratio:
    """Share of people who reach all goals in time: max(20 s, 4 x the path's time) each.

    In a replay: their real exit in twice the real time.
    """
    walks = _walks(rollout)
    return share(walks.arrived, walks.there)


@metric("ordinary")
def episode_success(rollout: Rollout) -> Ratio:
    """Share of episodes in which all people succeed."""
    return share(_all_arrive(rollout))


@metric("ordinary")
def clean(rollout: Rollout) -> Ratio:
    """Share of episodes in which all people succeed, without any contact with people or walls."""
    return share(_all_arrive(rollout) & untouched(rollout))


def _all_arrive(rollout: Rollout) -> Tensor:
    return (_walks(rollout).arrived | ~_walks(rollout).there).all(1) & ~rollout.failed


@metric()
def failed(rollout: Rollout) -> Ratio:
    """Share of episodes in which the policy gave no number."""
    return share(rollout.failed)


@metric()
def deadlock(rollout: Rollout) -> Ratio:
    """Share of people who once stayed within 0.1 m for 5 s, more than 0.5 m from their goal."""
    where = rollout.trace, rollout.goal, rollout.scored
    if rollout.replayed:
        return share(ScoredSpans.of(rollout.scored).any(stuck(*where)), _walks(rollout).there)
    return share(deadlocked(*where), rollout.mask)


@metric("ordinary")
def goals_per_person(rollout: Rollout) -> Ratio:
    """Goals that a person reaches until all are finished."""
    return ratio(rollout.reached[..., -1].where(rollout.mask, 0), rollout.mask)


@metric("ordinary")
def goals_per_person_min(rollout: Rollout) -> Ratio:
    """Goals of an episode's person with the fewest."""
    return ratio(fewest_goals(rollout.reached, rollout.mask))


@metric("ordinary")
def goals_per_person_max(rollout: Rollout) -> Ratio:
    """Goals of an episode's person with the most."""
    return ratio(most_goals(rollout.reached, rollout.mask))


@metric("ordinary")
def goals_parity(rollout: Rollout) -> Ratio:
    """Fewest goals divided by most, mean over episodes in which a goal is reached."""
    most = most_goals(rollout.reached, rollout.mask)
    fewest = fewest_goals(rollout.reached, rollout.mask)
    return mean(fewest.double() / most.clamp_min(1), most > 0)


def _episode_seconds(rollout: Rollout) -> Tensor:
    seconds = finish_seconds(rollout.reached, rollout.goals)
    return episode_seconds(seconds, _walks(rollout).arrived, _walks(rollout).there)


@metric("ordinary")
def time_s(rollout: Rollout) -> Ratio:
    """When the last person arrives, mean over episodes in which all do in time."""
    return finite(_episode_seconds(rollout))


@metric("ordinary")
def decisions(rollout: Rollout) -> Ratio:
    """`time_s` in decisions of the policy."""
    return finite((_episode_seconds(rollout) / rollout.decision_dt - 1e-6).ceil())


@metric("ordinary")
def time_ratio(rollout: Rollout) -> Ratio:
    """Time of all people who arrive, divided by that of free walking.

    Free walking follows the planner's paths at the preferred speeds. Short paths count little.
    """
    walks = _walks(rollout)
    return of_sums(walks.taken, walks.needed, walks.arrived)


@metric()
def path_ratio(rollout: Rollout) -> Ratio:
    """Path length of all people who arrive, divided by that of the planner's paths.

    A policy that decides rarely walks on after a goal until its next decision: that counts as walked.
    """
    walks = _walks(rollout)
    return of_sums(walks.walked, walks.planned, walks.arrived)


@metric()
def spl(rollout: Rollout) -> Ratio:
    """Success weighted by path length, mean over people.

    See `weighted`.
    """
    walks = _walks(rollout)
    return ratio(weighted(walks.arrived, walks.planned, walks.walked), walks.there)


@metric("ordinary")
def stl(rollout: Rollout) -> Ratio:
    """Success weighted by time, mean over people.

    See `weighted`.
    """
    walks = _walks(rollout)
    return ratio(weighted(walks.arrived, walks.needed, walks.taken), walks.there)


def time_ratios(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return each person's time divided by that of free walking (E, A), and where it is known.

    It is known of people who arrive in time. Time before they set out does not count.
    """
    walks = _walks(rollout)
    return walks.taken * rollout.pref_speed / walks.planned, walks.arrived & (walks.planned > 0)
