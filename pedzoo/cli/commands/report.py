"""``pedzoo report``: results as one page with interactive replays."""

HELP = "results as one page: sortable tables, replays from above, distributions, curves"
EXAMPLE = "pedzoo report results.json runs -o report.html"


def run(argv: list[str]) -> int:
    """Write the page; returns the exit code."""
    from pedzoo.cli.arguments import Arguments

    parser = Arguments("report", HELP, EXAMPLE)
    parser.add_argument(
        "results",
        nargs="+",
        metavar="RESULTS",
        help="JSON of evaluate, rollout, forecast, score or bench, and folders of trainings; with "
        "replays where evaluate or rollout ran with --keep_episodes 3",
    )
    parser.add_argument("-o", "--out", default="report.html", metavar="FILE", help="default: report.html")
    parser.add_argument("--title", default="pedzoo report", help="the page's heading")
    options = parser.parse_args(argv)

    from pedzoo.cli.output import check_output_ending, check_outputs, write_text
    from pedzoo.core.paths import PAGES

    check_outputs(out=options.out)
    check_output_ending("out", options.out, PAGES)

    from pedzoo.viz.page import page
    from pedzoo.viz.report import content_of

    content = content_of(options.results)
    text = page(content, options.title)
    write_text(options.out, text)
    if options.out != "-":
        replays = sum(len(policy["episodes"]) for case in content["cases"] for policy in case["policies"])
        shown = f"{replays} replays" if replays else "no replays: evaluate with --keep_episodes 3 for some"
        print(f"report: {options.out} ({len(text.encode()) / 1e6:.1f} MB, {shown})")
    return 0
