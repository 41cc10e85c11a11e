"""The numbers on a model card: measured for it, from a protocol alone, and measured again on request."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple, get_args

from msgspec import defstruct

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.machine import versions
from pedzoo.core.registry import ROBOT_POLICIES
from pedzoo.core.types import OBS_LEN, GoalProtocol, TimeBase
from pedzoo.core.untrusted import check, refuse_code
from pedzoo.data.datamodule import PROTOCOL, STAGES, TrajectoryDataModule
from pedzoo.data.recordings import find_fold
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.forecast import forecast_row, input_rows
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.models.zoo.card import ModelCard
from pedzoo.models.zoo.loading import load, saved_config

Progress = Callable[[str, int, int], None]
Report = dict[str, Any]

WALKS = [{"suites": [suite], "quick": True} for suite in ("door", "goals", "encounters")]
"""Where a card's model has walked, with a tenth of the episodes: that needs no files and takes a minute."""

MEASURED = ("inputs", "forecast", "evaluate")
"""What the reports on a card do, in their order."""

EMBEDDED = "embedded"
"""The fold that ships with pedzoo: its numbers can be redone anywhere."""

ROBOT_EPISODES = 20
"""Of every scene in which a card's robot has driven."""

SAMPLES, SEED = 20, 0

RELATIVE, ABSOLUTE = 1e-3, 1e-5
"""Tolerances of forecast errors, as a share and in metres: machines round differently."""


class RepeatedReport(NamedTuple):
    """A card's report, and that of today; None where it cannot be made here, and why not."""

    before: Report
    now: Report | None
    why: str = ""


class ComparedNumber(NamedTuple):
    """A number of a card beside the same one of today, None if there is none.

    ``case`` says whose it is: the fold and its part, or the suite. ``interval`` is the card's 95 % interval,
    where being inside it is being the ``same``; that is None where nothing says how much chance would differ.
    """

    case: str
    metric: str
    card: float
    now: float | None
    interval: Sequence[float] | None
    same: bool | None


def measure(
    model: str,
    name: str | None = None,
    root: str | None = None,
    progress: Progress | None = None,
    tell: Callable[[str], None] = print,
    commands: Sequence[str] = MEASURED,
) -> list[Report]:
    """Return the reports for a model's card.

    Forecast errors are those of the windows that the weights did not see, under the model's own goal
    protocol: of validation windows where no scene was left out. The embedded recordings follow, and the door,
    goals and encounters in closed loop; and which inputs the forecasts use, see `pedzoo.metrics.inputs`.

    Args:
        model: What `pedzoo.load` accepts of saved models.
        name: What the rows are called; None for ``model``.
        root: Folder with recordings; None for the variable ``PEDZOO_DATA``.
        progress: Called with what is done, its parts done and parts in all.
        tell: Called with what cannot be measured here.
        commands: Which reports, of `MEASURED`.

    Raises:
        UserError: There is no such model.
    """
    trained = saved_config(model).get("protocol")
    if not trained:
        raise UserError(f"{model!r} does not say on what it was trained: its numbers would have no protocol")
    own: Report = {key: trained[key] for key in PROTOCOL}
    fold = find_fold(own["fold"])
    own |= {"goal": load(model).goal_protocol or "none", "samples": SAMPLES}
    own["split"] = "val" if fold and fold.whole else "test"
    embedded = own | {"fold": EMBEDDED, "split": "test"}
    wanted = [("inputs", own), ("forecast", own), ("forecast", embedded)]
    if own["fold"] == EMBEDDED:
        wanted.pop()
    if own["obs_len"] == OBS_LEN:  # so many steps are seen by what walks
        wanted += [("evaluate", protocol) for protocol in WALKS]
    result = []
    for command, protocol in wanted:
        if command not in commands:
            continue
        try:
            report = report_of(command, Job(model, protocol, [SEED], root, progress=progress))
        except UserError as error:
            tell(f"not measured, {about(protocol)}: {error}")
        else:
            result.append(_for_card(report, name or model))
    return result


def measure_robot(name: str, people: str, robot: str) -> Report:
    """Return the report for the card of a robot's weights ``name``, in every scene of the suite ``robots``.

    ``people`` is the policy of the people in its training, ``robot`` its body.
    """
    protocol = {"suites": ["robots"], "episodes": ROBOT_EPISODES, "people": [people], "robot": robot}
    return _for_card(report_of("evaluate", Job(name, protocol, [SEED])), name)


def again(
    card: ModelCard,
    model: str | None = None,
    root: str | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[RepeatedReport]:
    """Do every evaluation of a card as the card says it was done; arguments as of `measure`.

    Raises:
        UserError: The card has no evaluation, or there is no such model.
    """
    model = model or card.name
    if not card.evaluations:
        raise UserError(f"the card of {card.name!r} has no evaluations: there is nothing to do again")
    if card.architecture not in ROBOT_POLICIES.names():
        load(model)
    result = []
    for before in card.evaluations:
        job = Job(model, before["protocol"], before["seeds"], root, workers, progress)
        try:
            result.append(RepeatedReport(before, report_of(str(before["command"]), job)))
        except UserError as error:
            result.append(RepeatedReport(before, None, str(error)))
    return result


def compare(before: Report, now: Report) -> list[ComparedNumber]:
    """Return every number of a card's report, ``before``, beside today's.

    Numbers are the same within `RELATIVE` or `ABSOLUTE`, or of walks inside the card's interval: on another
    machine a rounded digit sends an episode another way.
    """
    walks = before["command"] == "evaluate"
    today, result = {_case(row): row for row in now["rows"]}, []
    for row in before["rows"]:
        other = today.get(_case(row))
        others = {"n": other["n"], **other["metrics"]} if other else {}
        for metric, card in {"n": row["n"], **row["metrics"]}.items():
            value, interval = others.get(metric), row["ci95"].get(metric) if walks else None
            same: bool | None = value is not None
            if value is not None and not math.isclose(card, value, rel_tol=RELATIVE, abs_tol=ABSOLUTE):
                unknown_spread = None if walks and metric != "n" else False
                same = interval[0] <= value <= interval[1] if interval else unknown_spread
            result.append(ComparedNumber(_case(row), metric, card, value, interval, same))
    return result


def _for_card(report: Report, name: str) -> Report:
    """Return a report with rows called ``name``, without what a card does not need, and digits beyond six."""

    def short(value: Any) -> Any:
        return float(f"{value:.6g}") if isinstance(value, float | int) else [short(end) for end in value]

    rows = []
    for row in report["rows"]:
        rows.append({"name": name, **only(row, ("table", "case", "n", "cases"))})
        for kind in ("metrics", "ci95"):
            rows[-1][kind] = {key: short(value) for key, value in row[kind].items()}
    return report | {"rows": rows}


def _case(row: Report) -> str:
    """Return whose numbers a row has: a table's of the closed loop, or a fold's."""
    return str(row.get("table") or " ".join(map(str, row["case"].values())))


class Job(NamedTuple):
    """What a report is made of and with; ``progress`` is called as in `measure`."""

    model: str
    protocol: Mapping[str, Any]
    seeds: Sequence[int]
    root: str | None = None
    workers: int = 1
    progress: Progress | None = None


def report_of(command: str, job: Job) -> Report:
    """Return the report of ``forecast`` or ``inputs`` on one model, or the tables' rows of ``evaluate``.

    Raises:
        UserError: The recordings are absent, or the protocol asks for something unknown.
    """
    if command not in _MAKERS:
        raise UserError(f"no way to do {command!r} again: expected {' or '.join(_MAKERS)}")
    form, make = _MAKERS[command]
    check(job.protocol, form, f"protocol of {command}")
    refuse_code(job.protocol, f"protocol of {command}", f"name it yourself, with pedzoo {command}")
    protocol, rows = make(job)
    where = {"command": command, "protocol": protocol, "seeds": list(job.seeds)}
    return where | {"versions": versions(), "rows": rows}


def about(protocol: Mapping[str, Any]) -> str:
    """Return what a report is about, in words: the fold and its part, or the suites."""
    if "fold" in protocol:
        return f"{protocol['fold']} {protocol.get('split', '')}"
    return ", ".join(map(str, protocol.get("suites", [])))


def only(values: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Return the values of some keys, in the order of these."""
    return {key: values[key] for key in keys if key in values}


def _forecasts(job: Job) -> tuple[Report, list[Report]]:
    protocol = job.protocol
    if len(job.seeds) != 1:
        raise UserError(f"forecasts have one seed, not {list(job.seeds)}")
    for key, known in (("split", STAGES), ("goal", get_args(GoalProtocol)), ("clock", get_args(TimeBase))):
        if protocol[key] not in known:
            raise unknown(key, protocol[key], known)
    data = TrajectoryDataModule(root=job.root, **only(protocol, PROTOCOL))
    how = {"seed": job.seeds[0], "progress": job.progress, **only(protocol, ("samples", "split"))}
    row = forecast_row(job.model, load(job.model), data, **how)
    row["case"] = only(protocol, ("fold", "split")) | row["case"]
    return dict(protocol), [row]


def _inputs(job: Job) -> tuple[Report, list[Report]]:
    protocol = job.protocol
    data = TrajectoryDataModule(root=job.root, **only(protocol, PROTOCOL))
    how = {"seed": job.seeds[0], "split": protocol["split"], "progress": job.progress}
    return dict(protocol), input_rows(job.model, load(job.model), data, **how)


def _walks(job: Job) -> tuple[Report, list[Report]]:
    asked = only(job.protocol, EvaluationOptions._fields)
    lists: dict[str, Any] = {key: tuple(value) for key, value in asked.items() if isinstance(value, list)}
    options = EvaluationOptions(**asked | lists)._replace(root=job.root)
    still = job.protocol.get("deterministic", False)
    evaluation = Evaluation([job.model], job.protocol["suites"], options, job.seeds, still)
    tell = job.progress or (lambda *_: None)
    evaluation.run(job.workers, progress=lambda step: tell(about(job.protocol), step.units, step.total))
    result = evaluation.report()
    # a folder is not the same on another machine, and what was not asked for needs no word
    known = {key: value for key, value in result["protocol"].items() if key != "root" and value}
    lists = {key: list(value) for key, value in known.items() if isinstance(value, tuple)}
    rows = []
    for row in result["summary"]:
        shown = evaluation.shown[row["case"]["suite"]].columns
        rows.append(row | {key: only(row[key], shown) for key in ("metrics", "ci95")})
    return known | lists, rows


_TEXTS, _NUMBERS = "fold goal clock keep_people split", "obs_len pred_len min_people samples"
_FORECAST = defstruct("forecast", [*product(_TEXTS.split(), [str]), *product(_NUMBERS.split(), [int])])
_OPTIONAL = {"quick": bool, "deterministic": bool, "physics": str, "maps": list, "episodes": int}
_OPTIONAL |= {"rollouts": int, "people": list, "robot": str}
_WALKS = defstruct("evaluate", [("suites", list), *((*one, None) for one in _OPTIONAL.items())])

_MAKERS = {
    "forecast": (_FORECAST, _forecasts), "inputs": (_FORECAST, _inputs), "evaluate": (_WALKS, _walks)
}  # fmt: skip
"""By the command: the form of its protocol, and the function that makes the report."""
