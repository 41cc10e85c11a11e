"""``pedzoo report``: results as one page with interactive replays."""

HELP = "results as one page: sortable tables, replays from above, distributions, curves"
EXAMPLE = "pedzoo report results.json runs -o report.html"


def run(results: list[str], /, out: str = "report.html", title: str = "pedzoo report") -> int:
    """Write the page.

    Args:
        results: JSON of evaluate, rollout, forecast, score or bench, and folders of trainings; with replays
            where evaluate or rollout ran with --keep_episodes 3.
        out: The page.
        title: Its heading.
    """
    from pedzoo.cli.output import check_output_ending, check_outputs, write_text
    from pedzoo.core.paths import PAGES

    check_outputs(out=out)
    check_output_ending("out", out, PAGES)

    from pedzoo.viz.report import content_of, page

    content = content_of(results)
    text = page(content, title)
    write_text(out, text)
    if out != "-":
        replays = sum(len(policy["episodes"]) for case in content["cases"] for policy in case["policies"])
        shown = f"{replays} replays" if replays else "no replays: evaluate with --keep_episodes 3 for some"
        print(f"report: {out} ({len(text.encode()) / 1e6:.1f} MB, {shown})")
    return 0
