"""``pedzoo evaluate``: the closed-loop table of policies on suites of cases."""

HELP = "the closed-loop table: policies on suites of cases, with intervals"
EXAMPLE = "pedzoo evaluate orca:radius=0.3 sgan_goal_map.zara1 --suite door,goals --quick --json out.json"


def run(argv: list[str]) -> int:
    """Evaluate, print the tables and write files; returns the exit code."""
    from pathlib import Path
    from typing import Any

    from jsonargparse import ArgumentParser
    from jsonargparse.typing import PositiveInt

    from pedzoo.cli.output import check_outputs, print_pages, write_and_print, write_text
    from pedzoo.cli.parsing import PARSER_SETTINGS, parse
    from pedzoo.cli.progress import overall_bar
    from pedzoo.cli.suggestions import whole_numbers
    from pedzoo.core.errors import UserError
    from pedzoo.core.machine import versions
    from pedzoo.core.registry import SUITES
    from pedzoo.eval.evaluate import SUITE_NAMES, Evaluation, evaluate
    from pedzoo.eval.results import markdown
    from pedzoo.eval.suite import EvaluationOptions, OwnRecordings

    usage = (
        "pedzoo evaluate POLICY... [--suite SUITE,...] [--quick] [...]\n"
        f"       pedzoo evaluate NAME... --from-card\nexample: {EXAMPLE}"
    )
    parser = ArgumentParser(prog="pedzoo evaluate", usage=usage, description=HELP, **PARSER_SETTINGS)
    parser.add_argument(
        "policies",
        nargs="+",
        type=str,
        help="orca:radius=0.3, go_to_goal, or any model; mixed crowds: orca:share=0.5+sgan_goal.indoor.",
    )
    parser.add_argument(
        "--suite",
        type=str,
        default=",".join(SUITE_NAMES),
        help=f"Some of {', '.join(SUITES.names())}, between commas; or file.py:Class.",
    )
    parser.add_argument(
        "--seeds", type=str, default="0", help="Of the scenes, between commas; they count as one sample."
    )
    parser.add_function_arguments(
        evaluate,
        as_group=False,
        skip={
            "policies",
            "suites",
            "seeds",
            "maps",
            "root",
            "metrics",
            "folds",
            "own",
            "people",
            "workers",
            "progress",
        },
    )
    parser.add_argument(
        "--maps",
        nargs="+",
        type=str,
        default=[],
        help="Floor plans for five more cases of the suite goals: every episode draws one.",
    )
    parser.add_argument(
        "--metrics",
        type=list[str],
        default=[],
        help="More columns of all tables, as spl,mine.py:f: a function of a rollout that returns two sums "
        "per episode.",
    )
    parser.add_argument(
        "--data.fold",
        type=list[str],
        default=[],
        help="Folds for replay, as zara1,hotel or mine.py:Mine (default: all whose recordings are found).",
    )
    parser.add_argument(
        "--data.files", type=list[str], default=[], help="Recordings of your own for replay: .csv, .txt."
    )
    parser.add_argument("--data.dt", type=float | None, help="Seconds per frame number of these files.")
    parser.add_argument("--data.map", type=str | None, help="Their floor plan (default: no walls).")
    parser.add_argument(
        "--data.homography", type=str | None, help="Their 3x3 matrix from positions to world metres."
    )
    parser.add_argument(
        "--people",
        type=str,
        default="",
        help="Who walks beside robots, between commas: orca,sgan_goal_map.indoor,replay:fold=zara1.",
    )
    parser.add_argument("--data.root", type=str | None, help="Recordings for replay (default: PEDZOO_DATA).")
    parser.add_argument("--workers", type=PositiveInt, default=1, help="Processes; the table stays the same.")
    parser.add_argument(
        "--from_card",
        action="store_true",
        help="Do what the models' cards say again, forecasts too; exit code 1 where a number is another one.",
    )
    parser.add_argument("--json", type=str | None, help="Also write the report to this file.")
    parser.add_argument("--markdown", type=str | None, help="Also write the tables to this page.")
    parser.add_argument(
        "--plot", type=str | None, help="Draw density and speed in replay into this .png, .pdf or .svg."
    )
    options = parse(parser, argv)
    if options.from_card:
        from pedzoo.cli.from_card import redo

        allowed = ("policies", "from_card", "data.root", "workers", "json")
        changed = [key for key in options.keys() if options[key] != parser.get_default(key)]
        if said := [key for key in changed if key not in allowed]:
            raise UserError(f"--{said[0]}: --from-card does what the card says; leave it out")
        check_outputs(json=options.json)
        return redo(options.policies, options.data.root, options.workers, options.json)
    if options.plot:
        from pedzoo.viz.plots import check_plot_path

        check_plot_path(options.plot)
        if "replay" not in _listed(options.suite):
            raise UserError(
                f"--plot {options.plot}: draws what the suite replay finds, which is not asked for"
            )
    files = {key: options[key] for key in ("json", "markdown", "plot", "resume")}
    check_outputs(**files)
    # finished parts lie beside the report until it is written
    beside = f"{options.json}.partial" if options.json and options.json != "-" else None

    known: dict[str, Any] = {key: options[key] for key in EvaluationOptions._fields if key in options}
    lists = {"maps": options.maps, "metrics": options.metrics, "folds": options.data.fold}
    lists["people"] = _listed(options.people)
    data = options.data
    own = OwnRecordings(tuple(data.files), data.dt, data.map, data.homography)
    if not own.files and any(own[1:]):
        raise UserError("--data.dt, --data.map, --data.homography: of --data.files; folds have their own")
    known["own"] = own if own.files else None
    known |= {"root": options.data.root, **{key: tuple(value) for key, value in lists.items()}}
    evaluation_options = EvaluationOptions(**known)
    evaluation = Evaluation(
        options.policies,
        _listed(options.suite),
        evaluation_options,
        whole_numbers("--seeds", options.seeds),
        options.deterministic,
        options.resume or beside,
    )

    if evaluation.resumed:
        print(f"{evaluation.resumed} of {len(evaluation.units)} parts were done before: {evaluation.journal}")
    if evaluation.others:
        print(f"{evaluation.others} parts in {evaluation.journal} are of other commands, weights or code")

    def tell(**more: bool) -> None:
        report = {"command": "evaluate", **evaluation.report(), "versions": versions(), **more}

        def show() -> None:
            if options.markdown and not more:  # a page of half the parts would take a whole one's place
                command = ["pedzoo", "evaluate", *argv]
                write_text(options.markdown, markdown(report, evaluation.shown, command))
            if options.plot and not more:
                from pedzoo.viz.plots import plot_density_speed

                plot_density_speed(report["rows"], options.plot)
            print_pages(report, evaluation.shown)

        write_and_print(report, options.json, show)

    try:
        with overall_bar() as progress:
            evaluation.run(options.workers, options.backend, progress)
    except (KeyboardInterrupt, UserError, RuntimeError):  # the last: a worker was killed
        if evaluation.done:
            print(f"not finished: {evaluation.done} of {len(evaluation.units)} parts")
            tell(interrupted=True)
            place = f"is kept in {evaluation.journal}: the same command goes on from there"
            print(
                "what is done " + (place if evaluation.journal else "would be kept with --json or --resume")
            )
        raise
    tell()
    if beside and not options.resume and not evaluation.others:
        Path(beside).unlink(missing_ok=True)  # the report has all of it
    return 0


def _listed(text: str) -> list[str]:
    from pedzoo.core.spec import split, unquoted

    names: list[str] = []
    for part in (part.strip() for part in split(text) if part.strip()):
        if names and "=" in part and ":" not in part.partition("=")[0]:
            names[-1] += f",{part}"  # a further setting
        else:
            names.append(part)
    return [unquoted(name) for name in names]
