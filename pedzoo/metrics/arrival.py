"""Whether and when people arrive, and by which way: metrics, and functions of the fields of a `Rollout`.

E episodes of A people (padded), T trace points; point t is the end of the t-th 0.1 s after the warm start.
"""

from functools import partial
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


def arrived_in_time(rollout: Rollout) -> Tensor:
    """Return which people have reached all goals in time (E, A) bool; none in an episode that failed."""
    arrived = (rollout.reached[..., -1] >= rollout.goals) & rollout.mask
    return arrived & ~rollout.overdue & ~rollout.failed.unsqueeze(1)


def finish_seconds(reached: Tensor, goals: int) -> Tensor:
    """Return when each person had reached all goals (E, A), seconds, infinite where they never had."""
    missing = (reached < goals).sum(-1)
    seconds = (missing + 1).double() * TRACE_SECONDS
    return torch.where(missing < reached.shape[-1], seconds, torch.inf)


def seconds_per_goal(seconds: Tensor, reached: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Return the time that all people of an episode walked (E,), seconds, and the goals they reached (E,).

    0 and 0 unless all finished in time, after ``seconds`` (E,). Goals beyond the last one count, too.
    """
    known = seconds.isfinite()
    goals = reached[..., -1].where(mask, 0).sum(1)
    return (seconds * mask.sum(1)).where(known, 0.0), goals.where(known, 0)


def planned_metres(planned: Tensor, reached: Tensor, goals: int) -> Tensor:
    """Return the length of the planner's paths of all goals that each person had to reach (E, A), metres.

    ``planned`` (E, A, T) has all until the one being walked to; for people who did not finish, the last one.
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

    With path lengths this is SPL (Anderson et al., "On evaluation of embodied navigation agents", 2018, arXiv
    1807.06757). With times it is STL: iGibson's least time is ORCA's, ours the planned path's.
    """
    most = torch.maximum(least, taken)
    return torch.where(most > 0, least / most, 1.0).where(success, 0.0)


def stuck(trace: Tensor, goal: Tensor, scored: Tensor) -> Tensor:
    """Return where people have stayed within 0.1 m for 5 s, more than 0.5 m from the goal (E, A, T) bool.

    They are ``scored`` and away from their current ``goal`` (E, A, T, 2), metres, when the 5 s begin and end.
    """
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


def over_spans(scored: Tensor, value: Tensor) -> Tensor:
    """Return the sums of values (E, A, T) over each time that a slot is ``scored`` without a gap (E, A, R).

    In a replay a slot has one person after the other: the r-th of R sums is of the r-th one, 0 without.
    """
    number = begins(scored).cumsum(2).where(scored, 0)
    spans = int(number.max()) if number.numel() else 0
    return value.new_zeros(*value.shape[:2], spans + 1).scatter_add_(2, number, value)[..., 1:]


class _Walks(NamedTuple):
    """People's walks to all goals; (E, A) each, or (E, A, R) of the spans of a replay, without seconds."""

    there: Tensor  # not those who stay where the episode begins
    arrived: Tensor
    planned: Tensor  # metres
    walked: Tensor
    needed: Tensor  # seconds at the preferred speed
    taken: Tensor  # infinite for people who did not arrive


@once
def _walks(rollout: Rollout) -> _Walks:
    reached, goals = rollout.reached, rollout.goals
    if rollout.replayed:
        spans = partial(over_spans, rollout.scored)
        ends = begins(rollout.scored.flip(2)).flip(2)
        there = spans(rollout.scored.long()) > 0
        arrived = there & (spans(reached.where(ends, 0)) >= goals) & ~rollout.failed[:, None, None]
        steps = rollout.path.diff(dim=2).norm(dim=-1).where(rollout.underway, 0.0)
        none = torch.empty(0)
        return _Walks(there, arrived, spans(rollout.planned.where(ends, 0)), spans(steps), none, none)
    there = rollout.mask & ((reached[..., 0] < goals) | (rollout.planned[..., -1] > 0))
    planned = planned_metres(rollout.planned, reached, goals)
    walked = walked_metres(rollout.path, rollout.scored, reached, goals)
    taken = finish_seconds(reached, goals) - rollout.stood
    arrived = arrived_in_time(rollout) & there
    return _Walks(there, arrived, planned, walked, planned / rollout.pref_speed, taken)


@metric()
def success(rollout: Rollout) -> Ratio:
    """Share of people who reach all goals in time: max(20 s, 4 x the path's time) each.

    In a replay: their real exit in twice the real time.
    """
    return share(_walks(rollout).arrived, _walks(rollout).there)


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
    still = stuck(rollout.trace, rollout.goal, rollout.scored)
    if rollout.replayed:
        return share(over_spans(rollout.scored, still.long()) > 0, _walks(rollout).there)
    return share(still.any(-1), rollout.mask)


@metric("ordinary")
def goals_per_person(rollout: Rollout) -> Ratio:
    """Goals that a person reaches until all are finished."""
    return ratio(rollout.reached[..., -1].where(rollout.mask, 0), rollout.mask)


def _fewest_and_most(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return the goals of the persons with the fewest and with the most in each episode (E,) long."""
    last, absent = rollout.reached[..., -1], ~rollout.mask
    return last.masked_fill(absent, int(last.max())).amin(1), last.masked_fill(absent, 0).amax(1)


@metric("ordinary")
def goals_per_person_min(rollout: Rollout) -> Ratio:
    """Goals of an episode's person with the fewest."""
    return ratio(_fewest_and_most(rollout)[0])


@metric("ordinary")
def goals_per_person_max(rollout: Rollout) -> Ratio:
    """Goals of an episode's person with the most."""
    return ratio(_fewest_and_most(rollout)[1])


@metric("ordinary")
def goals_parity(rollout: Rollout) -> Ratio:
    """Fewest goals divided by most, mean over episodes in which a goal is reached."""
    fewest, most = _fewest_and_most(rollout)
    return mean(fewest.double() / most.clamp_min(1), most > 0)


def episode_seconds(rollout: Rollout) -> Tensor:
    """Return when the last person had finished (E,), seconds; infinite unless all had in time."""
    walks = _walks(rollout)
    last = finish_seconds(rollout.reached, rollout.goals).masked_fill(~walks.there, 0.0).amax(1)
    return torch.where((walks.arrived | ~walks.there).all(1), last, torch.inf)


@metric("ordinary")
def time_s(rollout: Rollout) -> Ratio:
    """When the last person arrives, mean over episodes in which all do in time."""
    return finite(episode_seconds(rollout))


@metric("ordinary")
def decisions(rollout: Rollout) -> Ratio:
    """`time_s` in decisions of the policy."""
    return finite((episode_seconds(rollout) / rollout.decision_dt - 1e-6).ceil())


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
    """Success weighted by path length, mean over people."""
    walks = _walks(rollout)
    return ratio(weighted(walks.arrived, walks.planned, walks.walked), walks.there)


@metric("ordinary")
def stl(rollout: Rollout) -> Ratio:
    """Success weighted by time, mean over people."""
    walks = _walks(rollout)
    return ratio(weighted(walks.arrived, walks.needed, walks.taken), walks.there)


def time_ratios(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return people's times divided by those of free walking (E, A), and who arrives: it is known of them."""
    walks = _walks(rollout)
    return walks.taken * rollout.pref_speed / walks.planned, walks.arrived & (walks.planned > 0)
