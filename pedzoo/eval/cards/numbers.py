"""The numbers on a model card: measured for it, and measured again on request."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from pedzoo.core.errors import UserError
from pedzoo.core.registry import ROBOT_POLICIES
from pedzoo.core.renamed import OLD_SUITES
from pedzoo.core.types import OBS_LEN
from pedzoo.data.datamodule import PROTOCOL
from pedzoo.data.recordings import find_fold
from pedzoo.eval.cards.reports import Job, Progress, Report, about, only, report_of
from pedzoo.models.zoo.card import ModelCard
from pedzoo.models.zoo.loading import load
from pedzoo.models.zoo.saved_config import saved_config

WALKS = [{"suites": [suite], "quick": True} for suite in ("door", "goals", "encounters")]
"""Where a card's model has walked, with a tenth of the episodes: that needs no files and takes a minute."""

EMBEDDED = "embedded"
"""The fold that ships with pedzoo: its numbers can be redone anywhere."""

ROBOT_EPISODES = 20
"""Of every scene in which a card's robot has driven."""

SAMPLES, SEED = 20, 0

RELATIVE, ABSOLUTE = 1e-3, 1e-5
"""Tolerances of forecast errors, as a share and in metres: machines round differently."""


class RepeatedReport(NamedTuple):
    """An evaluation of a card, and the same one done now.

    Attributes:
        before: The card's report.
        now: Today's; None where it cannot be made here.
        why: Why not.
    """

    before: Report
    now: Report | None
    why: str = ""


class ComparedNumber(NamedTuple):
    """A number of a card beside the same one of today.

    Attributes:
        case: Whose number it is: the fold and its part, or the suite.
        metric: Its name.
        card: As the card has it.
        now: As it is today; None if there is none.
        interval: The card's 95 % interval, where being inside it is being the same.
        same: Whether they agree; None where they differ and nothing says how much chance would.
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
) -> list[Report]:
    """Return the reports for a model's card.

    Errors of forecasts on the windows that the weights did not see (on the validation windows where they left
    no scene out), by the model's own goal protocol; the same on the embedded recordings, which ship with
    pedzoo; and the closed loop at the door, from goal to goal and in encounters.

    Args:
        model: What `pedzoo.load` accepts of saved models.
        name: What the rows are called; None for ``model``.
        root: Folder with recordings; None for the variable ``PEDZOO_DATA``.
        progress: Called with what is done, its parts done and parts in all.
        tell: Called with what cannot be measured here.

    Raises:
        UserError: There is no such model.
    """
    trained = saved_config(model).get("protocol")
    if not trained:
        raise UserError(f"{model!r} does not say on what it was trained: its numbers would have no protocol")
    own: Report = {key: trained[key] for key in PROTOCOL}
    own |= {"goal": load(model).goal_protocol or "none", "samples": SAMPLES}
    fold = find_fold(own["fold"])
    own["split"] = "val" if fold and fold.whole else "test"
    embedded = own | {"fold": EMBEDDED, "split": "test"}
    wanted = [("forecast", own), ("forecast", embedded)][own["fold"] == EMBEDDED :]
    if own["obs_len"] == OBS_LEN:  # so many steps are seen by what walks
        wanted += [("evaluate", protocol) for protocol in WALKS]
    result = []
    for command, protocol in wanted:
        try:
            report = report_of(command, Job(model, protocol, [SEED], root, progress=progress))
        except UserError as error:
            tell(f"not measured, {about(protocol)}: {error}")
        else:
            result.append(_for_card(report, name or model))
    return result


def measure_robot(name: str, people: str, robot: str) -> Report:
    """Return the report for a robot's card: every scene of the suite ``robots``, among its own people.

    Args:
        name: The weights.
        people: Policy of the people in its training.
        robot: Its body.
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

    Numbers are the same within `RELATIVE` or `ABSOLUTE`. Those of the closed loop need not be on another
    machine, where a rounded digit sends an episode another way: they are the same inside the card's interval.
    """
    walks = before["command"] == "evaluate"
    today = {_case(row): row for row in now["rows"]}
    result = []
    for row in before["rows"]:
        numbers, other = {"n": row["n"], **row["metrics"]}, today.get(_case(row))
        others = {"n": other["n"], **other["metrics"]} if other else {}
        for metric, card in numbers.items():
            value, interval = others.get(metric), row["ci95"].get(metric) if walks else None
            same = _same(card, value, interval, chance=walks and metric != "n")
            result.append(ComparedNumber(_case(row), metric, card, value, interval, same))
    return result


_ROW = ("table", "case", "n", "cases", "metrics", "ci95")


def _for_card(report: Report, name: str) -> Report:
    """Return a report with rows called ``name``, without what a card does not need, and digits beyond six."""
    rows = []
    for row in report["rows"]:
        short = {"name": name, **only(row, _ROW)}
        short["metrics"] = {key: _short(value) for key, value in row["metrics"].items()}
        short["ci95"] = {key: [_short(end) for end in ends] for key, ends in row["ci95"].items()}
        rows.append(short)
    return report | {"rows": rows}


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _case(row: Report) -> str:
    """Return whose numbers a row has: a table's of the closed loop, or a fold's."""
    table = row.get("table", "")
    return str(OLD_SUITES.get(table, table) or " ".join(map(str, row["case"].values())))


def _same(card: float, now: float | None, interval: Sequence[float] | None, chance: bool) -> bool | None:
    if now is None:
        return False
    if math.isclose(card, now, rel_tol=RELATIVE, abs_tol=ABSOLUTE):
        return True
    if interval:
        return interval[0] <= now <= interval[1]
    return None if chance else False
