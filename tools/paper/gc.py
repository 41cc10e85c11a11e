"""The closed-loop protocol of crowd simulation on Grand Central: from 2 s of history to the exit.

Zhang et al., KDD 2022 (PCS), and later SPDiff (AAAI 2024): clip 2344 to 2404 s, rows of 0.08 s. People walk
until they are within 0.5 m of where they were last seen. Their places are compared in the frames in which
they really were there. F frames of P people.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pedzoo.core.paths import sha256_of
from pedzoo.data.datasets.gc import Gc
from pedzoo.data.tracks import Tracks
from pedzoo.eval.results import ResultTable
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.work_units import fingerprint
from pedzoo.models.zoo.store import find
from pedzoo.policies.load import controller, load_policy
from tools.paper.base import Jobs

HISTORY, DT, ARRIVED = 25, 0.08, 0.5
"""Rows of history, seconds between rows, and metres from the exit at which people leave."""

NEAR, FRIENDS = 0.5, 25
"""Metres at which two people collide; those who are so near in more frames walk together."""

STRAIGHT = "straight at one's speed"
"""The floor: to the exit, as fast as in the first 2 s."""

POLICIES = (
    *("mdn_walker.mixed", "mdn_walker.mixed:safety=false", "mdn_walker.likelihood:safety=false"),
    *("social_walker.styled", "approach_net_goal_map.indoor", "orca:radius=0.2"),
)

PUBLISHED = {"PCS": (1.03, 1.60, None, None), "SPDiff": (0.91, 1.33, 0.009, 810)}
"""MAE, OT, MMD and collisions as others print them; their epoch was chosen on this clip."""

SEEDS = 3


class Clip(NamedTuple):
    """A recording at its own rate."""

    place: NDArray[np.float64]  # (F, P, 2), metres; NaN where a person is not there
    first: NDArray[np.int64]  # frame of the first row (P,)
    last: NDArray[np.int64]  # of the last one (P,)

    @classmethod
    def of(cls, tracks: Tracks) -> Clip:
        """Return the clip of tracks whose frames are rows."""
        agent = np.unique(tracks.agent, return_inverse=True)[1]
        frame = tracks.frame - tracks.frame.min()
        place = np.full((frame.max() + 1, agent.max() + 1, 2), np.nan)
        place[frame, agent] = tracks.xy
        there = np.isfinite(place[..., 0])
        return cls(place, there.argmax(0), len(there) - 1 - there[::-1].argmax(0))

    @property
    def scored(self) -> NDArray[np.bool_]:
        """The frames of people behind their history (F, P) bool."""
        frame = np.arange(len(self.place))[:, None]
        return (frame >= self.first + HISTORY) & (frame <= self.last)

    @property
    def exit(self) -> NDArray[np.float64]:
        """Where people are last seen (P, 2), metres."""
        return self.place[self.last, np.arange(len(self.last))]

    @property
    def speed(self) -> NDArray[np.float64]:
        """Their mean speed in the history (P,), m/s."""
        rows = np.minimum(self.first + np.arange(HISTORY)[:, None], self.last)
        steps = np.linalg.norm(np.diff(self.place[rows, np.arange(len(self.last))], axis=0), axis=-1)
        return steps.sum(0) / np.maximum(np.minimum(self.last - self.first, HISTORY - 1), 1) / DT


def simulated(clip: Clip, policy: str, seed: int | None) -> NDArray[np.float64]:
    """Return how people walk in a controller's loop (F, P, 2); NaN where they are gone, or not there yet.

    Without a ``seed`` no noise is drawn. `STRAIGHT` is no policy.
    """
    result, goal, speed = clip.place.copy(), clip.exit, np.maximum(clip.speed, 0.1)
    moved = clip.last - clip.first >= HISTORY
    frames, people = np.arange(len(result))[:, None], np.arange(len(goal))
    result[(frames >= clip.first + HISTORY) & moved] = np.nan
    host = None
    if policy != STRAIGHT:
        liked = {int(one): float(speed[one]) for one in people}
        host = controller(policy, None, dt=DT, pref_speed=liked, seed=seed or 0, deterministic=seed is None)
    known: set[int] = set()
    for frame in range(len(result) - 1):
        here = np.isfinite(result[frame, :, 0])
        mine = here & moved & (frame >= clip.first + HISTORY - 1)
        way = goal - result[frame]
        if host is None:
            left = np.linalg.norm(way, axis=1, keepdims=True)
            velocity = way / np.maximum(left, 1e-9) * np.minimum(speed[:, None], left / DT)
        else:
            there = people[here].tolist()
            new = [one for one in there if one not in known]
            begins = {
                one: (clip.place[min(frame + 1, clip.last[one]), one] - result[frame, one]) / DT
                for one in new
            }
            goals = {one: goal[one] for one in new}
            answer = host.step({one: result[frame, one] for one in there}, goals, begins)
            known = set(there)
            velocity = np.array([answer.get(int(one), np.zeros(2)) for one in people])
        after = result[frame] + velocity * DT
        stays = mine & (np.linalg.norm(goal - after, axis=1) >= ARRIVED)
        result[frame + 1, stays] = after[stays]
    return result


def scores(clip: Clip, walk: NDArray[np.float64]) -> dict[str, float]:
    """Return MAE (m), OT (m2), MMD and collisions of a walk (F, P, 2); who has left is at the exit."""
    scored = clip.scored
    filled = np.where(np.isfinite(walk), walk, clip.exit)
    apart = np.linalg.norm(filled - clip.place, axis=-1)[scored]
    frames = [
        (torch.from_numpy(filled[f, row]).float(), torch.from_numpy(clip.place[f, row]).float())
        for f, row in enumerate(scored)
        if row.sum() > 1
    ]
    return {
        "mae_m": float(apart.mean()),
        "ot_m2": float(np.mean([transport(*pair) for pair in frames])),
        "mmd": float(np.mean([discrepancy(*pair) for pair in frames])),
        "collisions": collisions(walk),
    }


def transport(one: Tensor, other: Tensor, spread: float = 0.1) -> float:
    """Return the cost, m2, of Sinkhorn's plan between as many points (N, 2) each; Cuturi, NIPS 2013.

    It stops after 100 iterations, or where potentials change by less than 0.1 in all.
    """
    cost = (one.unsqueeze(1) - other.unsqueeze(0)).square().sum(-1)
    share = math.log(1 / len(one) + 1e-8)
    row, column = torch.zeros(len(one)), torch.zeros(len(one))
    for _ in range(100):
        before = row
        row = spread * (share - ((-cost + row.unsqueeze(1) + column) / spread).logsumexp(1)) + row
        column = spread * (share - ((-cost + row.unsqueeze(1) + column) / spread).logsumexp(0)) + column
        if float((row - before).abs().sum()) < 0.1:
            break
    return float((((-cost + row.unsqueeze(1) + column) / spread).exp() * cost).sum())


def discrepancy(one: Tensor, other: Tensor) -> float:
    """Return the maximum mean discrepancy of points (N, 2), by five Gaussians about the mean distance."""
    both, n = torch.cat((one, other)), len(one)
    squared = (both.unsqueeze(0) - both.unsqueeze(1)).square().sum(-1)
    width = squared.sum() / (4 * n * n - 2 * n) / 4
    kernel = torch.stack([(-squared / (width * 2**power)).exp() for power in range(5)]).sum(0)
    return float(kernel[:n, :n].mean() + kernel[n:, n:].mean() - 2 * kernel[:n, n:].mean())


def collisions(walk: NDArray[np.float64]) -> int:
    """Return in how many frames people are too near to another, both counted, but for companions."""
    total = np.zeros((walk.shape[1], walk.shape[1]), dtype=int)
    for place in walk:
        near = np.linalg.norm(place[:, None] - place[None], axis=-1) < NEAR
        np.fill_diagonal(near, val=False)
        total += near
    return int(total[total <= FRIENDS].sum())


class Job(NamedTuple):
    """A policy, as sampled or in the mean."""

    policy: str
    mean: bool
    root: str | None

    @property
    def label(self) -> str:
        """What is said while it is done."""
        return f"{self.policy}{', mean' * self.mean}"


def work(job: Job) -> list[dict[str, Any]]:
    """Walk the clip and return one row: the mean of the seeds."""
    started = time.perf_counter()
    clip = Clip.of(Tracks.read(Gc("gc", job.root).folder / "gc_2344.csv"))
    seeds: Sequence[int | None] = [None] if job.mean or job.policy == STRAIGHT else range(SEEDS)
    each = [scores(clip, simulated(clip, job.policy, seed)) for seed in seeds]
    metrics = {key: float(np.mean([one[key] for one in each])) for key in each[0]}
    case = {"walk": "mean" if seeds[0] is None else f"sampled, {SEEDS} seeds"}
    row = {"name": job.policy, "case": case, "n": int(clip.scored.any(0).sum()), "metrics": metrics}
    return [
        row | {"real_collisions": collisions(clip.place), "seconds": round(time.perf_counter() - started, 2)}
    ]


class GrandCentral(Jobs):
    """Each policy on the clip, as sampled and in the mean."""

    title = "Grand Central: the closed-loop protocol of crowd simulation"
    stem = "GC"

    def __init__(
        self,
        models: Sequence[str] = (),
        options: EvaluationOptions | None = None,
        seeds: Sequence[int] = (0,),
        journal: Path | None = None,
    ) -> None:
        """Take policies instead of the usual ones. Raises UserError: an unknown one."""
        root = options.root if options else None
        jobs = {}
        for policy in (STRAIGHT, *(models or POLICIES)):
            if policy != STRAIGHT:
                load_policy(policy)
            entry = find(policy.partition(":")[0])
            code = entry.card.sha256 if entry else ""
            for mean in (False, True) if policy != STRAIGHT else (True,):
                job = Job(policy, mean, root)
                jobs[fingerprint(job, code, sha256_of(Path(__file__)))] = job
        super().__init__(jobs, work, journal)

    def report(self) -> dict[str, Any]:
        """Return all rows, and what others have printed."""
        protocol = {"clip": "gc_2344", "history_s": HISTORY * DT, "step_s": DT, "seeds": SEEDS}
        notes = ["everybody is simulated from 2 s after they come; no floor plan; no groups are told"]
        return {"protocol": protocol, "seeds": [0], "notes": notes, "rows": self.rows, "published": PUBLISHED}

    def pages(self, report: Mapping[str, Any]) -> list[ResultTable]:
        """Return the one table."""
        body = [
            [
                row["name"],
                row["case"]["walk"],
                *(f"{row['metrics'][key]:{form}}" for key, form in _COLUMNS.items()),
            ]
            for row in report["rows"]
        ]
        for name, values in PUBLISHED.items():
            body.append([name, "published", *("-" if value is None else f"{value:g}" for value in values)])
        if report["rows"]:
            body.append(["real", "", "0", "0", "0", str(report["rows"][0]["real_collisions"])])
        return [
            ResultTable(
                "clip 2344 to 2404 s", ["policy", "walk", "MAE, m", "OT, m2", "MMD", "collisions"], body, 2
            )
        ]


_COLUMNS = {"mae_m": ".3f", "ot_m2": ".3f", "mmd": ".4f", "collisions": ".0f"}
