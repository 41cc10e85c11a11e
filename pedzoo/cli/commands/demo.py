"""``pedzoo demo``: the first minutes, from recorded people to tables, pictures and a video."""

from __future__ import annotations

from pathlib import Path

HELP = "train SGAN+goal for a minute on embedded data, draw what it expects; walk through a door"
EXAMPLE = "pedzoo demo"

POLICIES = ("orca:radius=0.5", "orca:radius=0.1", "sgan_goal_map.zara1")
"""Who walks: two disks that do not fit through the door, two that do, and the shipped SGAN+goal+map."""

EPISODES = 5
FILM_SECONDS = 8.0
PANEL = (400, 300)


def walk(out: Path) -> list[Path]:
    """Let two people meet at a door, print the table and return what was written."""
    from importlib.util import find_spec

    from pedzoo.cli.output import print_report, write_json
    from pedzoo.cli.progress import progress_bar
    from pedzoo.eval.closed_loop import Comparison
    from pedzoo.eval.trajectories import plot_rollouts
    from pedzoo.eval.video import film
    from pedzoo.versions import versions

    world = "bullet" if find_spec("pybullet") else "grid"
    plot, video, table = out / "door.png", out / "door.webm", out / "door.json"
    with Comparison(POLICIES, "door", world, EPISODES) as comparison, progress_bar() as progress:
        comparison.run(progress)
        report = {"command": "demo", **comparison.report(), "versions": versions()}
        plot_rollouts(comparison.walked, plot)
        film(comparison.walked, video, size=PANEL, seconds=FILM_SECONDS, progress=progress)
    print_report(report)
    write_json(table, report)
    return [plot, video, table]


def run(argv: list[str]) -> int:
    """Train, print a table between the baselines, draw predictions, walk; returns the exit code."""
    from pedzoo.cli.arguments import Arguments

    parser = Arguments("demo", HELP, EXAMPLE)
    parser.add_argument(
        "--out", default="demo", metavar="FOLDER", help="where everything goes (default: demo)"
    )
    parser.add_argument(
        "--epochs", type=int, default=80, help="epochs of training (default: 80, about a minute)"
    )
    options = parser.parse_args(argv)

    from pedzoo.cli.output import print_report, write_json
    from pedzoo.cli.training import train
    from pedzoo.data.datamodule import TrajectoryDataModule
    from pedzoo.eval.forecast import forecast
    from pedzoo.eval.plots import plot_forecasts
    from pedzoo.models.zoo import load
    from pedzoo.train.run import RunFolder
    from pedzoo.versions import versions

    out = Path(options.out)
    print(
        "1/4 training SGAN+goal on the embedded recordings (synthetic people, no results to quote)",
        flush=True,
    )
    arguments = ["--config", "demo", "--runs", str(out / "runs"), "--trainer.max_epochs", str(options.epochs)]
    every = min(4, options.epochs)
    if code := train("fit", [*arguments, "--trainer.check_val_every_n_epoch", str(every)], HELP, EXAMPLE):
        return code
    newest = max((out / "runs" / "demo").iterdir(), key=lambda folder: folder.stat().st_mtime)
    checkpoint = str(RunFolder(newest).best)

    print("\n2/4 its errors between the trivial baselines")
    data = TrajectoryDataModule(fold="embedded", goal="window_end")
    report = {"command": "demo", **forecast([checkpoint], data), "versions": versions()}
    report["rows"][1]["name"] = "sgan_goal (this demo)"
    print_report(report)
    table = out / "forecast.json"
    write_json(table, report)

    print("3/4 drawing predictions")
    picture = out / "forecasts.png"
    plot_forecasts(load(checkpoint), data, picture)

    print("\n4/4 two people meet at a door: what errors of forecasts do not tell")
    walked = walk(out)
    print(
        f"predictions: {picture}, {table}\nwalks:       {', '.join(map(str, walked))}\nrun:         {newest}"
    )
    return 0
