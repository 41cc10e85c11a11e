"""Rows of a replay: what a policy made of recorded people, beside these people themselves.

A replay's rollout has all scenes of the scenario, K rounds of them. People are compared with themselves in
the recording, where both are at the same place at the same moment until the policy takes over. Intervals are
over people, who are drawn with all that they did in all rounds and in the recording. That people who met
depend on each other is left out, so intervals are somewhat too narrow.
"""

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import STEP_SECONDS
from pedzoo.eval.scoring.rows import SPLITS, Resampled, crowd_values, halves_row, values_row
from pedzoo.metrics.closed_loop import own_metrics
from pedzoo.metrics.contacts import intervention_m, intervention_share
from pedzoo.metrics.ratios import of_parts, summarised
from pedzoo.metrics.realism.crowds import (
    CrowdSums,
    contact_intervals,
    crowd,
    densities,
    density_speed,
    only,
    together,
)
from pedzoo.metrics.realism.distances import halves
from pedzoo.metrics.realism.features import FEATURES, every_step, surroundings
from pedzoo.metrics.realism.walks import RecordedWalks, Walks, WalksByPerson, of_people, tracks_of, walks_of
from pedzoo.metrics.statistics import drawn_people, wilson
from pedzoo.sim.recorded_people import RecordedPeople
from pedzoo.sim.rollout import Rollout
from pedzoo.sim.scenarios.replay import PreparedReplay

REAL = "real"
"""Name of the recorded people's row."""


class _Recorded(NamedTuple):
    """The real people of a replay."""

    tracks: RecordedWalks
    crowd: CrowdSums


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
        rollout: Scenes 0, 1, ... of the scenario, round after round; or its parts one after the other, of
            which only one has to be in memory at a time.
        scenario: The replay.
        decision_dt: Seconds between decisions.
        metrics: Of one's own, as ``path/to/file.py:f``; their intervals are over scenes.
    """
    recorded, people, scenes = _recorded(scenario), scenario.persons, scenario.scenes
    parts = [rollout] if isinstance(rollout, Rollout) else rollout
    walked, crowds, own, first = [], [], [], 0
    for part in parts:
        layer = {"intervention_share": intervention_share(part), "intervention_m": intervention_m(part)}
        own.append(layer | own_metrics(part, metrics))
        steps = every_step(part)
        walked.append(walks_of(part, steps, first, scenes, recorded.tracks))
        crowds.append(crowd(part, steps, surroundings(steps), first, scenes, people.start, people.goal))
        first += len(part.failed)
    walks = Walks(*(torch.cat(values) for values in zip(*walked, strict=True)))
    seen = torch.zeros(len(people.agent), dtype=torch.bool)
    seen[walks.person] = True
    tables = WalksByPerson.of(walks, recorded.tracks.seconds, scenes)
    mine, real, count = together(crowds), only(recorded.crowd, seen), int(seen.sum())
    drawn = _weights(torch.cat((torch.ones(1, count, dtype=torch.float64), drawn_people(count))), seen)
    values = of_people(tables, drawn) | crowd_values(mine, real, Resampled(drawn, drawn))
    exact = contact_intervals(mine, real, torch.arange(len(seen)), len(seen))
    exact |= {key: wilson(float(values[key][0]), count) for key in ("success", "deadlock")}
    row = values_row(name, count, len(tables.success), values, count, exact)
    more, theirs = summarised({key: of_parts([part[key] for part in own]) for key in own[0]})
    return row | {
        "decision_dt_s": decision_dt,
        "metrics": row["metrics"] | more,
        "ci95": row["ci95"] | theirs,
        "per_agent": _listed(tables, people, seen),
        "density_speed": _curve(mine, real, drawn[:1]),
        "distributions": distributions(mine, real),
    }


def reference_rows(scenario: PreparedReplay, metrics: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return what belongs beside every policy: the real crowd, and its halves against each other.

    ``real`` has the recording's own rates and spreads, and distances of 0. ``real halves`` is the noise
    floor: half of the people, drawn at random, against the other half. Its values are means over `SPLITS`
    splits, its intervals hold 95 % of them. People are met by all others in either half: only who is counted
    differs. ``metrics`` of ``real`` are those of `replay_row`.
    """
    recorded = _recorded(scenario)
    real, seen = recorded.crowd, recorded.tracks.scene >= 0
    first = _weights(halves(int(seen.sum()), SPLITS), seen)
    values = crowd_values(real, real, Resampled(first, seen.double() - first), exact=False)
    floor = halves_row(int(seen.sum()), values) | {"decision_dt_s": STEP_SECONDS, "per_agent": []}
    return [replay_row(REAL, scenario.real_parts(), scenario, STEP_SECONDS, metrics), floor]


@lru_cache(maxsize=1)
def _recorded(scenario: PreparedReplay) -> _Recorded:
    """Return the real people of a replay; kept for the next row."""
    people, parts = scenario.persons, list(scenario.real_parts())
    crowds, first = [], 0
    for part in parts:
        steps = every_step(part)
        around = surroundings(steps)
        crowds.append(crowd(part, steps, around, first, scenario.scenes, people.start, people.goal))
        first += len(part.failed)
    return _Recorded(tracks_of(parts, len(people.agent)), together(crowds))


def _weights(of_seen: Tensor, seen: Tensor) -> Tensor:
    """Return weights (R, P) of all people, given those (R, N) of the N who were ``seen`` (P,)."""
    weights = torch.zeros(len(of_seen), len(seen), dtype=torch.float64)
    weights[:, seen] = of_seen.double()
    return weights


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


def _listed(tables: WalksByPerson, people: RecordedPeople, seen: Tensor) -> list[dict[str, Any]]:
    """Return what each person did, means over rounds."""
    share, seconds, ade, warped = (
        value.nanmean(0) for value in (tables.success, tables.seconds, tables.ade, tables.dtw)
    )

    def known(value: Tensor, person: int) -> float | None:
        return None if value[person].isnan() else round(float(value[person]), 4)

    return [
        {
            "person": person,
            "recording": int(people.recording[person]),
            "agent": int(people.agent[person]),
            "success": round(float(share[person]), 4),
            "time_s": known(seconds, person),
            "real_time_s": known(tables.real_seconds, person),
            "closed_loop_ade_m": known(ade, person),
            "dtw_m": known(warped, person),
        }
        for person in seen.nonzero()[:, 0].tolist()
    ]


BINS = 24

OUTSIDE = 0.005
"""Share of the real samples beyond either end, which count in the first and the last bin."""


def distributions(mine: CrowdSums, real: CrowdSums) -> dict[str, dict[str, Any]]:
    """Return the histograms of every feature, ready for JSON.

    Each has its ``unit``, the ``low`` and ``high`` end, and the shares of samples in `BINS` equal bins:
    ``share`` of this crowd, ``real_share`` of the recorded one. Features without real samples are left out.
    """
    result = {}
    for name, unit in FEATURES.items():
        theirs = real.samples[name].value.double()
        if not len(theirs):
            continue
        ends = torch.tensor([OUTSIDE, 1 - OUTSIDE], dtype=torch.float64)
        low, high = (float(end) for end in torch.quantile(_some(theirs), ends))
        high = high if high > low else low + 1.0
        result[name] = {"unit": unit, "low": round(low, 4), "high": round(high, 4)}
        for key, values in (("share", mine.samples[name].value.double()), ("real_share", theirs)):
            counts = torch.histc(values.clamp(low, high), BINS, low, high)
            result[name][key] = [round(float(count), 5) for count in counts / max(len(values), 1)]
    return result


def _some(values: torch.Tensor, most: int = 1_000_000) -> torch.Tensor:
    """Return at most so many of the values: `torch.quantile` takes no more than 16 million."""
    return values[:: -(-len(values) // most)]
