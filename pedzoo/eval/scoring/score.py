"""A score of simulated crowds against a recorded one: one report of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from pedzoo.core.errors import UserError, as_integer, at_least_one
from pedzoo.data.text_format import check_dt, is_recording
from pedzoo.eval.results import SEEN, ResultTable, cell
from pedzoo.eval.rollout import Progress, walked
from pedzoo.eval.scoring import likelihood as joint
from pedzoo.eval.scoring.crowds import (
    NothingToScoreError,
    ScoredCrowd,
    file_crowd,
    recorded_crowd,
    scored_crowd,
)
from pedzoo.eval.scoring.rows import RESAMPLES, real_rows, row, values_row
from pedzoo.eval.trained_on import for_fold, has_seen
from pedzoo.metrics.realism.features import FEATURES
from pedzoo.metrics.realism.walks import HEADWAYS, through
from pedzoo.metrics.realism.wosac import WEIGHTS
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise
from pedzoo.sim.make import prepare_scenario
from pedzoo.sim.scenarios.replay import PreparedReplay, Replay

VERSION = 3
"""Of the measures: it grows whenever a formula changes, so that only equal versions are compared."""

HEADLINE = "realism", "coarse_realism", "classifier_auc", "coarse_classifier_auc"
"""Measures whose absence is said."""

_CROWDES = ("density", "coverage", "population", "kinematics", "dtw", "diversity", "collision")

TABLES = {
    "how near to the real crowd": (
        *HEADLINE,
        *("coarse_acceleration_p95_ratio", "coarse_acceleration_p99_ratio"),
    ),
    "realism by feature, coarse positions": tuple(f"coarse_w1_{name}" for name in FEATURES),
    "likelihood of what people did (8 s, 32 joint rollouts), and distance to it": (
        *("likelihood", *(f"likelihood_{name}" for name in WEIGHTS)),
        *("ade_8s_m", "min_ade_20_8s_m", "closed_loop_ade_m", "closed_loop_min_ade_3_m"),
    ),
    "standing, company and touching": (
        *("standing_share", "company_share", "companions_near_share", "lane_order"),
        *("agent_contacts_per_min", "wall_contacts_per_min"),
    ),
    "the opening": (
        *("opening_through_share", "specific_flow_per_m_s"),
        *(f"opening_headway_{name}_s" for name in HEADWAYS),
    ),
    "columns of CrowdES": tuple(f"crowdes_{name}" for name in _CROWDES),
}
"""Columns of each table; the report has more."""


class Reference(NamedTuple):
    """The recording that crowds are scored against.

    Attributes:
        recording: A fold, or a file of one's own.
        dt: Seconds between consecutive frame numbers of a file.
        map: Its floor plan; None for no walls.
        homography: Text file of a 3x3 matrix from the file's positions to world metres.
        root: Folder of the folds; None for the variable ``PEDZOO_DATA``.
    """

    recording: str
    dt: float | None = None
    map: str | None = None
    homography: str | None = None
    root: str | None = None

    def prepared(self, stops: bool = False) -> PreparedReplay:
        """Return the recording as a replay, in which people have their stops as goals, too, or not.

        Raises:
            UserError: There is no such recording, or its file is refused.
        """
        own = is_recording(self.recording)
        source: dict[str, Any] = {"fold": self.recording, "root": self.root}
        source = {"files": [self.recording]} if own else source
        made = Replay(**source, dt=self.dt, map=self.map, homography=self.homography, stops=stops)
        return cast(PreparedReplay, prepare_scenario(made))


def score(
    crowds: Sequence[str],
    against: str | Reference,
    rollouts: int = 3,
    seed: int = 0,
    dt: float | None = None,
    physics: str = "compiled",
    likelihood: bool = True,
    stops: bool = False,
    opening: Sequence[float] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Return how near crowds are to a recorded one; ``docs/score.md`` has all formulas.

    Args:
        crowds: Files of walks, and policies, which walk in the recorded people's
            place. Weights ``ARCH.FOLD`` are exchanged for those that did not see the recording.
        against: A fold such as ``zara1``, or a file of one's own.
        rollouts: Of policies with noise.
        seed: Of the policies' noise.
        dt: Seconds between consecutive frame numbers in the files of ``crowds``; None for what they say, or
            rows that are 0.4 s apart.
        physics: In which policies walk.
        likelihood: Also walk the joint rollouts of 8 s; see `pedzoo.eval.scoring.likelihood`.
        stops: People whom policies move have the places where the recorded ones stood for 2 s or more as
            goals, and stay there as long. In the joint rollouts of 8 s they have their exits alone.
        opening: A door, whose flow and headways are measured: its centre x and y, the normal x and y of its
            wall, and its clear width; metres.
        progress: Called with a policy, its episodes that are over and episodes in all.

    Raises:
        UserError: An unknown policy, a number out of range, or a file that is refused.
    """
    against = Reference(against) if isinstance(against, str) else against
    own = is_recording(against.recording)
    rollouts, seed = at_least_one("rollouts", rollouts), as_integer("seed", seed)
    if own:
        check_dt(against.dt, "the file of --against", files=[against.recording])
    if dt is not None:
        check_dt(dt, "the scored files", "--dt")
    fold = "all" if own else against.recording
    walks = {name: name if own or is_recording(name) else for_fold(name, fold) for name in crowds}
    for weights in walks.values():
        if not is_recording(weights):
            load_policy(weights)  # misspelt names are refused before anything is measured
    gate = _gate(opening)
    prepared = against.prepared(stops)
    real = recorded_crowd(prepared)
    if (people := int(real.seen.sum())) < 2:
        raise UserError(
            f"{against.recording}: {people} recorded person can be scored, too few for distances in the "
            f"recording's own standard deviations: give --against a recording of at least 2 people"
        )
    files: dict[str, ScoredCrowd | None] = {}
    notes: list[str] = []
    for name in filter(is_recording, walks):  # a file is refused before anything takes long
        try:
            files[name] = file_crowd(name, prepared, dt)
        except NothingToScoreError as error:
            files[name] = None
            notes.append(f"nothing is scored: {error}")
    rows, windows, joined, count = real_rows(real), None, None, 0
    if gate is not None:
        rows[0]["metrics"] |= through(real.walks, gate)
    if likelihood:
        windows = joint.windows_of(prepared)
        joined, count = joint.recorded_windows(windows), len(windows.begin)
        others = joint.others_likelihood(joined, windows, fold)
        rows.append(values_row(joint.OTHERS, count, 1, others, count))
    for name, weights in walks.items():
        is_file, more = is_recording(name), {}
        if is_file:
            side = files[name]
        else:
            rounds = rollouts if has_noise(load_policy(weights)) else 1
            parts = walked(weights, prepared, physics, rounds * prepared.scenes, seed, progress=progress)
            side = scored_crowd(weights, parts, prepared, rounds=rounds)
        if side is None:
            rows.append(values_row(name, 0, 1, {}))
            continue
        if strangers := int((side.twin < 0).sum()):
            notes.append(f"{name}: {strangers} of {len(side.twin)} people are none of the recorded ones")
        if windows and joined and not is_file:
            simulated = joint.policy_windows(weights, windows, seed, physics, progress)
            more = joint.likelihood(simulated, joined, fold)
        rows.append(result := row(side._replace(name=name), real, more, count))
        if missing := [key for key in HEADLINE if key not in result["metrics"]]:
            notes.append(f"{name}: {result['n']} people walk too little for {', '.join(missing)}")
        if gate is not None:
            result["metrics"] |= through(side.walks, gate)
        if weights != name:
            notes.append(f"{name} is {weights}, which did not see {against.recording}")
        if not is_file and not own and has_seen(weights, against.recording):
            notes.append(f"{name} was trained on {against.recording}: marked *")
            result["case"][SEEN] = "yes"
    protocol = {"against": against.recording, "version": VERSION, "resamples": RESAMPLES, "stops": stops}
    return {"protocol": protocol, "seeds": [seed], "notes": notes, "rows": rows}


def _gate(opening: Sequence[float]) -> Tensor | None:
    """Return an opening as `through` takes it; None for none."""
    if not opening:
        return None
    gate = torch.tensor([*opening], dtype=torch.float32)
    if len(gate) != 5 or not float(gate[2:4].norm()) or not float(gate[4]) > 0:
        raise UserError(
            f"opening {[*opening]}: expected x,y of its centre, x,y of its wall's normal, and its width (m)"
        )
    gate[2:4] /= gate[2:4].norm()
    return gate


def pages(report: Mapping[str, Any]) -> list[ResultTable]:
    """Return the tables of a report of `score`; columns without numbers are out."""
    rows, result = report["rows"], []
    # files without their folders
    labels = [Path(row["name"]).name if is_recording(row["name"]) else row["name"] for row in rows]
    for title, columns in TABLES.items():
        known = [key for key in columns if any(key in row["metrics"] for row in rows)]
        body = [
            [label, str(row["n"]), *(cell(row, key) for key in known)]
            for label, row in zip(labels, rows, strict=True)
            if any(key in row["metrics"] for key in known)
        ]
        if known:
            result.append(ResultTable(title, ["crowd", "n", *known], body, 2))
    telling = [
        [label, test, feature, f"{share:.0%}"]
        for label, row in zip(labels, rows, strict=True)
        for test, features in row.get("telling", {}).items()
        for feature, share in features.items()
    ]
    if telling:
        head = ["crowd", "test", "feature", "share of gain"]
        result.append(ResultTable("what the classifier goes by", head, telling, 3))
    return result
