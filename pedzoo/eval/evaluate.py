"""The closed-loop evaluation: policies on suites of cases, in units that workers share."""

import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from functools import partial
from inspect import isabstract
from itertools import product
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError, as_integer, at_least_one, known_arguments
from pedzoo.core.machine import usable
from pedzoo.core.registry import SUITES
from pedzoo.eval.parallel import Backend, finished
from pedzoo.eval.results import SuiteColumns, summary
from pedzoo.eval.suite import EvaluationCase, EvaluationOptions, Suite, WorkUnit
from pedzoo.eval.work_units import Journal, Progress, ProgressReport, Rows, digest, work
from pedzoo.maps.planning.planner import planner_class
from pedzoo.metrics.closed_loop import NAMES, named
from pedzoo.sim.make import physics_class
from pedzoo.sim.scenario import check_deadline

SUITE_NAMES = ("door", "goals", "encounters", "replay")
"""What is evaluated unless something else is asked for."""

_IF_GIVEN = ("people", "robot", "own", "keep_episodes", "clearance", "planner", "deadline")
"""Options that a protocol names only where they are given."""

_LISTS = ("maps", "metrics", "folds", "people")
"""Options that may be one name, or several."""


@known_arguments(EvaluationOptions)
def evaluate(
    policies: Sequence[str],
    suites: Sequence[str] = SUITE_NAMES,
    *,
    seeds: Sequence[int] = (0,),
    deterministic: bool = False,
    workers: int = 1,
    backend: Backend = "processes",
    resume: str | Path | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Evaluate policies in closed loop and return the report that ``pedzoo evaluate`` prints and writes.

    Args:
        policies: Names with settings, or mixed crowds, as of `pedzoo.policies.load.load_policy`; of robots
            for the suite ``robots``.
        suites: ``door``, ``goals``, ``encounters`` and ``replay``; ``robots``; or ``file.py:Class``.
        seeds: Of the scenes. Their episodes count as one sample.
        deterministic: Models walk with noise zero.
        workers: Processes; the report is the same for any number.
        backend: What they are: ``processes`` of this machine, or ``ray``.
        resume: A file of finished parts: those are not done again.
        progress: Called whenever there is something to tell.
        options: Fields of `pedzoo.eval.suite.EvaluationOptions`: ``episodes``, ``quick``, ``physics``, ...

    Returns:
        ``protocol``; ``seeds``; ``notes``; ``rows``, one per policy and case; and ``summary``, one row per
        policy and table. A row has ``name``, ``table``, ``case``, ``n``, ``metrics``, ``ci95`` and
        ``per_agent``; with ``keep_episodes`` also ``episodes``, of which the report has the ``plans``.

    Raises:
        UserError: An unknown name, or a setting that cannot be, before anything has walked.
    """
    for key in _LISTS & options.keys():
        given = options[key]
        options[key] = tuple(map(str, (given,) if isinstance(given, str | Path) else given))
    if options.get("root") is not None:
        options["root"] = str(options["root"])
    evaluation = Evaluation(policies, suites, EvaluationOptions(**options), seeds, deterministic, resume)
    evaluation.run(workers, backend, progress)
    return evaluation.report()


class Evaluation:
    """All parts of an evaluation, and the rows of those that are done.

    Attributes:
        options: As suites read them.
        units: All of them, in the order of the report.
        resumed: How many were in the file of finished ones.
        others: How many in that file are of other units, weights, files or code.
        journal: That file, if there is one.
    """

    def __init__(
        self,
        policies: Sequence[str],
        suites: Sequence[str] = SUITE_NAMES,
        options: EvaluationOptions | None = None,
        seeds: Sequence[int] = (0,),
        deterministic: bool = False,
        resume: str | Path | None = None,
    ) -> None:
        """Say what is to be done; wrong names are refused here. Arguments and errors as of `evaluate`."""
        options = options or EvaluationOptions()
        self._policies = _names("policies", policies, "['orca', 'go_to_goal']")
        self._seeds = tuple(dict.fromkeys(as_integer("seeds", seed) for seed in seeds))
        if not self._seeds:
            raise UserError("no seeds: expected at least one")
        self._deterministic = deterministic
        self._suites = [_suite(name) for name in _names("suites", suites, "['door', 'goals']")]
        self.options = options = _checked(options, self._suites)
        given = {"device": options.device, "metrics": options.metrics, "keep_episodes": options.keep_episodes}
        self._columns = (*(name for name in options.metrics if name in NAMES), *named(options.metrics))
        for suite, policy in product(self._suites, self._policies):
            suite.check(policy)
        self.units: list[WorkUnit] = []
        for suite in self._suites:
            for case in _cases(suite, options):
                physics_class(case.physics).check()
                if options.clearance is not None:
                    case = case._replace(clearance=options.clearance)
                if options.planner is not None:
                    case = case._replace(planner=options.planner)
                if suite.warm_start != "recorded":  # people of recordings have the time that they took there
                    case = case._replace(deadline=options.deadline)
                units = suite.units(case, self._policies, self._seeds, deterministic)
                self.units += [unit._replace(**given) for unit in units]
        self._digests = [digest(unit) if resume else "" for unit in self.units]
        self.journal = Path(resume) if resume else None
        self._journal = Journal(self.journal)
        done = self._journal.done
        self._rows: dict[int, Rows] = {i: done[key] for i, key in enumerate(self._digests) if key in done}
        self.resumed = len(self._rows)
        self.others = len(done.keys() - set(self._digests))

    def run(self, workers: int = 1, backend: Backend = "processes", progress: Progress | None = None) -> None:
        """Do all units that are not done. Finished ones survive an interruption. See `evaluate`."""
        missing = [number for number in range(len(self.units)) if number not in self._rows]
        units = [self.units[number] for number in missing]
        weights = [unit.case.episodes * len(unit.seeds) * unit.case.effort for unit in self.units]
        start, total, before = time.perf_counter(), sum(weights), sum(weights[one] for one in self._rows)

        def tell(number: int, share: float = 0.0, seconds: float | None = None) -> None:
            if progress is None:
                return
            done = share * weights[number] + sum(weights[one] for one in self._rows)
            mine, passed = done - before, time.perf_counter() - start
            left = passed / mine * (total - done) if mine > 0 else None
            counts = done / total, len(self._rows), len(self.units)
            progress(ProgressReport(self.units[number].label, *counts, seconds, left))

        def told(unit: WorkUnit) -> Rows:
            return work(unit, partial(tell, self.units.index(unit)))

        if units:
            tell(missing[0])
        do = told if workers == 1 and backend == "processes" else work
        with closing(finished(units, do, workers, backend, lambda unit: unit.group)) as results:
            for place, rows in results:
                number = missing[place]
                self._rows[number] = rows
                self._journal.add(self._digests[number], rows)
                tell(number, seconds=rows[0]["seconds"]["wall"])

    @property
    def done(self) -> int:
        """How many units are finished."""
        return len(self._rows)

    def report(self) -> dict[str, Any]:
        """Return protocol, seeds, notes, summary and rows of all that is done."""
        rows = [dict(row) for number in sorted(self._rows) for row in self._rows[number]]
        plans = {name: plan for row in rows for name, plan in row.pop("plans", {}).items()}
        options = self.options
        protocol: dict[str, Any] = {"suites": [suite.name for suite in self._suites]}
        protocol |= {key: value for key, value in options._asdict().items() if key not in _IF_GIVEN or value}
        if options.own:
            protocol["own"] = options.own._asdict()
        protocol["deterministic"] = self._deterministic
        protocol["warm_start"] = {suite.name: suite.warm_start for suite in self._suites}
        notes = [note for suite in self._suites for note in suite.notes(options, self._policies)]
        result = {"protocol": protocol, "seeds": list(self._seeds), "notes": notes}
        return result | {"summary": summary(rows), "rows": rows} | ({"plans": plans} if plans else {})

    @property
    def shown(self) -> dict[str, SuiteColumns]:
        """What tables show of each suite."""
        result = {}
        for suite in self._suites:
            columns = list(dict.fromkeys((*suite.columns, *self._columns)))
            result[suite.name] = SuiteColumns(suite.headline, columns, suite.counted, suite.legend)
        return result


def _names(what: str, given: Sequence[str], example: str) -> list[str]:
    """Return ``given`` without repetitions; a single name need not be in a list."""
    names = [given] if isinstance(given, str) else [*given] if isinstance(given, Iterable) else [None]
    if not names:
        raise UserError(f"no {what}: expected at least one")
    if not all(isinstance(name, str) for name in names):
        raise UserError(f"{what} {given!r:.200}: expected a name, or one list of names, as {example}")
    return list(dict.fromkeys(map(str, names)))


def _suite(name: str) -> Suite:
    cls = SUITES.get(name, Suite)
    if isabstract(cls):
        raise UserError(f"suite {name!r} has no cases: write its method cases(self, options)")
    if getattr(suite := cls(name), "name", None) != name:
        raise UserError(f"suite {name!r} does not keep its name: call super().__init__(name) in its __init__")
    return suite


def _cases(suite: Suite, options: EvaluationOptions) -> list[EvaluationCase]:
    """Return the cases of a suite; one in a file may return anything."""
    cases = suite.cases(options)
    is_list = isinstance(cases, list) and bool(cases)
    if not is_list or not all(isinstance(case, EvaluationCase) for case in cases):
        raise UserError(
            f"suite {suite.name!r}: its cases(options) returned {cases!r:.200}, expected a list of one or "
            "more pedzoo.eval.suite.EvaluationCase"
        )
    for case in cases:
        if case.suite != suite.name:
            raise UserError(
                f"suite {suite.name!r}: its case {case.name!r} is of the suite {case.suite!r}, in whose "
                "table it would stand; write EvaluationCase(suite=self.name, ...)"
            )
    return cases


def _checked(options: EvaluationOptions, suites: Sequence[Suite]) -> EvaluationOptions:
    """Return options that are of use to the suites, with Python's own numbers; errors as of `evaluate`."""
    usable(options.device)
    if options.own and options.folds:
        raise UserError("--data.files are instead of --data.fold: leave one of them out")
    if (kept := as_integer("keep_episodes", options.keep_episodes)) < 0:
        raise UserError(f"keep_episodes {kept}: expected 0 or more")
    numbers = {"episodes": options.episodes, "rollouts": options.rollouts}
    known = {key: at_least_one(key, number) for key, number in numbers.items() if number is not None}
    if any("robot" in suite.accepted_options for suite in suites):
        if options.clearance is not None:
            raise UserError("clearance: ways beside robots keep that of the bodies: leave it or robots out")
        if options.planner is not None:
            raise UserError("planner: ways beside robots are the shortest: leave it or robots out")
        if options.deadline is not None:
            raise UserError("deadline: robots have their own times: leave it or robots out")
    if options.clearance is not None and options.clearance < 0:
        raise UserError(f"clearance {options.clearance}: expected at least 0 m")
    if options.planner is not None:
        planner_class(options.planner)
    if options.deadline is not None:
        check_deadline(options.deadline)
    for key in ("episodes", "maps", "rollouts", "folds", "people", "robot", "own"):
        if getattr(options, key) and not any(key in suite.accepted_options for suite in suites):
            others = {name: getattr(SUITES.get(name), "accepted_options", ()) for name in SUITES.names()}
            users = ", ".join(name for name, accepted in others.items() if key in accepted)
            given = ", ".join(suite.name for suite in suites)
            raise UserError(f"{key}: no use for them in {given}; {users} would have")
    return options._replace(keep_episodes=kept, **known)
