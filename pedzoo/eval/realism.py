"""Rows of a replay: what a policy made of recorded people, beside these people themselves.

People are compared with themselves in the recording, where they are at the same place at the same moment
until the policy takes over. Intervals are over people, who are drawn with all that they did in all rounds.
That people who met depend on each other is left out, so intervals are somewhat too narrow.
"""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.eval.scoring.rows import halves_row, split_in_halves, values_row, weights_of
from pedzoo.metrics.closed_loop import own_metrics
from pedzoo.metrics.contacts import intervention_m, intervention_share
from pedzoo.metrics.ratios import drawn_people, of_parts, summarised, wilson
from pedzoo.metrics.realism.crowds import (
    CrowdSums,
    compared,
    contact_intervals,
    crowd,
    densities,
    density_speed,
    only,
    together,
)
from pedzoo.metrics.realism.features import FEATURES, SampledRollout, every_step, surroundings
from pedzoo.metrics.realism.walks import RecordedWalks, by_person, of_people, tracks_of, walks_of
from pedzoo.sim.recorded_people import RecordedPeople
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay

REAL = "real"
"""Name of the recorded people's row."""

BINS = 24


def _walked(part: Rollout, first: int, scenario: PreparedReplay) -> tuple[SampledRollout, CrowdSums]:
    """Return the steps and the crowd of episodes ``first``, ... of a replay."""
    steps, people = every_step(part), scenario.persons
    return steps, crowd(part, steps, surroundings(steps), first, scenario.scenes, people.start, people.goal)


@lru_cache(maxsize=1)  # for the next row
def _recorded(scenario: PreparedReplay) -> tuple[RecordedWalks, CrowdSums]:
    """Return the real people of a replay."""
    parts, crowds, first = list(scenario.real_parts()), [], 0
    for part in parts:
        crowds.append(_walked(part, first, scenario)[1])
        first += len(part.failed)
    return tracks_of(parts, len(scenario.persons.agent)), together(crowds)


def replay_row(
    name: str,
    rollout: Rollout | Iterable[Rollout],
    scenario: PreparedReplay,
    decision_dt: float,
    metrics: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the metrics of a policy in a replay with their 95 % intervals, and what each person did.

    ``n`` is the number of people, ``rounds`` is K. The numbers of the crowd are those of
    `pedzoo.metrics.realism.crowds.compared`; ``realism`` is their headline, lower is better. Beside them:

    * ``success``: the share of people who came within 0.3 m of their real exit in twice the real time.
      ``deadlock``: of people who once moved less than 0.1 m in 5 s, away from their exit; real people do.
      ``time_ratio_median``: the time that it took them to the real time until there, median over people.
    * ``closed_loop_ade_m``: mean distance to the recorded positions of the same time, until either arrives,
      never set back to them. ``closed_loop_min_ade_K_m``: of each person's best round. ``dtw_m``: distance to
      the recorded walk whatever the pace. A person who arrives in the first step of 0.4 s has neither.
    * ``intervention_share``, ``intervention_m``: what the layer changes (`pedzoo.metrics.contacts`).

    ``density_speed`` is the curve of both crowds, ``distributions`` the histograms of every feature.

    Args:
        name: The policy as it was given.
        rollout: Scenes 0, 1, ... of the scenario, round after round; or its parts one after the other.
        scenario: The replay.
        decision_dt: Seconds between decisions.
        metrics: Of one's own, as ``path/to/file.py:f``; their intervals are over scenes.
    """
    (tracks, everybody), people, scenes = _recorded(scenario), scenario.persons, scenario.scenes
    walked, crowds, own, first = [], [], [], 0
    for part in [rollout] if isinstance(rollout, Rollout) else rollout:
        layer = {"intervention_share": intervention_share(part), "intervention_m": intervention_m(part)}
        own.append(layer | own_metrics(part, metrics))
        steps, sums = _walked(part, first, scenario)
        walked.append(walks_of(part, steps, first, scenes, tracks))
        crowds.append(sums)
        first += len(part.failed)
    walks = {name: torch.cat([part[name] for part in walked]) for name in walked[0]}
    seen = torch.zeros(len(people.agent), dtype=torch.bool)
    seen[walks["person"]] = True
    tables = by_person(walks, scenes, len(seen))
    mine, real, count = together(crowds), only(everybody, seen), int(seen.sum())
    drawn = weights_of(seen, torch.cat((torch.ones(1, count, dtype=torch.float64), drawn_people(count))))
    values = of_people(tables, tracks.seconds, drawn) | compared(mine, real, drawn, drawn)
    exact = contact_intervals(mine, real, torch.arange(len(seen)), len(seen))
    exact |= {key: wilson(float(values[key][0]), count) for key in ("success", "deadlock")}
    row = values_row(name, count, len(tables["success"]), values, count, exact)
    more, theirs = summarised({key: of_parts([part[key] for part in own]) for key in own[0]})
    return row | {
        "decision_dt_s": decision_dt,
        "metrics": row["metrics"] | more,
        "ci95": row["ci95"] | theirs,
        "per_agent": _listed(tables, tracks.seconds, people, seen),
        "density_speed": _curve(mine, real, drawn[:1]),
        "distributions": distributions(mine, real),
    }


def reference_rows(scenario: PreparedReplay, metrics: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return what belongs beside every policy: the real crowd, and its halves against each other.

    ``real`` has the recording's own rates and spreads, and distances of 0. ``real halves`` is the noise
    floor: half of the people, drawn at random, against the other half. Its values are means over splits,
    its intervals hold 95 % of them. People are met by all others in either half: only who is counted differs.
    ``metrics`` of ``real`` are those of `replay_row`.
    """
    tracks, real = _recorded(scenario)
    seen = tracks.scene >= 0
    values = compared(real, real, *split_in_halves(seen), exact=False)
    floor = halves_row(int(seen.sum()), values) | {"decision_dt_s": STEP_SECONDS, "per_agent": []}
    return [replay_row(REAL, scenario.real_parts(), scenario, STEP_SECONDS, metrics), floor]


def _curve(mine: CrowdSums, real: CrowdSums, once: Tensor) -> list[dict[str, float | None]]:
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


def _listed(
    tables: dict[str, Tensor], real_seconds: Tensor, people: RecordedPeople, seen: Tensor
) -> list[dict[str, Any]]:
    """Return what each person did, means over rounds; None where a person has no such number."""
    keys = {"success": "success", "seconds": "time_s", "real": "real_time_s"}
    keys |= {"ade": "closed_loop_ade_m", "dtw": "dtw_m"}
    means = {key: (real_seconds if name == "real" else tables[name].nanmean(0)) for name, key in keys.items()}
    result = []
    for person in seen.nonzero()[:, 0].tolist():
        numbers = {key: float(mean[person]) for key, mean in means.items()}
        known = {key: None if math.isnan(value) else round(value, 4) for key, value in numbers.items()}
        where = {"recording": int(people.recording[person]), "agent": int(people.agent[person])}
        result.append({"person": person, **where, **known})
    return result


def distributions(mine: CrowdSums, real: CrowdSums) -> dict[str, dict[str, Any]]:
    """Return the histograms of every feature, ready for JSON.

    Each has its ``unit``, the ``low`` and ``high`` end, and the shares of samples in `BINS` equal bins:
    ``share`` of this crowd, ``real_share`` of the recorded one. The first and the last bin hold what lies
    beyond the ends, half a percent of the real samples each. Features without real samples are left out.
    """
    result = {}
    for name, unit in FEATURES.items():
        theirs = real.samples[name].value.double()
        if not len(theirs):
            continue
        ends = torch.tensor([0.005, 0.995], dtype=torch.float64)
        some = theirs[:: -(-len(theirs) // 1_000_000)]  # `torch.quantile` takes no more than 16 million
        low, high = torch.quantile(some, ends).tolist()
        high = high if high > low else low + 1.0
        result[name] = {"unit": unit, "low": round(low, 4), "high": round(high, 4)}
        for key, values in (("share", mine.samples[name].value.double()), ("real_share", theirs)):
            counts = torch.histc(values.clamp(low, high), BINS, low, high)
            result[name][key] = [round(float(count), 5) for count in counts / max(len(values), 1)]
    return result
