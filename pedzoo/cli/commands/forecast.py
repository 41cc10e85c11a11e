"""``pedzoo forecast`` and ``score``: models beside recorded people, in windows and as whole crowds."""

from pathlib import Path
from typing import Any, Literal

from pedzoo.cli.check import given
from pedzoo.cli.output import check_outputs, print_report, print_tables, progress_bar, write_and_print
from pedzoo.cli.parsing import command, parse, parser_of
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.machine import versions


@command("pedzoo forecast sgan_goal.zara1 --data.fold zara1 --samples 20 --json out.json")
def forecast(argv: list[str]) -> int:
    """ADE and FDE of models beside constant velocity and the lines to the goal."""
    from pedzoo.data.datamodule import Loading, TrajectoryDataModule

    parser = parser_of(_forecast)
    parser.add_class_arguments(TrajectoryDataModule, "data", skip={"imitated"})
    options = parse(parser, argv).as_dict()
    data = options.pop("data")
    data["loading"] = Loading(**data["loading"])
    return _forecast(options.pop("models"), **options, argv=argv, data=data)


def _forecast(
    models: list[str] = [],  # noqa: B006
    /,
    samples: int = 20,
    seed: int = 0,
    split: Literal["train", "val", "test"] = "test",
    train: str = "",
    runs: str = "runs",
    json: str | None = None,
    **more: Any,
) -> int:
    """Print the table.

    Args:
        models: Zoo names, .safetensors, .ckpt or file.py:Class.
        samples: K of the best-of-K errors; 0 for none.
        seed: Of the samples, the same for every model.
        split: Which part of the fold.
        train: Configs that are first trained on the training part of the data, between commas: their
            checkpoints are models of the table.
        runs: Folder of these runs.
        json: Also write the report to this file.
        more: The command line ``argv``, and the arguments of the ``data``.
    """
    from pedzoo.data.datamodule import TrajectoryDataModule
    from pedzoo.eval.forecast import forecast
    from pedzoo.models.zoo.loading import load

    check_outputs(json=json)
    argv, settings = more["argv"], more["data"]
    names = [*models, *_trained(train, argv, runs)]
    if not given(argv, "--data.goal"):  # then every model that has a goal protocol is asked for its own
        own = (load(name).goal_protocol for name in names)
        settings["goal"] = next((goal for goal in own if goal not in (None, "none")), "none")
    data = TrajectoryDataModule(**settings)
    with progress_bar() as progress:
        report = forecast(names, data, samples, seed, split, progress)
    report = {"command": "forecast", **report, "versions": versions()}
    write_and_print(report, json, lambda: print_report(report))
    return 0


def _trained(configs: str, argv: list[str], runs: str) -> list[str]:
    """Train configs on the data that the words of the command name, and return their best checkpoints."""
    from pedzoo.cli.training import train
    from pedzoo.models.zoo.publish import options_of

    given, result = options_of(argv), []
    words = [word for one in given if one.key.startswith("data.") for word in one.words]
    options = {one.key: one.value for one in given}
    for config in filter(None, configs.split(",")):
        generator = load_config(config)["model"]["init_args"]["generator"]
        fixed = "steps" in generator.get("init_args", {}).get("architecture", {})
        steps = options.get("data.pred_len") if fixed else None
        more = ["--model.generator.architecture.steps", steps] if steps else []
        before = set(Path(runs).rglob("best.ckpt"))
        seed = ["--seed_everything", options.get("seed", "0")]
        if train("fit", ["--config", config, "--runs", runs, *seed, *words, *more]):
            raise UserError(f"the training of {config!r} failed: see above")
        result += [str(file) for file in sorted(set(Path(runs).rglob("best.ckpt")) - before)]
    return result


@command("pedzoo score mine.csv approach_net_goal_map.indoor --against zara1 --json score.json")
def score(
    crowds: list[str],
    /,
    *,
    against: str,
    data_dt: float | None = None,
    data_map: str | None = None,
    data_homography: str | None = None,
    data_root: str | None = None,
    rollouts: int = 3,
    seed: int = 0,
    dt: float | None = None,
    physics: str = "compiled",
    likelihood: bool = True,
    stops: bool = False,
    opening: list[float] | None = None,
    json: str | None = None,
) -> int:
    """How near any simulator's people are to recorded ones, one JSON.

    Args:
        crowds: Files of walks (.csv, .txt: frame, agent, x, y), and policies: orca:radius=0.3, or any model.
        against: The recorded crowd: zara1, another fold, or a file.
        data_dt: Seconds per frame number of that file.
        data_map: Its floor plan; by default no walls.
        data_homography: Its 3x3 matrix from positions to world metres.
        data_root: Recordings; by default PEDZOO_DATA.
        rollouts: Of policies with noise.
        seed: Of the policies' noise.
        dt: Seconds between consecutive frame numbers in the files of walks; by default what they say, or rows
            that are 0.4 s apart.
        physics: In which policies walk.
        likelihood: Also walk the joint rollouts of 8 s; see docs/score.md.
        stops: People whom policies move have the places where the recorded ones stood for 2 s or more as
            goals, and stay there as long. In the joint rollouts of 8 s they have their exits alone.
        opening: A door: x,y of its centre, x,y of its wall's normal, clear width, for flow and headways.
        json: Also write the report to this file.
    """
    from pedzoo.eval.scoring.score import Reference, pages, score

    check_outputs(json=json)
    recorded = Reference(against, data_dt, data_map, data_homography, data_root)
    settings = {"rollouts": rollouts, "seed": seed, "dt": dt, "physics": physics}
    settings |= {"likelihood": likelihood, "stops": stops, "opening": opening or ()}
    with progress_bar() as progress:
        report = score(crowds, recorded, progress=progress, **settings)
    report = {"command": "score", **report, "versions": versions()}

    def show() -> None:
        for note in report["notes"]:
            print(f"note: {note}")
        print_tables(pages(report))

    write_and_print(report, json, show)
    return 0
