"""``pedzoo evaluate``: policies on suites of cases, and with ``--from-card`` the numbers on a model card."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pedzoo.cli.check import split_names, whole_numbers
from pedzoo.cli.output import (
    check_outputs,
    overall_bar,
    print_pages,
    print_tables,
    progress_bar,
    write_and_print,
    write_json,
    write_text,
)
from pedzoo.cli.parsing import command
from pedzoo.core.errors import UserError, at_least_one, need
from pedzoo.core.machine import versions

if TYPE_CHECKING:
    from pedzoo.eval.cards import ComparedNumber, RepeatedReport

_WITH_CARD = ("--from_card", "--from-card", "--data.root", "--workers", "--json")
_SAME = {True: "yes", False: "NO", None: "no interval"}


@command("pedzoo evaluate orca:radius=0.3 sgan_goal_map.zara1 --suite door,goals --quick --json out.json")
def evaluate(
    policies: list[str],
    /,
    suite: str = "door,goals,encounters,replay",
    seeds: str = "0",
    episodes: int | None = None,
    quick: bool = False,
    deterministic: bool = False,
    physics: str | None = None,
    rollouts: int | None = None,
    device: str = "cpu",
    robot: str | None = None,
    keep_episodes: int = 0,
    clearance: float | None = None,
    planner: Literal["shortest", "astar"] | None = None,
    deadline: float | None = None,
    backend: Literal["processes", "ray"] = "processes",
    resume: str | None = None,
    maps: tuple[str, ...] = (),
    metrics: list[str] | None = None,
    data_fold: list[str] | None = None,
    data_files: list[str] | None = None,
    data_dt: float | None = None,
    data_map: str | None = None,
    data_homography: str | None = None,
    people: str = "",
    data_root: str | None = None,
    workers: int = 1,
    from_card: bool = False,
    json: str | None = None,
    markdown: str | None = None,
    plot: str | None = None,
    *,
    argv: list[str],
) -> int:
    """The closed-loop table: policies on suites of cases, with intervals.

    Args:
        policies: orca:radius=0.3, go_to_goal, or any model; mixed crowds: orca:share=0.5+social_force.
        suite: Some suites between commas, also robots, crowdnav or file.py:Class.
        seeds: Of the scenes, between commas; they count as one sample.
        episodes: Per case and seed; by default the suites' own numbers. Not of recordings: see rollouts.
        quick: A tenth of the episodes, and of the time of recordings.
        deterministic: Models walk with noise zero.
        physics: ``compiled``, ``torch``, ``bullet`` or ``file.py:Class`` for all; by default the suites' own.
        rollouts: Of a policy with noise, on recordings; by default 3, or 1 if quick.
        device: Where scenes and policies are, such as ``cuda``.
        robot: The body of robots, ``diff_drive:radius=0.35``.
        keep_episodes: So many episodes of every row keep their positions, for ``pedzoo report``.
        clearance: Metres that planned ways keep from walls; by default the suites' own. Not of robots.
        planner: Ways that are as short as can be, or those of A* on the grid of open cells. Not of robots.
        deadline: Seconds that people have for every goal; by default four times as many as their way takes
            freely, at least 20. Not of robots and recordings.
        backend: What the workers are: ``processes`` of this machine, or ``ray``.
        resume: A file of finished parts: those are not done again.
        maps: Floor plans for five more cases of the suite goals: every episode draws one.
        metrics: More columns of all tables, as spl,mine.py:f: a function of a rollout that returns two sums
            per episode.
        data_fold: Folds for replay, as zara1,hotel or mine.py:Mine; by default all that are found.
        data_files: Recordings of your own for replay: .csv, .txt.
        data_dt: Seconds per frame number of these files.
        data_map: Their floor plan; by default no walls.
        data_homography: Their 3x3 matrix from positions to world metres.
        people: Who walks beside robots, between commas: orca,approach_net_goal_map.indoor,replay:fold=zara1.
        data_root: Recordings for replay; by default PEDZOO_DATA.
        workers: Processes; the table stays the same.
        from_card: Do what the models' cards say again, forecasts too. Exit code 1 where a number is another.
        json: Also write the report to this file.
        markdown: Also write the tables to this page.
        plot: Draw density and speed in replay into this .png, .pdf or .svg.
        argv: The command line.
    """
    from pedzoo.eval.evaluate import Evaluation
    from pedzoo.eval.results import markdown as page
    from pedzoo.eval.suite import EvaluationOptions, OwnRecordings

    at_least_one("--workers", workers)
    check_outputs(json=json, markdown=markdown, plot=plot, resume=resume)
    if from_card:
        options = [word.partition("=")[0] for word in argv if word.startswith("--")]
        if said := [option for option in options if option not in _WITH_CARD]:
            raise UserError(f"{said[0]}: --from-card does what the card says; leave it out")
        return _from_cards(policies, data_root, workers, json)
    suites = split_names(suite)
    if plot:
        need("video", "--plot")
        if "replay" not in suites:
            raise UserError(f"--plot {plot}: draws what the suite replay finds, which is not asked for")
    # finished parts lie beside the report until it is written
    beside = f"{json}.partial" if json and json != "-" else None
    own = OwnRecordings(tuple(data_files or ()), data_dt, data_map, data_homography)
    if not own.files and any(own[1:]):
        raise UserError("--data.dt, --data.map, --data.homography: of --data.files; folds have their own")
    settings: dict[str, Any] = {"episodes": episodes, "quick": quick, "physics": physics, "robot": robot}
    settings |= {"rollouts": rollouts, "device": device, "keep_episodes": keep_episodes, "root": data_root}
    settings |= {"clearance": clearance, "planner": planner, "deadline": deadline}
    settings |= {"own": own if own.files else None}
    lists = {"maps": maps, "metrics": metrics, "folds": data_fold, "people": split_names(people)}
    settings |= {key: tuple(value or ()) for key, value in lists.items()}
    numbers, options = whole_numbers("--seeds", seeds), EvaluationOptions(**settings)
    evaluation = Evaluation(policies, suites, options, numbers, deterministic, resume or beside)
    if evaluation.resumed:
        print(f"{evaluation.resumed} of {len(evaluation.units)} parts were done before: {evaluation.journal}")
    if evaluation.others:
        print(f"{evaluation.others} parts in {evaluation.journal} are of other commands, weights or code")

    def tell(**more: bool) -> None:
        report = {"command": "evaluate", **evaluation.report(), "versions": versions(), **more}

        def show() -> None:
            if markdown and not more:  # a page of half the parts would take a whole one's place
                write_text(markdown, page(report, evaluation.shown, ["pedzoo", "evaluate", *argv]))
            if plot and not more:
                from pedzoo.viz.plots import plot_density_speed

                plot_density_speed(report["rows"], plot)
            print_pages(report, evaluation.shown)

        write_and_print(report, json, show)

    try:
        with overall_bar() as progress:
            evaluation.run(workers, backend, progress)
    except (KeyboardInterrupt, UserError, RuntimeError):  # the last: a worker was killed
        if evaluation.done:
            print(f"not finished: {evaluation.done} of {len(evaluation.units)} parts")
            tell(interrupted=True)
            place = f"is kept in {evaluation.journal}: the same command goes on from there"
            print(f"what is done {place if evaluation.journal else 'would be kept with --json or --resume'}")
        raise
    tell()
    if beside and not resume and not evaluation.others:
        Path(beside).unlink(missing_ok=True)  # the report has all of it
    return 0


def _from_cards(names: Sequence[str], root: str | None, workers: int, json: str | None) -> int:
    """Do all that cards say again; returns 1 where a number is another one, or none could be looked at."""
    from pedzoo.eval.cards import again, compare
    from pedzoo.models.zoo.store import find, no_model

    cards = {}
    for name in names:
        if (entry := find(name)) is None:
            raise no_model(name, kind="model with a card")
        cards[name] = entry.card
    rows: list[dict[str, Any]] = []
    agree = True
    seeds = sorted({seed for card in cards.values() for one in card.evaluations for seed in one["seeds"]})
    report = {"command": "evaluate", "protocol": {"from_card": list(cards)}, "seeds": seeds}
    report |= {"versions": versions(), "rows": rows}
    for name, card in cards.items():
        with progress_bar() as progress:
            result = again(card, name, root, workers, progress)
        numbers = [number for one in result if one.now for number in compare(one.before, one.now)]
        rows += _card_rows(name, result, numbers)
        if json and json != "-":
            write_json(json, report)
        _print_card(name, result, numbers)
        agree = agree and bool(numbers) and all(number.same is not False for number in numbers)
    if json == "-":
        write_json(json, report)
    return int(not agree)


def _print_card(name: str, result: Sequence[RepeatedReport], numbers: Sequence[ComparedNumber]) -> None:
    """Print the table of a card, what a reader of it has to know, and the sum of it all."""
    from pedzoo.eval.cards import about
    from pedzoo.eval.results import ResultTable

    def cell(value: float | None, interval: Sequence[float] | None = None) -> str:
        if value is None:
            return "-"
        return f"{value:.4g}" + (f" [{interval[0]:.3g}, {interval[1]:.3g}]" if interval else "")

    body = [
        [one.case, one.metric, cell(one.card, one.interval), cell(one.now), _SAME[one.same]]
        for one in numbers
    ]
    if body:
        print_tables([ResultTable(name, ["case", "number", "card", "now", "same"], body, 2)])
    for one in result:
        what = about(one.before["protocol"])
        if not one.now:
            print(f"{what}: skipped, {one.why}")
            continue
        then, now = one.before["versions"], one.now["versions"]
        packages = [key for key in then if key != "commit" and then[key] != now.get(key)]
        if changed := [f"{key} {then[key]} (here {now.get(key, 'absent')})" for key in packages]:
            print(f"{what}: the card was made with {', '.join(changed)}")
    if not numbers:
        print(f"{name}: nothing of its card could be done again")
        return
    same, unsure = (sum(one.same is which for one in numbers) for which in (True, None))
    text = f"{name}: {same} of {len(numbers)} numbers are those of the card"
    print(text + f"; {unsure} differ and have no interval to judge by" * bool(unsure))


def _card_rows(
    name: str, result: Sequence[RepeatedReport], numbers: Sequence[ComparedNumber]
) -> list[dict[str, Any]]:
    """Return a row for every case, with the card's numbers beside today's, and for what was skipped."""
    from pedzoo.eval.cards import about

    rows: list[dict[str, Any]] = []
    for case, group in groupby(numbers, key=lambda number: number.case):
        mine = {number.metric: number for number in group}
        people = mine.pop("n")
        now = {metric: number.now for metric, number in mine.items() if number.now is not None}
        row = {"name": name, "case": {"evaluation": case}, "n": people.now, "metrics": now, "ci95": {}}
        row["card"] = {metric: number.card for metric, number in mine.items()}
        rows.append(row | {"same": {metric: number.same for metric, number in mine.items()}})
    for one in result:
        if not one.now:
            case = {"evaluation": about(one.before["protocol"]), "skipped": one.why}
            rows.append({"name": name, "case": case, "n": 0, "metrics": {}, "ci95": {}})
    return rows
