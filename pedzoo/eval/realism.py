"""Rows of a replay: what a policy made of recorded people, beside these people themselves.

A replay's rollout has all scenes of the scenario, K rounds of them. Everybody is compared with themselves in
the recording, where both are at the same place at the same moment until the policy takes over. Intervals are
over people, who are drawn with all that they did in all rounds and in the recording. That people who met
depend on each other is left out, so intervals are somewhat too narrow.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from pedzoo.metrics.intervals import Interval, wilson
from pedzoo.metrics.realism import drawn_people, halves
from pedzoo.metrics.realism_crowds import (
    Crowd,
    compared,
    crowd,
    densities,
    density_speed,
    distances,
    resampled_distances,
    spreads,
)
from pedzoo.metrics.realism_features import every_step
from pedzoo.metrics.realism_walks import Walks, walks_of
from pedzoo.metrics.rollout import Rollout
from pedzoo.sim.people import People
from pedzoo.sim.scenarios.replay import Replay
from pedzoo.types import STEP_SECONDS

REAL, HALVES = "real", "real halves"
"""Names of the rows of `reference_rows`."""

SPLITS = 200
"""Random halves of the real crowd."""


def replay_row(name: str, rollout: Rollout, scenario: Replay, decision_dt: float) -> dict[str, Any]:
    """Return the metrics of a policy in a replay with their 95 % intervals, and what each person did.

    ``n`` is the number of people, ``rounds`` is K. The numbers of the crowd are those of
    `pedzoo.metrics.realism_crowds.compared`; ``realism`` is their headline, lower is better. Beside them:

    * ``success``: the share of people who came within 0.3 m of their real exit in twice the real time.
      ``deadlock``: of people who once moved less than 0.1 m in 5 s, away from their exit; real people do.
      ``time_ratio_median``: the time that it took them to the real time until there, median over people.
    * ``closed_loop_ade_m``: mean distance to the recorded positions of the same time, while both are there,
      never set back to them. ``closed_loop_min_ade_K_m``: of everybody's best round. ``dtw_m``: distance to
      the recorded walk whatever the pace.

    ``density_speed`` is the curve of both crowds.

    Args:
        name: The policy as it was given.
        rollout: Scenes 0, 1, ... of the scenario.
        scenario: The replay.
        decision_dt: Seconds between decisions.
    """
    recorded, people = scenario.real(), scenario.persons
    steps, real_steps = every_step(rollout), every_step(recorded)
    walks = walks_of(rollout, steps, recorded, real_steps, len(people.agent))
    seen = walks.expected.any(0)
    scenes = len(recorded.failed)
    mine = crowd(rollout, steps, scenes, people.start, people.goal)
    real = crowd(recorded, real_steps, scenes, people.start, people.goal, seen)
    once, drawn = (
        _weights(torch.ones(1, int(seen.sum())), seen),
        _weights(drawn_people(int(seen.sum())), seen),
    )
    spread = spreads(real)
    values = _of_walks(walks, once) | compared(mine, real, once, once, distances(mine, real), spread)
    distance = resampled_distances(mine, real, drawn, drawn)
    resamples = _of_walks(walks, drawn) | compared(mine, real, drawn, drawn, distance, spread)
    metrics = {key: float(value) for key, value in values.items() if not value.isnan()}
    intervals = {key: found for key in metrics if (found := _interval(resamples[key]))}
    for key in ("success", "deadlock"):
        intervals[key] = wilson(metrics[key], int(seen.sum()))
    return {
        "name": name,
        "case": {},
        "decision_dt_s": decision_dt,
        "n": int(seen.sum()),
        "rounds": len(walks.expected),
        "metrics": metrics,
        "ci95": intervals,
        "per_agent": _listed(walks, people, seen),
        "density_speed": _curve(mine, real, once),
    }


def reference_rows(scenario: Replay) -> list[dict[str, Any]]:
    """Return what belongs beside every policy: the real crowd, and its halves against each other.

    ``real`` has the recording's own rates and spreads, and distances of 0. ``real halves`` is the noise
    floor: half of the people, drawn at random, against the other half. Its values are means over `SPLITS`
    splits, its intervals hold 95 % of them. People are met by all others in either half: only who is counted
    differs.

    Args:
        scenario: The replay.
    """
    recorded, people = scenario.real(), scenario.persons
    real = crowd(recorded, every_step(recorded), len(recorded.failed), people.start, people.goal)
    seen = real.minutes > 0
    first = _weights(halves(int(seen.sum()), SPLITS), seen)
    second = seen.double() - first
    distance = resampled_distances(real, real, first, second)
    found = compared(real, real, first, second, distance, spreads(real))
    floor = {
        "name": HALVES,
        "case": {},
        "decision_dt_s": STEP_SECONDS,
        "n": int(seen.sum()),
        "rounds": 1,
        "metrics": {key: float(value.nanmean()) for key, value in found.items() if not value.isnan().all()},
        "ci95": {key: interval for key, value in found.items() if (interval := _interval(value))},
        "per_agent": [],
    }
    return [replay_row(REAL, recorded, scenario, STEP_SECONDS), floor]


def _weights(of_seen: Tensor, seen: Tensor) -> Tensor:
    """Return weights (R, P) of all people, given those (R, N) of the N who were ``seen`` (P,)."""
    weights = torch.zeros(len(of_seen), len(seen), dtype=torch.float64)
    weights[:, seen] = of_seen.double()
    return weights


def _of_walks(walks: Walks, weights: Tensor) -> dict[str, Tensor]:
    """Return what is a mean or a median over people, for weights (R, P), (R,) each."""
    rounds = len(walks.expected)
    ratio = (walks.seconds / walks.real_seconds).nanmedian(0).values
    taking_part = walks.expected.sum(0)
    found = {
        "success": weights @ walks.success.sum(0).double() / (weights @ taking_part.double()),
        "deadlock": weights @ walks.deadlock.sum(0).double() / (weights @ taking_part.double()),
        "time_ratio_median": _median(ratio, weights),
        "closed_loop_ade_m": _mean(walks.ade.nanmean(0), weights),
        "dtw_m": _mean(walks.dtw.nanmean(0), weights),
    }
    if rounds > 1:
        best = walks.ade.nan_to_num(torch.inf).amin(0)
        found[f"closed_loop_min_ade_{rounds}_m"] = _mean(best.where(best.isfinite(), torch.nan), weights)
    return found


def _mean(value: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted mean (R,) of the values (P,) that are not NaN."""
    return weights @ value.nan_to_num() / (weights @ (~value.isnan()).double())


def _median(value: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted lower median (R,) of the values (P,) that are not NaN."""
    order = value.argsort()[: int((~value.isnan()).sum())]
    if not len(order):
        return torch.full((len(weights),), torch.nan, dtype=torch.float64)
    until = weights[:, order].cumsum(1)
    place = torch.searchsorted(until, until[:, -1:] / 2)
    return value[order][place.squeeze(1).clamp(max=len(order) - 1)]


def _interval(values: Tensor) -> Interval | None:
    """Return what holds 95 % of the values (R,) that are there; None where they do not differ."""
    quantiles = torch.tensor([0.025, 0.975], dtype=torch.float64)
    low, high = torch.nanquantile(values.double(), quantiles).tolist()
    return (low, high) if low < high else None


def _curve(mine: Crowd, real: Crowd, once: Tensor) -> list[dict[str, float | None]]:
    """Return the mean speeds of both crowds at every density at which the real one was."""
    (speed, steps), (true, weight) = density_speed(mine, once), density_speed(real, once)
    table = zip(densities().tolist(), speed[0].tolist(), true[0].tolist(), steps[0], weight[0], strict=True)
    return [
        {
            "density_per_m2": round(density, 4),
            "speed_m_per_s": round(own, 4) if count else None,
            "real_speed_m_per_s": round(theirs, 4),
            "real_share": round(float(share / weight.sum()), 5),
        }
        for density, own, theirs, count, share in table
        if share
    ]


def _listed(walks: Walks, people: People, seen: Tensor) -> list[dict[str, Any]]:
    """Return what each person did, means over rounds."""
    share = walks.success.sum(0) / walks.expected.sum(0)
    seconds, ade, warped = (value.nanmean(0) for value in (walks.seconds, walks.ade, walks.dtw))

    def known(value: Tensor, person: int) -> float | None:
        return None if value[person].isnan() else round(float(value[person]), 4)

    return [
        {
            "person": person,
            "recording": int(people.recording[person]),
            "agent": int(people.agent[person]),
            "success": round(float(share[person]), 4),
            "time_s": known(seconds, person),
            "real_time_s": known(walks.real_seconds, person),
            "closed_loop_ade_m": known(ade, person),
            "dtw_m": known(warped, person),
        }
        for person in seen.nonzero()[:, 0].tolist()
    ]
