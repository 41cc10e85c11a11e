"""``pedzoo forecast``: open-loop errors of models between the trivial baselines."""

import sys
from pathlib import Path
from typing import Any, Literal

from pedzoo.cli.check import given
from pedzoo.cli.output import check_outputs, print_report, write_and_print
from pedzoo.cli.parsing import parse, parser_of
from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.machine import versions

HELP = "ADE and FDE of models beside constant velocity and the lines to the goal"
EXAMPLE = "pedzoo forecast sgan_goal.zara1 --data.fold zara1 --samples 20 --json out.json"


def run(argv: list[str]) -> int:
    """Print the table; returns the exit code."""
    from pedzoo.data.datamodule import Loading, TrajectoryDataModule

    parser = parser_of(sys.modules[__name__], _forecast)
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
    from pedzoo.cli.progress import progress_bar
    from pedzoo.data.datamodule import TrajectoryDataModule
    from pedzoo.eval.forecast import forecast
    from pedzoo.models.zoo.loading import load

    check_outputs(json=json)
    argv, settings = more["argv"], more["data"]
    names = [*models, *trained(train, argv, runs)]
    if not given(argv, "--data.goal"):  # then every model that has a goal protocol is asked for its own
        own = (load(name).goal_protocol for name in names)
        settings["goal"] = next((goal for goal in own if goal not in (None, "none")), "none")
    data = TrajectoryDataModule(**settings)
    with progress_bar() as progress:
        report = forecast(names, data, samples, seed, split, progress)
    report = {"command": "forecast", **report, "versions": versions()}
    write_and_print(report, json, lambda: print_report(report))
    return 0


def trained(configs: str, argv: list[str], runs: str) -> list[str]:
    """Train configs on the data that the words of a command name, and return their best checkpoints.

    Args:
        configs: Names between commas; empty for none.
        argv: The command's words; those of ``--data`` are handed on, and ``--seed`` seeds the training.
        runs: Folder of the runs.

    Raises:
        UserError: A config is unknown or a training fails.
    """
    from pedzoo.cli.training import train as run_training

    pairs, result = [], []
    for place, word in enumerate(argv):
        if word.startswith("--"):
            name, equal, value = word.partition("=")
            pairs.append((name, value if equal else "".join(argv[place + 1 : place + 2])))
    words = [word for pair in pairs if pair[0].startswith("--data.") for word in pair]
    options = dict(pairs)
    for config in filter(None, configs.split(",")):
        generator = load_config(config)["model"]["init_args"]["generator"]
        fixed = "steps" in generator.get("init_args", {}).get("architecture", {})
        steps = options.get("--data.pred_len") if fixed else None
        more = ["--model.generator.architecture.steps", steps] if steps else []
        before = set(Path(runs).rglob("best.ckpt"))
        seed = ["--seed_everything", options.get("--seed", "0")]
        command = ["--config", config, "--runs", runs, *seed, *words, *more]
        if run_training("fit", command, HELP, EXAMPLE):
            raise UserError(f"the training of {config!r} failed: see above")
        result += [str(file) for file in sorted(set(Path(runs).rglob("best.ckpt")) - before)]
    return result
