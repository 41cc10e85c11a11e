"""``pedzoo rollout``: policies walk through the same scenes, and one can look at it."""

HELP = "policies walk through the same scenes: table, trajectories, video"
EXAMPLE = "pedzoo rollout orca:radius=0.1 sgan_goal_map.zara1 --plot door.png --html door.html"


def run(argv: list[str]) -> int:
    """Print the table; returns the exit code."""
    from typing import Literal

    from jsonargparse import ArgumentParser
    from jsonargparse.typing import PositiveFloat

    from pedzoo.cli.output import check_outputs, print_report, write_and_print
    from pedzoo.cli.parsing import PARSER_SETTINGS, parse
    from pedzoo.cli.progress import progress_bar
    from pedzoo.core.errors import UserError
    from pedzoo.core.machine import versions
    from pedzoo.core.registry import METRICS, SCENARIOS
    from pedzoo.eval.comparison import Comparison
    from pedzoo.viz.episodes import Replay
    from pedzoo.viz.video import check_video_path, film

    usage = f"pedzoo rollout POLICY... [--scenario SCENARIO] [--physics PHYSICS] [...]\nexample: {EXAMPLE}"
    parser = ArgumentParser(prog="pedzoo rollout", usage=usage, description=HELP, **PARSER_SETTINGS)
    parser.add_argument(
        "policies",
        nargs="+",
        type=str,
        help="orca:radius=0.3, go_to_goal, or any model, one row each; or mixed: "
        "orca:share=0.5+sgan_goal.indoor.",
    )
    parser.add_argument(
        "--scenario",
        type=str,
        default="door",
        help=f"{', '.join(SCENARIOS.names())}, mine.yaml or file.py:Class, with settings: "
        "door:width=0.9,people=4, hallway:width=[1.5,2.5] (one per scene), goals:map=apartment.7 (or a "
        "file; if its path has commas, in quotes: \"goals:map='/a,b/plan.yaml'\").",
    )
    walking = parser.add_class_arguments(Comparison, as_group=False, skip={"policies", "scenario", "metrics"})
    parser.add_argument(
        "--metrics",
        type=list[str],
        default=[],
        help="Print these alone, as success,time_ratio (default: all; the report has all). Of your own, as "
        "mine.py:f: a function of a rollout that returns two sums per episode.",
    )
    parser.add_argument("--json", type=str | None, help="Also write the report to this file.")
    parser.add_argument("--plot", type=str | None, help="Draw trajectories into this .png, .pdf or .svg.")
    parser.add_argument("--video", type=str | None, help="Film an episode into this .webm or .mp4.")
    parser.add_argument("--html", type=str | None, help="Replays of all episodes as a page: .html.")
    parser.add_argument(
        "--video_view",
        type=Literal["perspective", "top"],
        default="perspective",
        help="Where the camera is; only bullet has a perspective.",
    )
    parser.add_argument("--video_seconds", type=PositiveFloat, help="Film so many seconds at most.")
    parser.add_argument("--show", type=int, default=0, help="Number of the episode in plot and video.")
    options = parse(parser, argv)
    if options.plot:
        from pedzoo.viz.plots import check_plot_path

        check_plot_path(options.plot)
    if options.video:
        check_video_path(options.video)
    check_outputs(json=options.json, plot=options.plot, video=options.video, html=options.html)
    only = [METRICS.get(name).__name__ for name in options.metrics]
    if not 0 <= options.show < max(options.episodes, 1):
        raise UserError(f"--show {options.show}: expected 0 to {options.episodes - 1}, see --episodes")

    settings = {key: options[key] for key in (*walking, "metrics")}
    with Comparison(options.policies, options.scenario, **settings) as comparison:

        def tell(**more: bool) -> None:
            report = {"command": "rollout", **comparison.report(), "versions": versions(), **more}
            shown = None if comparison.refusal else only
            write_and_print(report, options.json, lambda: print_report(report, shown))

        try:
            with progress_bar() as progress:
                comparison.run(progress)
        except KeyboardInterrupt:
            if comparison.walked:
                print("interrupted: only what was over by then")
                tell(interrupted=True)
            raise
        tell()
        if options.plot:
            from pedzoo.viz.trajectories import plot_rollouts

            plot_rollouts(comparison.walked, options.plot, options.show)
            print(f"plot:  {options.plot}")
        if options.video:
            with progress_bar() as progress:
                size = (640, 480) if len(options.policies) == 1 else (480, 360)
                shot = options.show, options.video_view, size, options.video_seconds
                film(comparison.walked, options.video, *shot, progress)
            print(f"video: {options.video}")
        if options.html:
            Replay(comparison.walked, options.scenario, options.seed).save(options.html)
            print(f"page:  {options.html}")
        if comparison.refusal:
            raise comparison.refusal
    return 0
