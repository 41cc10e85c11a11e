"""The tables of Table I's reproduction: the paper's row by row, means of everything, and every fold."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pedzoo.eval.forecast import FEW
from pedzoo.eval.results import ResultTable
from tools.paper.base import interval_text
from tools.paper.folds import mean_errors
from tools.paper.line_density import NATS
from tools.paper.paper import RELEASED, TABLE_1, Errors


class Scored(NamedTuple):
    """A way of scoring.

    Attributes:
        title: What it is called.
        ade: Name of its ADE.
        fde: Name of its FDE.
    """

    title: str
    ade: str
    fde: str


PER_SCENE = Scored("best of 20 per scene", "min_ade_20_scene_m", "min_fde_20_scene_m")
SCORED = (
    Scored("most likely", "ade_m", "fde_m"),
    Scored("one random sample", "ade_sampled_m", "fde_sampled_m"),
    PER_SCENE,
    Scored("best of 20 per agent", "min_ade_20_agent_m", "min_fde_20_agent_m"),
)

TRIVIAL = {"none": "constant_velocity", "window_end": "bent_line"}
"""What stands beside a row of the paper: the best untrained predictor with the same inputs."""


def table1_pages(report: Mapping[str, Any]) -> list[ResultTable]:
    """Return the paper beside ours, means, the released models, then every protocol and scoring by fold."""
    rows, means = [*report["rows"], *report["means"]], report["means"]
    folds = [*report["protocol"]["folds"], *(["mean"] if means else [])]
    result = [_paper(report["rows"])] if "zara1" in folds else []
    if means:
        result.append(_overview(means))
    if ratios := [line for pred_len in (8, 12) for line in _ratios(means, pred_len)]:
        head = ["model", "released", "steps", "ours", "released", "ours / released"]
        result.append(
            ResultTable(f"{PER_SCENE.title.capitalize()} beside released models, means", head, ratios, 2)
        )
    for block in report["blocks"]:
        pred_len, goal = block["pred_len"], block["goal"]
        mine = [row for row in rows if (row["case"]["pred_len"], row["case"]["goal"]) == (pred_len, goal)]
        for scored in SCORED:
            title = f"8 -> {pred_len}, goal {goal}: {scored.title}"
            page = _folds(mine, block, folds, scored, title, report["missing"])
            if goal == "none" and scored == PER_SCENE:
                page.rows.extend(_released(int(pred_len), folds))
            result.append(page)
        result += _likelihoods(mine, folds, f"8 -> {pred_len}, goal {goal}: negative log-likelihood")
    return [*result, *_seeds(report["training_seeds"])]


def notes(missing: Mapping[str, str]) -> list[str]:
    """Return what has to be known to read the numbers."""
    result = [
        "8 observed steps of 0.4 s, Social GAN's windows (people seen throughout, at least two), every"
        " annotated step taken as 0.4 s; metres; test scenes that the weights were not trained on. Behind"
        " the folds the number of people, each counted in every window; the mean counts each fold the same",
        "in a cell ADE and below it FDE, in brackets their 95 % intervals by Student's t over blocks of time"
        f" as long as a window, since windows overlap. ~ marks those of fewer than {FEW} blocks (eth is"
        " short), rough. Intervals say nothing about other scenes nor other trainings: for"
        " these see the spread over training seeds",
        "most likely: the model's one best guess (for SGAN: noise zero). One random sample: what a single"
        " draw costs on average. Best of 20 looks at the answer: per scene one sample for all people of a"
        " window (Social GAN's), per agent each their own. Never compare one of these four with"
        " another; untrained lines have one future, which is all four",
        "goal `window_end` is the answer's own last position: the straight line to it has FDE 0 untrained."
        " `destination` is where the person was last recorded: where, not when",
        "nats per step: negative log-likelihood of the true displacements, metres, per person and step. Of"
        " social_vrnn it is an upper bound (20 draws of its latent); constant_velocity is given a Gaussian"
        " as wide at every step as the training windows stray from it",
        "the paper does not say how it scores samples; the column `paper` quotes its Table I",
    ]
    reasons: dict[str, list[str]] = {}
    for name, why in missing.items():
        reasons.setdefault(why, []).append(name)
    return result + [f"not here, {why}: {', '.join(names)}" for why, names in reasons.items()]


def _paper(rows: Sequence[Mapping[str, Any]]) -> ResultTable:
    by_name = {
        (row["name"], row["case"]["goal"]): row
        for row in rows
        if (row["case"]["fold"], row["case"]["pred_len"]) == ("zara1", "8")
    }
    body = []
    for printed in TABLE_1:
        ours = by_name.get((printed.ours, printed.goal))
        line = TRIVIAL[printed.goal]
        untrained = f"{line}\n{_errors(by_name.get((line, printed.goal)), SCORED[0])}"
        cells = [_errors(ours, scored) for scored in SCORED]
        names = [printed.label, _pair(printed.errors), f"{printed.ours}\ngoal {printed.goal}"]
        body.append([*names, *cells, untrained])
    head = [
        "the paper's row",
        "paper",
        "here",
        *(scored.title for scored in SCORED),
        "untrained",
    ]
    return ResultTable("The paper's Table I (zara1, 8 -> 8) beside ours", head, body, 1)


def _overview(means: Sequence[Mapping[str, Any]]) -> ResultTable:
    """Return the means over the folds: protocols and models as rows, ways of scoring as columns."""
    body = []
    for row in sorted(means, key=lambda row: int(row["case"]["pred_len"])):
        errors = [Errors(*(row["metrics"][key] for key in (scored.ade, scored.fde))) for scored in SCORED]
        nats = row["metrics"].get(NATS)
        case = [f"8 -> {row['case']['pred_len']}", row["case"]["goal"], row["name"]]
        body.append(
            [*case, *(_pair(pair, 3, " / ") for pair in errors), "-" if nats is None else f"{nats:.2f}"]
        )
    head = ["steps", "goal", "model", *(scored.title for scored in SCORED), "nats per step"]
    return ResultTable("Means over the folds, ADE / FDE", head, body, 3)


def _folds(
    rows: Sequence[Mapping[str, Any]],
    block: Mapping[str, Any],
    folds: Sequence[str],
    scored: Scored,
    title: str,
    missing: Mapping[str, str],
) -> ResultTable:
    """Return one way of scoring: models as rows, folds as columns."""
    cells = {(row["name"], row["case"]["fold"]): _errors(row, scored) for row in rows}

    def shown(name: str, fold: str) -> str:
        none = "no weights" if f"{name}.{fold}{block['tag']}" in missing else "-"
        return cells.get((name, fold), none)

    people = {row["case"]["fold"]: row["n"] for row in rows}
    head = [f"{fold} ({people[fold]})" if fold in people else fold for fold in folds]
    body = [[name, *(shown(name, fold) for fold in folds)] for name in block["rows"]]
    return ResultTable(title, ["model", *head], body, 1)


def _released(pred_len: int, folds: Sequence[str]) -> Iterator[list[str]]:
    for model in RELEASED:
        errors = model.errors[pred_len] | {"mean": mean_errors(model.errors[pred_len])}
        yield [model.label, *(_pair(errors[fold]) for fold in folds)]


def _ratios(means: Sequence[Mapping[str, Any]], pred_len: int) -> Iterator[list[str]]:
    """Yield our means over the folds beside those of the released models with the same parts."""
    for model in RELEASED:
        theirs = mean_errors(model.errors[pred_len])
        for row in means:
            if (row["name"], row["case"]["pred_len"], row["case"]["goal"]) == (
                model.ours,
                str(pred_len),
                "none",
            ):
                ours = Errors(row["metrics"][PER_SCENE.ade], row["metrics"][PER_SCENE.fde])
                ratio = _pair(Errors(ours.ade / theirs.ade, ours.fde / theirs.fde))
                yield [
                    model.ours,
                    model.label,
                    f"8 -> {pred_len}",
                    _errors(row, PER_SCENE),
                    _pair(theirs),
                    ratio,
                ]


def _likelihoods(rows: Sequence[Mapping[str, Any]], folds: Sequence[str], title: str) -> list[ResultTable]:
    known = [row for row in rows if NATS in row["metrics"]]
    cells = {(row["name"], row["case"]["fold"]): _with_interval(row, NATS, 2) for row in known}
    body = [
        [name, *(cells.get((name, fold), "-") for fold in folds)]
        for name in dict.fromkeys(row["name"] for row in known)
    ]
    page = ResultTable(f"{title}, nats per person and step: lower is better", ["model", *folds], body, 1)
    return [page] if len(body) > 1 else []  # the line alone is of no use


def _seeds(training: Mapping[str, Mapping[str, Any]]) -> list[ResultTable]:
    """Return the spread of the validation errors by which one of several trainings was chosen."""
    body = []
    for name, known in training.items():
        values = [float(value) for value in known["seeds"].values()]
        spread = f"{statistics.fmean(values):.4f}"
        spread += f" ± {statistics.stdev(values):.4f}" if len(values) > 1 else ""
        listed = ", ".join(f"{seed}: {float(value):.4f}" for seed, value in known["seeds"].items())
        body.append([name, str(len(values)), str(known["chosen_by"]), spread, listed, str(known["seed"])])
    head = ["weights", "seeds", "chosen by", "mean ± standard deviation", "each", "chosen seed"]
    return (
        [ResultTable("Spread over training seeds, in validation (from the model cards)", head, body, 1)]
        if body
        else []
    )


def _errors(row: Mapping[str, Any] | None, scored: Scored) -> str:
    """Return ADE and FDE of a row with their intervals, one below the other; a dash where there is none."""
    if row is None or scored.ade not in row["metrics"]:
        return "-"
    return "\n".join(_with_interval(row, key, 3) for key in (scored.ade, scored.fde))


def _with_interval(row: Mapping[str, Any], key: str, digits: int) -> str:
    """Return a number with its interval, which a ~ marks where it is of few blocks of time."""
    ends = interval_text(row["ci95"].get(key), digits)
    return f"{row['metrics'][key]:.{digits}f} {'~' if ends and row['blocks'] < FEW else ''}{ends}".strip()


def _pair(errors: Errors, digits: int = 2, between: str = "\n") -> str:
    return between.join(f"{value:.{digits}f}" for value in errors)
