"""Each recorded person's walk in each round of a replay, beside that in the recording.

P people, K rounds of the R scenes of a recording; E episodes, W walks: one for every person of an episode
that the policy moves, or should have moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from pedzoo.core.types import TRACE_SECONDS
from pedzoo.metrics.arrival import stuck
from pedzoo.metrics.realism.features import SampledRollout, every_step
from pedzoo.metrics.realism.paths import closed_loop_error, dtw, padded
from pedzoo.sim.rollout import Rollout


class RecordedWalks(NamedTuple):
    """The recorded walks of P people, from where a policy takes over.

    Attributes:
        scene: Scene of each person (P,) long, -1 for people that no policy moves.
        seconds: Until they are within 0.3 m of their goal (P,), NaN likewise.
        xy: Positions every 0.4 s (P, L, 2), metres.
        points: How many (P,) long.
    """

    scene: Tensor
    seconds: Tensor
    xy: Tensor
    points: Tensor


class Walks(NamedTuple):
    """W walks; of several rollouts they can be put one after the other.

    Attributes:
        episode: (W,) long.
        person: (W,) long.
        deadlock: Which walks had a `deadlocked` person, as in `pedzoo.metrics.arrival` (W,) bool.
        seconds: From when the policy took over until within 0.3 m of the goal; NaN for never. A replay takes
            out people who need more than twice the recorded time.
        ade: Mean distance to the recorded positions of the same times, metres; NaN without any.
        dtw: Dynamic time warping distance to the recorded walk, metres; NaN likewise.
    """

    episode: Tensor
    person: Tensor
    deadlock: Tensor
    seconds: Tensor
    ade: Tensor
    dtw: Tensor

    def by_person(self, value: Tensor, scenes: int, people: int) -> Tensor:
        """Return values (W,) as a table (K, P) of rounds of ``scenes``, NaN where there was no walk."""
        rounds = int(self.episode.max()) // scenes + 1
        table = torch.full((rounds, people), torch.nan, dtype=torch.float64)
        table[self.episode // scenes, self.person] = value.double()
        return table


class WalksByPerson(NamedTuple):
    """Walks of P people in K rounds, (K, P) each, NaN for no walk; ``real_seconds`` is (P,)."""

    success: Tensor
    deadlock: Tensor
    seconds: Tensor
    ade: Tensor
    dtw: Tensor
    real_seconds: Tensor

    @classmethod
    def of(cls, walks: Walks, real_seconds: Tensor, scenes: int) -> WalksByPerson:
        """Return those of walks in rounds of ``scenes``, beside the recorded times (P,)."""
        success = ~walks.seconds.isnan()
        success, deadlock, seconds, ade, warped = (
            walks.by_person(value, scenes, len(real_seconds))
            for value in (success, walks.deadlock, walks.seconds, walks.ade, walks.dtw)
        )
        return cls(success, deadlock, seconds, ade, warped, real_seconds)


def tracks_of(parts: Sequence[Rollout], people: int) -> RecordedWalks:
    """Return the tracks of a recorded crowd of P ``people``, given as rollouts of scenes 0, 1, ..."""
    scene = torch.full((people,), -1)
    seconds = torch.full((people,), torch.nan, dtype=torch.float64)
    positions, persons, before = [], [], 0
    for part in parts:
        steps = every_step(part)
        scene[part.person[part.controlled]] = part.controlled.nonzero()[:, 0] + before
        result = _seconds(part, torch.arange(people).expand(len(part.failed), people), people)
        seconds = torch.where(result.isnan(), seconds, result)
        positions.append(steps.xy[steps.scored])
        persons.append(steps.person[steps.scored])
        before += len(part.failed)
    return RecordedWalks(scene, seconds, *padded(torch.cat(positions), torch.cat(persons), people))


def walks_of(
    rollout: Rollout, steps: SampledRollout, first: int, scenes: int, tracks: RecordedWalks
) -> Walks:
    """Return the walks of a rollout.

    Args:
        rollout: Episodes ``first``, ``first + 1``, ... of a replay; episode i is scene i modulo ``scenes``.
        steps: The same every 0.4 s.
        first: Number of the first one.
        scenes: R.
        tracks: The recorded walks.
    """
    scene = (first + torch.arange(len(rollout.failed))) % scenes
    episode, person = (scene.unsqueeze(1) == tracks.scene).nonzero().unbind(1)
    count = len(person)
    number = torch.full((len(scene), len(tracks.scene)), -1)
    number[episode, person] = torch.arange(count)
    still = stuck(rollout.trace, rollout.goal, rollout.controlled)
    deadlock = torch.zeros(count, dtype=torch.bool)
    deadlock[number[still.nonzero()[:, 0], rollout.person[still]]] = True
    walk = number[steps.scored.nonzero()[:, 0], steps.person[steps.scored]]
    xy, points = padded(steps.xy[steps.scored], walk, count)
    true, others = tracks.xy[person], tracks.points[person]
    return Walks(
        episode + first,
        person,
        deadlock,
        _seconds(rollout, number, count),
        closed_loop_error(xy, true, torch.minimum(points, others)),
        dtw(xy, points, true, others),
    )


def of_people(tables: WalksByPerson, weights: Tensor) -> dict[str, Tensor]:
    """Return values that are means or medians over people, for weights (R, P), (R,) each."""
    rounds = len(tables.success)
    ratio = (tables.seconds / tables.real_seconds).nanmedian(0).values
    walks = weights @ (~tables.success.isnan()).sum(0).double()
    result = {
        "success": weights @ tables.success.nansum(0) / walks,
        "deadlock": weights @ tables.deadlock.nansum(0) / walks,
        "time_ratio_median": _median(ratio, weights),
        "closed_loop_ade_m": person_mean(tables.ade.nanmean(0), weights),
        "dtw_m": person_mean(tables.dtw.nanmean(0), weights),
    }
    if rounds > 1:
        best = tables.ade.nan_to_num(torch.inf).amin(0)
        result[f"closed_loop_min_ade_{rounds}_m"] = person_mean(
            best.where(best.isfinite(), torch.nan), weights
        )
    return result


def _seconds(rollout: Rollout, number: Tensor, count: int) -> Tensor:
    """Return the times at which people reached their goals (W,), seconds, NaN for never.

    ``number`` (E, P) is the walk of each person in each episode.
    """
    first = []
    for when in (rollout.controlled, rollout.controlled & (rollout.reached > 0)):
        episode, _, point = when.nonzero().unbind(1)
        never = torch.full((count,), torch.nan, dtype=torch.float64)
        walk = number[episode, rollout.person[when]]
        first.append(never.scatter_reduce(0, walk, point.double(), "amin", include_self=False))
    return (first[1] - first[0] + 1) * TRACE_SECONDS


def person_mean(value: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted mean (R,) of the values (P,) that are not NaN."""
    return weights @ value.nan_to_num() / (weights @ (~value.isnan()).double())


def _median(value: Tensor, weights: Tensor) -> Tensor:
    """Return the weighted lower median (R,) of the values (P,) that are not NaN."""
    order = value.argsort()[: int((~value.isnan()).sum())]
    if not len(order):
        return torch.full((len(weights),), torch.nan, dtype=torch.float64)
    until = weights[:, order].cumsum(1)
    place = torch.searchsorted(until, until[:, -1:] / 2).squeeze(1)
    return value[order][place].where(until[:, -1] > 0, torch.nan)
