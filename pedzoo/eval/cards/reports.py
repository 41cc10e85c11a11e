"""How the reports on model cards are made: from their protocol alone, so that they can be made again."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NotRequired, get_args

from typing_extensions import TypedDict

from pedzoo.core import renamed
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.machine import versions
from pedzoo.core.types import GoalProtocol, TimeBase
from pedzoo.data.datamodule import PROTOCOL, TrajectoryDataModule
from pedzoo.eval.evaluate import Evaluation
from pedzoo.eval.forecast import STAGES, forecast_row
from pedzoo.eval.suite import EvaluationOptions
from pedzoo.eval.workers.progress_meter import ProgressReport
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.typed_fields import check, refuse_code

Progress = Callable[[str, int, int], None]
Report = dict[str, Any]


class Job(NamedTuple):
    """What a report is made of and with; ``progress`` is called as in `pedzoo.eval.cards.numbers.measure`."""

    model: str
    protocol: Mapping[str, Any]
    seeds: Sequence[int]
    root: str | None = None
    workers: int = 1
    progress: Progress | None = None


def report_of(command: str, job: Job) -> Report:
    """Return the report of ``forecast`` or ``evaluate`` on one model; of the latter, the rows of its tables.

    Raises:
        UserError: The recordings are absent, or the protocol asks for something unknown.
    """
    if command not in _MAKERS:
        raise UserError(f"no way to do {command!r} again: expected {' or '.join(_MAKERS)}")
    form, make = _MAKERS[command]
    job = job._replace(protocol=renamed.new_keys(job.protocol))
    check(job.protocol, form, f"protocol of {command}:")
    refuse_code(job.protocol, f"protocol of {command}", f"name it yourself, with pedzoo {command}")
    protocol, rows = make(job)
    content = {"protocol": protocol, "seeds": list(job.seeds), "versions": versions(), "rows": rows}
    return {"command": command, **content}


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
    how = protocol["samples"], job.seeds[0], protocol["split"], job.progress
    row = forecast_row(job.model, load(job.model), data, *how)
    row["case"] = only(protocol, ("fold", "split")) | row["case"]
    return dict(protocol), [row]


def _walks(job: Job) -> tuple[Report, list[Report]]:
    asked: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in only(job.protocol, EvaluationOptions._fields).items()
    }
    options = EvaluationOptions(**asked)._replace(root=job.root)
    still = job.protocol.get("deterministic", False)
    evaluation = Evaluation([job.model], job.protocol["suites"], options, job.seeds, still)

    def tell(step: ProgressReport) -> None:
        if job.progress:
            job.progress(about(job.protocol), step.units, step.total)

    evaluation.run(job.workers, progress=tell)
    result = evaluation.report()
    # a folder is not the same on another machine, and what was not asked for needs no word
    protocol = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in result["protocol"].items()
        if key != "root" and value
    }
    rows = []
    for row in result["summary"]:
        shown = evaluation.shown[row["case"]["suite"]].columns
        rows.append(row | {key: only(row[key], shown) for key in ("metrics", "ci95")})
    return protocol, rows


class _Forecast(TypedDict):
    fold: str
    goal: str
    clock: str
    keep_people: str
    split: str
    obs_len: int
    pred_len: int
    min_people: int
    samples: int


class _Walks(TypedDict):
    suites: list
    quick: NotRequired[bool]
    deterministic: NotRequired[bool]
    physics: NotRequired[str]
    maps: NotRequired[list]
    episodes: NotRequired[int]
    rollouts: NotRequired[int]
    people: NotRequired[list]
    robot: NotRequired[str]


_MAKERS = {"forecast": (_Forecast, _forecasts), "evaluate": (_Walks, _walks)}
"""By the command: the type of its protocol, and the function that makes the report."""
