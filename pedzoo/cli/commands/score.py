"""``pedzoo score``: how near simulated crowds are to a recorded one."""

from __future__ import annotations

HELP = "how near any simulator's people are to recorded ones, one JSON"
EXAMPLE = "pedzoo score mine.csv sgan_goal_map.indoor --against zara1 --json score.json"


def run(argv: list[str]) -> int:
    """Score, print the table and write the report; returns the exit code."""
    from jsonargparse import ArgumentParser

    from pedzoo.cli.output import check_outputs, print_tables, write_and_print
    from pedzoo.cli.parsing import PARSER_SETTINGS, parse
    from pedzoo.cli.progress import progress_bar
    from pedzoo.core.machine import versions
    from pedzoo.eval.scoring.score import Reference, score
    from pedzoo.eval.scoring.table import pages

    usage = f"pedzoo score CROWD... --against RECORDING [...]\nexample: {EXAMPLE}"
    parser = ArgumentParser(prog="pedzoo score", usage=usage, description=HELP, **PARSER_SETTINGS)
    parser.add_argument(
        "crowds",
        nargs="+",
        type=str,
        help="Files of walks (.csv, .txt: frame, agent, x, y), and policies: orca:radius=0.3, or any model.",
    )
    parser.add_argument(
        "--against", type=str, required=True, help="The recorded crowd: zara1, another fold, or a file."
    )
    parser.add_argument("--data.dt", type=float | None, help="Seconds per frame number of that file.")
    parser.add_argument("--data.map", type=str | None, help="Its floor plan (default: no walls).")
    parser.add_argument(
        "--data.homography", type=str | None, help="Its 3x3 matrix from positions to world metres."
    )
    parser.add_argument("--data.root", type=str | None, help="Recordings (default: PEDZOO_DATA).")
    parser.add_function_arguments(score, as_group=False, skip={"crowds", "against", "opening", "progress"})
    parser.add_argument(
        "--opening",
        type=list[float],
        default=[],
        help="A door: x,y of its centre, x,y of its wall's normal, clear width, for flow and headways.",
    )
    parser.add_argument("--json", type=str | None, help="Also write the report to this file.")
    options = parse(parser, argv)
    check_outputs(json=options.json)

    data = options.data
    against = Reference(options.against, data.dt, data.map, data.homography, data.root)
    names = "rollouts", "seed", "dt", "physics", "likelihood", "stops", "opening"
    settings = {key: options[key] for key in names}
    with progress_bar() as progress:
        report = score(options.crowds, against, progress=progress, **settings)
    report = {"command": "score", **report, "versions": versions()}

    def show() -> None:
        for note in report["notes"]:
            print(f"note: {note}")
        print_tables(pages(report))

    write_and_print(report, options.json, show)
    return 0
