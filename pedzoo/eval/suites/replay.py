"""Recorded crowds: people walk from their real entry to their real exit, beside the real ones."""

import hashlib
from collections.abc import Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any, ClassVar, cast

from pedzoo.core.errors import UserError
from pedzoo.core.registry import DATASETS
from pedzoo.core.spec import Spec
from pedzoo.data.recordings import Fold, find_fold, grids_of, open_fold
from pedzoo.eval.realism import REAL, reference_rows, replay_row
from pedzoo.eval.results import SEEN
from pedzoo.eval.scoring.rows import HALVES, SPLITS
from pedzoo.eval.suite import (
    QUICK,
    EvaluationCase,
    EvaluationOptions,
    OwnRecordings,
    ShareDone,
    Suite,
    WorkUnit,
    kept_episodes,
    prepared,
    walk_unit,
)
from pedzoo.eval.trained_on import for_fold, has_seen
from pedzoo.maps.plans import load_plan
from pedzoo.metrics.realism.crowds import TAIL
from pedzoo.metrics.realism.features import FEATURES
from pedzoo.policies.load import load_policy
from pedzoo.policies.walker import has_noise
from pedzoo.sim.scenarios.replay import PreparedReplay

EMBEDDED = "embedded"
"""The fold that needs no recordings."""

OWN = "files"
"""What tables call recordings of one's own."""

SIMULATED = ("all", "one")
"""All people at once, or one person among all others as they were recorded."""

ROLLOUTS = 3
"""Of a policy with noise, if all are simulated; where every person has a scene, one of each is enough."""


class Replay(Suite):
    """Two cases for every fold, and rows of the real crowd in each.

    Weights ``ARCH.FOLD`` of the zoo are exchanged for those that have not seen the fold that is walked, where
    there are any. ``simulated`` is some of `SIMULATED`.
    """

    simulated: ClassVar[tuple[str, ...]] = SIMULATED
    accepted_options = ("rollouts", "folds", "own")
    warm_start = "recorded"
    counted = "people"
    headline = ("realism", "success")
    columns = (
        *("realism", "success", "deadlock", "time_ratio_median", "closed_loop_ade_m", "dtw_m"),
        *(f"w1_{name}" for name in FEATURES),
        "density_speed_rmse_m_per_s",
        *(f"acceleration_{name}_ratio" for name in TAIL),
        *("agent_contact_excess", "agent_contact_excess_per_min", "wall_contact_excess_per_min"),
        *("intervention_share", "intervention_m"),
    )

    def cases(self, options: EvaluationOptions) -> list[EvaluationCase]:
        """Return two cases for each fold of which there are recordings, else for the embedded one.

        Of recordings of one's own there are two cases for all files together.

        Raises:
            UserError: A folder was asked for that has none, or a file is refused.
        """
        sources: list[tuple[str, str, dict[str, Any], str, float]] = []
        if options.own:
            given = options.own._asdict() | {"files": [*options.own.files], "speed": "estimated"}
            settings = {key: value for key, value in given.items() if value is not None}
            sources = [(OWN, OWN, settings, _digest_of_own(options.own), 1.0)]
        for fold, known in _folds(options).items():
            where = {} if options.root is None or fold == EMBEDDED else {"root": options.root}
            settings, inputs = {"fold": fold} | where, digest_of(fold, options.root)
            sources.append((known.name, fold, settings, inputs, _share(known)))
        result = []
        for (name, together, settings, inputs, share_of_one), simulated in product(sources, self.simulated):
            share = share_of_one if simulated == "one" else 1.0
            share = round(share / QUICK, 3) if options.quick else share
            first = {"share": share} if share < 1 else {}
            case = self.case(
                options,
                f"{name} {simulated}",
                Spec("replay", settings | {"simulated": simulated} | first),
                1,
                {"fold": name, "simulated": simulated},
                inputs=inputs,
                effort=100.0 * share,
                table=f"{self.name} {simulated}",
                shares=together,
            )
            result.append(case._replace(episodes=_rounds(options)[simulated]))
        return result

    def notes(self, options: EvaluationOptions, policies: Sequence[str]) -> list[str]:
        """Return what the real rows are, what is missing, and which weights walk where."""
        folds, rounds = _folds(options), _rounds(options)
        each = {"all": f"{rounds['all']} x where all are simulated", "one": f"{rounds['one']} x where one is"}
        often = ", ".join(each[simulated] for simulated in self.simulated)
        result = [
            f"{REAL} are the recorded people; {HALVES} one half of them against the other, mean "
            f"and 95 % of {SPLITS} random splits: the noise floor",
            f"models with noise walk {often}; others once",
        ]
        if [*folds] == [EMBEDDED]:
            result.append(
                "no recordings of ETH/UCY (get them: pedzoo download eth_ucy): the embedded ones alone"
            )
            folds = {}
        if "one" in self.simulated and not options.quick:
            for fold, known in folds.items():
                if (share := _share(known)) < 1:
                    result.append(f"one of those who come in the first {share:.0%} of {fold}")
        for policy in policies:
            walks = {fold: for_fold(policy, fold) for fold in folds}
            if others := [name for name in dict.fromkeys(walks.values()) if name != policy]:
                result.append(f"{policy} is {', '.join(others)} on the folds that these did not see")
            if seen := [fold for fold, name in walks.items() if has_seen(name, fold)]:
                result.append(f"{policy} was trained on {', '.join(seen)}: marked *")
        return [f"{self.name}: {note}" for note in result]

    def units(
        self, case: EvaluationCase, policies: Sequence[str], seeds: tuple[int, ...], deterministic: bool
    ) -> list[WorkUnit]:
        """Return the work on a case: the policies', and that on the real crowd."""
        fold = _walked_fold(case)
        units = [WorkUnit(name, for_fold(name, fold), case, seeds, deterministic) for name in policies]
        return [*units, WorkUnit(REAL, REAL, case, (0,), True)]

    def rows(self, unit: WorkUnit, tell: ShareDone | None = None) -> list[dict[str, Any]]:
        """Walk one unit; policies without noise walk once."""
        case = unit.case
        scenario = cast(PreparedReplay, prepared(case.scenario, case.inputs, case.clearance, case.planner))
        if unit.walks == REAL:
            rows = reference_rows(scenario, unit.metrics)
            if unit.keep_episodes:
                rows[0] |= kept_episodes(unit, next(iter(scenario.real_parts())), scenario.bank)
        else:
            model = load_policy(unit.walks)
            noise = has_noise(model) and not unit.deterministic
            seeds, rounds = (unit.seeds, case.episodes) if noise else (unit.seeds[:1], 1)
            parts = walk_unit(unit, scenario, seeds, rounds * scenario.scenes, tell)
            kept = kept_episodes(unit, first := next(parts), scenario.bank)
            walks = chain([first], parts)
            rows = [replay_row(unit.policy, walks, scenario, model.decision_dt, unit.metrics) | kept]
            if has_seen(unit.walks, _walked_fold(case)):
                rows[0]["case"] = rows[0]["case"] | {SEEN: "yes"}
        return [row | {"people": scenario.persons.counts} for row in rows]


def _rounds(options: EvaluationOptions) -> dict[str, int]:
    """Return how often a policy with noise walks, by who is simulated."""
    return {"all": options.rollouts or (1 if options.quick else ROLLOUTS), "one": options.rollouts or 1}


def _share(fold: Fold) -> float:
    """Return the first part of a fold's recordings of which each person is simulated alone."""
    return fold.constant("REPLAY_SHARE", {}).get(fold.name, 1.0)


def _folds(options: EvaluationOptions) -> dict[str, Fold]:
    """Return the folds that were asked for, else those that are there, else the embedded one; no files."""
    if options.own:
        return {}
    result, missing = dict.fromkeys(options.folds), []
    for fold in result:
        open_fold(fold, options.root, "true")
    for name in () if result else DATASETS.names():
        asked = DATASETS.constant(name, "REPLAYED") is not False
        folds = (DATASETS.constant(name, "FOLDS") or {}) if asked else {}
        for fold in (fold for fold, tested in folds.items() if tested and fold != EMBEDDED):
            try:
                open_fold(fold, options.root, "true")
            except UserError as error:
                missing.append(error)
            else:
                result[fold] = None
    if options.root is not None and not result:
        raise missing[0]
    return {fold: known for fold in result or [EMBEDDED] if (known := find_fold(fold))}


def _walked_fold(case: EvaluationCase) -> str:
    """Return the fold of a case; files of one's own are none, so that no weights have seen them."""
    return cast(Spec, case.scenario).settings.get("fold", OWN)


def _digest_of_own(own: OwnRecordings) -> str:
    """Return what tells files of one's own, and their floor plan, from any others."""
    result = hashlib.sha256()
    for file in (*own.files, *filter(None, (own.homography,))):
        if not Path(file).is_file():
            raise UserError(f"--data.files: no file at {file!r}: expected rows of frame, agent, x, y")
        result.update(Path(file).read_bytes())
    result.update(load_plan(own.map).digest.encode() if own.map else b"")
    return result.hexdigest()


def digest_of(fold: str, root: str | None) -> str:
    """Return what tells the test recordings and floor plans of a fold from any others.

    Raises:
        UserError: There are no such recordings.
    """
    if fold == EMBEDDED:
        return ""  # its files are pedzoo's
    result = hashlib.sha256()
    for recording in open_fold(fold, root, "true").recordings("test"):
        tracks = recording.tracks
        for values in (tracks.frame, tracks.agent, tracks.xy):
            result.update(values.tobytes())
        for plan in grids_of([recording]).values():
            result.update(plan.digest.encode())
    return result.hexdigest()
