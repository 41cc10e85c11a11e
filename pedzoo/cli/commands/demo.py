"""``pedzoo demo``: the first minutes, from recorded people to a table and a picture."""

from __future__ import annotations

HELP = "train SGAN+goal for a minute on embedded data, compare it, draw it"
EXAMPLE = "pedzoo demo"


def run(argv: list[str]) -> int:
    """Train, print the model's row between the baselines, draw its predictions; returns the exit code."""
    from pathlib import Path

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
        "1/3 training SGAN+goal on the embedded recordings (synthetic people, no results to quote)",
        flush=True,
    )
    arguments = ["--config", "demo", "--runs", str(out / "runs"), "--trainer.max_epochs", str(options.epochs)]
    every = min(4, options.epochs)
    if code := train("fit", [*arguments, "--trainer.check_val_every_n_epoch", str(every)], HELP, EXAMPLE):
        return code
    newest = max((out / "runs" / "demo").iterdir(), key=lambda folder: folder.stat().st_mtime)
    checkpoint = str(RunFolder(newest).best)

    print("\n2/3 its errors between the trivial baselines")
    data = TrajectoryDataModule(fold="embedded", goal="window_end")
    report = {"command": "demo", **forecast([checkpoint], data), "versions": versions()}
    report["rows"][1]["name"] = "sgan_goal (this demo)"
    print_report(report)
    table = out / "forecast.json"
    write_json(table, report)

    print("3/3 drawing predictions")
    picture = out / "forecasts.png"
    plot_forecasts(load(checkpoint), data, picture)
    print(f"\npicture: {picture}\ntable:   {table}\nrun:     {newest}")
    return 0
