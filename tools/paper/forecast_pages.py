"""The tables of forecasts: Table I beside ours, and forecasts with a floor beside published rows.

A row of a report has ``name``, ``case`` (``fold``, ``goal``, ``pred_len``), ``n``, ``blocks`` of time,
``metrics`` and ``ci95``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import fmean
from typing import Any

from pedzoo.eval.forecast import FEW
from pedzoo.eval.results import ResultTable
from tools.paper.base import interval_text, spread_text
from tools.paper.published import FOLDS, QUIRKS, RELEASED, TABLE_1, mean_errors

Row = Mapping[str, Any]
Keys = tuple[str, ...]
"""Names of metrics: of ADE and FDE by one way of scoring, or of another one alone."""

NATS = "nll_nats_per_step"
PER_SCENE, BEST = (
    ("min_ade_20_scene_m", "min_fde_20_scene_m"),
    ("min_ade_20_agent_m", "min_fde_20_agent_m"),
)
SCORED: dict[str, Keys] = {
    "most likely": ("ade_m", "fde_m"),
    "one random sample": ("ade_sampled_m", "fde_sampled_m"),
    "best of 20 per scene": PER_SCENE,
    "best of 20 per agent": BEST,
}
"""Ways of scoring of Table I."""

TRIVIAL = {"none": "constant_velocity", "window_end": "bent_line"}
"""What stands beside a row of the paper: the best untrained predictor with the same inputs."""

COLUMNS: dict[str, Keys] = {
    "most likely": ("ade_m", "fde_m"),
    "random": ("ade_sampled_m", "fde_sampled_m"),
    "best of 20": BEST,
    "FDE of the best by ADE": ("fde_of_min_ade_20_agent_m",),
    "missed by 2 m": ("miss_rate_20",),
    "nats per step": (NATS,),
    "calibration error": ("calibration_error",),
}
"""Ways of scoring of the forecasts with a floor."""

TARGETS = (
    ("anchors", "12", "none", "mean", BEST, (0.23, 0.40)),
    ("anchor_mlp", "12", "none", "mean", BEST, (0.215, 0.36)),
    ("anchor_net", "12", "none", "mean", BEST, (0.205, 0.335)),
    ("anchor_net", "12", "none", "without eth", BEST, (0.160, 0.272)),
    ("anchor_net_goal", "8", "window_end", "zara1", ("ade_m",), (0.058,)),
)
"""Model, steps, goal, where, metrics, and what they should be at most (with destinations: as Social GAN)."""


def table1_notes(missing: Mapping[str, str]) -> list[str]:
    """Return what has to be known to read the numbers of Table I."""
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
        "the paper's method: `sgan`, `sgan_goal` and `sgan_goal_map` are its three networks (social pooling,"
        " goal, AlexNet on the floor plan), and `social_vrnn` is its other baseline. All else is ours",
        "safety layer: none, since no person walks here. Residual: the paper's networks decode steps, and"
        " `approach_net` adds its output to the bent line to the goal, which stands beside it untrained. GAN:"
        " the paper's networks have an adversarial loss, other networks have none",
    ]
    reasons: dict[str, list[str]] = {}
    for name, why in missing.items():
        reasons.setdefault(why, []).append(name)
    return result + [f"not here, {why}: {', '.join(names)}" for why, names in reasons.items()]


def floor_notes(missing: Mapping[str, str]) -> list[str]:
    """Return what has to be known to read the numbers of forecasts with a floor."""
    result = [
        "Social GAN's windows: 8 observed steps of 0.4 s (benchmark clock), people seen throughout, at "
        "least two in a window; metres; each test scene is one that training and validation left out",
        "best of 20: each person's own best sample, the minima of ADE and of FDE apart, as everybody "
        "reports. It looks at the answer. `anchors`, 20 centroids of training futures without a network, is "
        "the floor",
        "models with anchors answer a best of 20 with their 20 modes; `random` draws modes by their "
        "probabilities, and people who would touch draw once more. `most likely` is the one best guess: of "
        "Social GAN noise zero, of models with anchors a further path that is trained to be least far "
        "off, of `anchors` the mean future",
        "nats per step: negative log-likelihood of displacements; missed: the share of people of whom all "
        "20 end more than 2 m off; calibration error: 0 is perfect, .25 a single guess",
        "how checkpoints are chosen: the epoch by the validation windows, the later minutes of the training "
        "scenes (`val/min_ade_20_agent`, with a goal `val/ade`), and so is the seed in the zoo",
        "how long: networks with goals 780 to 860 steps (univ, with a third of the windows, 1,190). "
        "anchor_net without a goal 40 epochs, 2,480 to 2,880 steps, on univ 56, 1,850 steps: with a second "
        "scene held out (`--data.hold_out SCENE`) its error falls until then, on univ without zara1 from "
        ".197 to .179, on zara1 without univ from .248 to .232, and stays there. anchor_mlp 40 epochs, on "
        "univ 120: held out, its error falls from .136 after 12 epochs to .128 (hotel, without zara2), from "
        ".189 to .182 (eth, without zara1), from .202 to .193 (univ, without zara1), and stays at .138 "
        "(zara1, without hotel)",
        "what was seen of test scenes on the way: first versions (another loss, a smaller network) "
        "were scored on them, anchor_mlp on all folds, anchor_net on all but eth, on zara1 several "
        "times. After that univ got more steps, the loss counted every person the same, the "
        "network became wider (both by the validation of zara1), and with a goal the best guess "
        "weighed 3 instead of 1. univ was scored once after 120 epochs (.223), before the held-out scene "
        "said 56. So these numbers are a little less blind than they should be",
        "eth has 181 people, each counted in every window: it moves by .035/.07 from seed to seed. "
        "Do not rank by it",
        f"what to ask of any such table: {'; '.join(QUIRKS)}",
    ]
    return [*result, f"not here: {', '.join(missing)}"] if missing else result


def table1_pages(report: Row) -> list[ResultTable]:
    """Return the paper beside ours, means, the released models, then every protocol and scoring by fold."""
    rows, means = [*report["rows"], *report["means"]], report["means"]
    folds = [*report["protocol"]["folds"], *(["mean"] if means else [])]
    result = [_paper(report["rows"])] if "zara1" in folds else []
    if means:
        result.append(_overview(means))
    if ratios := [line for pred_len in ("8", "12") for line in _ratios(means, pred_len)]:
        head = ["model", "released", "steps", "ours", "released", "ours / released"]
        result.append(ResultTable("Best of 20 per scene beside released models, means", head, ratios, 2))
    for block in report["blocks"]:
        mine = [row for row in rows if _case(row) == (block["pred_len"], block["goal"])]
        title = f"8 -> {block['pred_len']}, goal {block['goal']}"
        people = {row["case"]["fold"]: row["n"] for row in mine}
        head = [f"{fold} ({people[fold]})" if fold in people else fold for fold in folds]
        for scored, keys in SCORED.items():
            cells = _cells(mine, lambda row, keys=keys: _errors(row, keys))
            every = [(name, fold) for name in block["rows"] for fold in folds]
            gone = [one for one in every if f"{'.'.join(one)}{block['tag']}" in report["missing"]]
            body = _body(block["rows"], folds, dict.fromkeys(gone, "no weights") | cells)
            for model in RELEASED if block["goal"] == "none" and keys == PER_SCENE else ():
                errors = model["errors"][block["pred_len"]]
                errors = errors | {"mean": mean_errors(errors)}
                body.append([model["label"], *(_pair(errors[fold].values()) for fold in folds)])
            result.append(ResultTable(f"{title}: {scored}", ["model", *head], body, 1))
        known = [row for row in mine if NATS in row["metrics"]]
        names = list(dict.fromkeys(row["name"] for row in known))
        if len(names) > 1:  # the line alone is of no use
            said = f"{title}: negative log-likelihood, nats per person and step: lower is better"
            body = _body(names, folds, _cells(known, lambda row: _with_interval(row, NATS, 2)))
            result.append(ResultTable(said, ["model", *folds], body, 1))
    return [*result, *_chosen_seeds(report["training_seeds"])]


def _paper(rows: Sequence[Row]) -> ResultTable:
    mine = [row for row in rows if (row["case"]["fold"], row["case"]["pred_len"]) == ("zara1", "8")]
    by_name, body = {(row["name"], row["case"]["goal"]): row for row in mine}, []
    for printed in TABLE_1:
        ours, goal, line = printed["ours"], printed["goal"], TRIVIAL[printed["goal"]]
        untrained = f"{line}\n{_errors(by_name.get((line, goal)), SCORED['most likely'])}"
        cells = [_errors(by_name.get((ours, goal)), keys) for keys in SCORED.values()]
        names = [printed["label"], _pair(printed["errors"].values()), f"{ours}\ngoal {goal}"]
        body.append([*names, *cells, untrained])
    head = ["the paper's row", "paper", "here", *SCORED, "untrained"]
    return ResultTable("The paper's Table I (zara1, 8 -> 8) beside ours", head, body, 1)


def _overview(means: Sequence[Row]) -> ResultTable:
    """Return the means over the folds: protocols and models as rows, ways of scoring as columns."""
    body = []
    for row in sorted(means, key=lambda row: int(row["case"]["pred_len"])):
        values = row["metrics"]
        cells = [_pair([values[key] for key in keys], 3, " / ") for keys in SCORED.values()]
        nats = f"{values[NATS]:.2f}" if NATS in values else "-"
        body.append([f"8 -> {row['case']['pred_len']}", row["case"]["goal"], row["name"], *cells, nats])
    head = ["steps", "goal", "model", *SCORED, "nats per step"]
    return ResultTable("Means over the folds, ADE / FDE", head, body, 3)


def _ratios(means: Sequence[Row], pred_len: str) -> Iterator[list[str]]:
    """Yield our means over the folds beside those of the released models with the same parts."""
    for model in RELEASED:
        theirs = list(mean_errors(model["errors"][pred_len]).values())
        for row in means:
            if (row["name"], *_case(row)) == (model["ours"], pred_len, "none"):
                ours = [row["metrics"][key] for key in PER_SCENE]
                ratio = _pair(one / other for one, other in zip(ours, theirs, strict=True))
                names = [model["ours"], model["label"], f"8 -> {pred_len}"]
                yield [*names, _errors(row, PER_SCENE), _pair(theirs), ratio]


def _chosen_seeds(training: Mapping[str, Row]) -> list[ResultTable]:
    """Return the spread of the validation errors by which one of several trainings was chosen."""
    body = []
    for name, known in training.items():
        values = {seed: float(value) for seed, value in known["seeds"].items()}
        listed = ", ".join(f"{seed}: {value:.4f}" for seed, value in values.items())
        cells = [str(known["chosen_by"]), spread_text([*values.values()], 4), listed, str(known["seed"])]
        body.append([name, str(len(values)), *cells])
    head = ["weights", "seeds", "chosen by", "mean ± standard deviation", "each", "chosen seed"]
    title = "Spread over training seeds, in validation (from the model cards)"
    return [ResultTable(title, head, body, 1)] if body else []


def floor_pages(report: Row) -> list[ResultTable]:
    """Return all tables of forecasts with a floor."""
    folds = list(report["protocol"]["folds"])
    rows = [*report["rows"], *report["means"]]
    pages = [_targets(report["training"]), _published(report, rows, folds)]
    for block in report["blocks"]:
        mine = [row for row in rows if _case(row) == (block["pred_len"], block["goal"])]
        title, goal = f"8 -> {block['pred_len']}, goal {block['goal']}", block["goal"] != "none"
        names = [name for name in block["rows"] if any(row["name"] == name for row in mine)]
        if goal or block["pred_len"] != "12":
            keys = COLUMNS["most likely" if goal else "best of 20"]
            what = "most likely" if goal else "best of 20 per person"
            body = _body(names, [*folds, "mean"], _cells(mine, lambda row, keys=keys: _numbers(row, keys)))
            pages.append(ResultTable(f"{title}: {what}, ADE / FDE", ["model", *folds, "mean"], body, 1))
        where = "mean" if len(folds) > 1 else folds[0]
        there = {row["name"]: row for row in mine if row["case"]["fold"] == where}
        body = [
            [name, *(_numbers(there[name], keys) for keys in COLUMNS.values())]
            for name in names
            if name in there
        ]
        pages.append(ResultTable(f"{title}: every column, {where}", ["model", *COLUMNS], body, 1))
    return [page for page in [*pages, _seeds(report["training"], folds)] if page.rows]


def _published(report: Row, rows: Sequence[Row], folds: Sequence[str]) -> ResultTable:
    """Return our rows of 8 -> 12 beside those of others; ours are the zoo's weights."""
    mine = [row for row in rows if _case(row) == ("12", "none")]
    names, places = list(dict.fromkeys(row["name"] for row in mine)), [*folds, "mean"]
    body = _body(names, places, _cells(mine, lambda row: _numbers(row, BEST)))
    for line in body:
        rest = [row["metrics"] for row in mine if row["name"] == line[0] and row["case"]["fold"] in FOLDS[1:]]
        mean = {key: fmean(one[key] for one in rest) for key in BEST} if len(rest) == len(FOLDS[1:]) else {}
        note = "a single guess" if line[0] == "constant_velocity" else "none"
        line += [_numbers({"metrics": mean}, BEST), note]
    for peer in report["published"]:
        by_fold = dict(zip(FOLDS, peer["folds"], strict=False))
        known = by_fold | {"mean": peer["mean"]}
        if by_fold:
            known["rest"] = mean_errors({fold: by_fold[fold] for fold in FOLDS[1:]})
        cells = [_pair(known[one].values(), 2, " / ") if one in known else "-" for one in (*places, "rest")]
        body.append([f"*{peer['name']}*", *cells, peer["leak"]])
    head = ["8 -> 12, goal none", *places, "without eth", "leak"]
    return ResultTable("Best of 20 per person, ADE / FDE, beside published rows", head, body, 1)


def _seeds(training: Sequence[Row], folds: Sequence[str]) -> ResultTable:
    """Return mean and standard deviation over training seeds, by fold."""
    body, by_name = [], {}
    for row in training:
        by_name.setdefault((row["name"], *_case(row)), {})[row["case"]["fold"]] = row["seeds"]
    for (name, pred_len, goal), by_fold in by_name.items():
        if not name.startswith("anchor"):
            continue
        keys = COLUMNS["best of 20" if goal == "none" else "most likely"]
        seeds = [by_fold.get(place, ()) for place in (*folds, "mean")]
        cells = [
            " / ".join(spread_text([one[key] for one in each], 3) for key in keys) if each else "-"
            for each in seeds
        ]
        body.append([name, f"8 -> {pred_len}, {goal}", str(max(map(len, by_fold.values()))), *cells])
    head = ["model", "protocol", "seeds", *folds, "mean"]
    title = "Training seeds: best of 20 per person (with a goal: most likely), mean ± standard deviation"
    return ResultTable(title, head, body, 2)


def _targets(training: Sequence[Row]) -> ResultTable:
    """Return what was aimed at, what was reached by the mean of the seeds, and what is missing."""
    wanted: list[tuple[Any, ...]] = [*TARGETS]
    for fold in FOLDS:  # with destinations: the errors of Social GAN
        if rival := _reached(training, ("sgan_goal", "8", "destination"), fold, ("ade_m", "fde_m")):
            wanted.append(("anchor_net_goal", "8", "destination", fold, ("ade_m", "fde_m"), rival[0]))
    body = []
    for name, pred_len, goal, where, keys, most in wanted:
        case = [name, f"8 -> {pred_len}, {goal}", where, _pair(most, 3, " / ")]
        result = _reached(training, (name, pred_len, goal), where, keys)
        if result is None:
            body.append([*case, "-", "not measured"])
            continue
        values, seeds = result
        short = [f"{one - limit:.3f}" for one, limit in zip(values, most, strict=True) if one > limit]
        said = f"short by {', '.join(short)}" if short else "met"
        body.append([*case, f"{_pair(values, 3, ' / ')} ({seeds} seeds)", said])
    head = ["model", "protocol", "where", "at most", "mean of the seeds", "target"]
    return ResultTable("Targets", head, body, 3)


def _reached(
    training: Sequence[Row], what: tuple[str, str, str], where: str, keys: Keys
) -> tuple[list[float], int] | None:
    """Return the means of metrics over places and seeds, and of how many seeds; None where one lacks."""
    mine = {row["case"]["fold"]: row["seeds"] for row in training if (row["name"], *_case(row)) == what}
    places = FOLDS[1:] if where == "without eth" else [where]
    if any(place not in mine for place in places):
        return None
    seeds = min(len(mine[place]) for place in places)
    return [fmean(fmean(one[key] for one in mine[at][:seeds]) for at in places) for key in keys], seeds


def _case(row: Row) -> tuple[str, str]:
    return row["case"]["pred_len"], row["case"]["goal"]


def _cells(rows: Iterable[Row], text: Any) -> dict[tuple[str, str], str]:
    """Return the texts of rows by name and fold."""
    return {(row["name"], row["case"]["fold"]): text(row) for row in rows}


def _body(names: Iterable[str], folds: Sequence[str], cells: Mapping[Any, str]) -> list[list[str]]:
    """Return names as rows and folds as columns."""
    return [[name, *(cells.get((name, fold), "-") for fold in folds)] for name in names]


def _errors(row: Row | None, keys: Keys) -> str:
    """Return ADE and FDE of a row with their intervals, one below the other; a dash where there is none."""
    if row is None or keys[0] not in row["metrics"]:
        return "-"
    return "\n".join(_with_interval(row, key, 3) for key in keys)


def _with_interval(row: Row, key: str, digits: int) -> str:
    """Return a number with its interval, which a ~ marks where it is of few blocks of time."""
    ends = interval_text(row["ci95"].get(key), digits)
    return f"{row['metrics'][key]:.{digits}f} {'~' if ends and row['blocks'] < FEW else ''}{ends}".strip()


def _numbers(row: Row, keys: Keys) -> str:
    """Return the numbers of a row that it has, a dash where it has none."""
    return " / ".join(f"{row['metrics'][key]:.3f}" for key in keys if key in row["metrics"]) or "-"


def _pair(values: Iterable[float], digits: int = 2, between: str = "\n") -> str:
    return between.join(f"{value:.{digits}f}" for value in values)
