"""``pedzoo evaluate``: the closed-loop table of policies on suites of cases."""

from pathlib import Path
from typing import Any, Literal

from pedzoo.cli.check import split_names, whole_numbers
from pedzoo.cli.output import check_outputs, print_pages, write_and_print, write_text
from pedzoo.core.errors import UserError, at_least_one
from pedzoo.core.machine import versions

HELP = "the closed-loop table: policies on suites of cases, with intervals"
EXAMPLE = "pedzoo evaluate orca:radius=0.3 sgan_goal_map.zara1 --suite door,goals --quick --json out.json"

_WITH_CARD = ("--from_card", "--from-card", "--data.root", "--workers", "--json")


def run(
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
    """Evaluate, print the tables and write files; exit code 1 where a card's number is another one.

    Args:
        policies: orca:radius=0.3, go_to_goal, or any model; mixed crowds: orca:share=0.5+sgan_goal.indoor.
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
        people: Who walks beside robots, between commas: orca,sgan_goal_map.indoor,replay:fold=zara1.
        data_root: Recordings for replay; by default PEDZOO_DATA.
        workers: Processes; the table stays the same.
        from_card: Do what the models' cards say again, forecasts too.
        json: Also write the report to this file.
        markdown: Also write the tables to this page.
        plot: Draw density and speed in replay into this .png, .pdf or .svg.
        argv: The command line.
    """
    from pedzoo.cli.progress import overall_bar
    from pedzoo.eval.evaluate import Evaluation
    from pedzoo.eval.results import markdown as page
    from pedzoo.eval.suite import EvaluationOptions, OwnRecordings

    at_least_one("--workers", workers)
    if from_card:
        from pedzoo.cli.from_card import redo

        options = [word.partition("=")[0] for word in argv if word.startswith("--")]
        if said := [option for option in options if option not in _WITH_CARD]:
            raise UserError(f"{said[0]}: --from-card does what the card says; leave it out")
        check_outputs(json=json)
        return redo(policies, data_root, workers, json)
    suites = split_names(suite)
    check_outputs(json=json, markdown=markdown, plot=plot, resume=resume)
    if plot:
        from pedzoo.viz.plots import check_plot_path

        check_plot_path(plot)
        if "replay" not in suites:
            raise UserError(f"--plot {plot}: draws what the suite replay finds, which is not asked for")
    # finished parts lie beside the report until it is written
    beside = f"{json}.partial" if json and json != "-" else None
    own = OwnRecordings(tuple(data_files or ()), data_dt, data_map, data_homography)
    if not own.files and any(own[1:]):
        raise UserError("--data.dt, --data.map, --data.homography: of --data.files; folds have their own")
    settings: dict[str, Any] = {"episodes": episodes, "quick": quick, "physics": physics, "robot": robot}
    settings |= {"rollouts": rollouts, "device": device, "keep_episodes": keep_episodes, "root": data_root}
    settings |= {"clearance": clearance, "deadline": deadline, "own": own if own.files else None}
    lists = {"maps": maps, "metrics": metrics, "folds": data_fold, "people": split_names(people)}
    settings |= {key: tuple(value or ()) for key, value in lists.items()}
    options = EvaluationOptions(**settings)
    numbers = whole_numbers("--seeds", seeds)
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
            kept = place if evaluation.journal else "would be kept with --json or --resume"
            print(f"what is done {kept}")
        raise
    tell()
    if beside and not resume and not evaluation.others:
        Path(beside).unlink(missing_ok=True)  # the report has all of it
    return 0
