"""Metrics of goals: whether and when people arrive, and by which way."""

from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.metrics import arrival_functions
from pedzoo.metrics.contacts import untouched
from pedzoo.metrics.ratios import Ratio, finite, mean, metric, of_sums, once, ratio, share
from pedzoo.metrics.slots_to_persons import ScoredSpans
from pedzoo.sim.rollout import Rollout


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
    arrived = arrival_functions.arrived_in_time(reached, goals, rollout.overdue, rollout.failed, mask)
    planned = arrival_functions.planned_metres(rollout.planned, reached, goals)
    walked = arrival_functions.walked_metres(rollout.path, rollout.scored, reached, goals)
    seconds = arrival_functions.finish_seconds(reached, goals)
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
        return share(
            ScoredSpans.of(rollout.scored).any(arrival_functions.stuck(*where)), _walks(rollout).there
        )
    return share(arrival_functions.deadlocked(*where), rollout.mask)


@metric("ordinary")
def goals_per_person(rollout: Rollout) -> Ratio:
    """Goals that a person reaches until all are finished."""
    return ratio(rollout.reached[..., -1].where(rollout.mask, 0), rollout.mask)


@metric("ordinary")
def goals_per_person_min(rollout: Rollout) -> Ratio:
    """Goals of an episode's person with the fewest."""
    return ratio(arrival_functions.fewest_goals(rollout.reached, rollout.mask))


@metric("ordinary")
def goals_per_person_max(rollout: Rollout) -> Ratio:
    """Goals of an episode's person with the most."""
    return ratio(arrival_functions.most_goals(rollout.reached, rollout.mask))


@metric("ordinary")
def goals_parity(rollout: Rollout) -> Ratio:
    """Fewest goals divided by most, mean over episodes in which a goal is reached."""
    most = arrival_functions.most_goals(rollout.reached, rollout.mask)
    fewest = arrival_functions.fewest_goals(rollout.reached, rollout.mask)
    return mean(fewest.double() / most.clamp_min(1), most > 0)


def _episode_seconds(rollout: Rollout) -> Tensor:
    seconds = arrival_functions.finish_seconds(rollout.reached, rollout.goals)
    return arrival_functions.episode_seconds(seconds, _walks(rollout).arrived, _walks(rollout).there)


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

    See `pedzoo.metrics.arrival_functions.weighted`.
    """
    walks = _walks(rollout)
    return ratio(arrival_functions.weighted(walks.arrived, walks.planned, walks.walked), walks.there)


@metric("ordinary")
def stl(rollout: Rollout) -> Ratio:
    """Success weighted by time, mean over people.

    See `pedzoo.metrics.arrival_functions.weighted`.
    """
    walks = _walks(rollout)
    return ratio(arrival_functions.weighted(walks.arrived, walks.needed, walks.taken), walks.there)


def time_ratios(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return each person's time divided by that of free walking (E, A), and where it is known.

    It is known of people who arrive in time. Time before they set out does not count.
    """
    walks = _walks(rollout)
    return walks.taken * rollout.pref_speed / walks.planned, walks.arrived & (walks.planned > 0)
