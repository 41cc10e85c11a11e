"""Fine-tuning: a training that begins with the weights of another one."""

import json
from pathlib import Path
from typing import Any

import torch

from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.registry import ROBOT_POLICIES
from pedzoo.core.spec import grouped
from pedzoo.data.datamodule import PROTOCOL
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import build, config_of, load, read_checkpoint, saved_config
from pedzoo.models.zoo.store import of_robots
from pedzoo.train.modules.module import ForecastModule, copied_keys, differences
from pedzoo.train.run import RunFolder


def start_from(module: ForecastModule, weights: str) -> None:
    """Fill the generator of ``module`` with ``weights``, a name that `pedzoo.load` accepts.

    All else of a training begins anew: the optimizers, the schedule and a discriminator, which zoo weights do
    not have. The goal protocol, the noise and the losses may differ from theirs.

    Raises:
        UserError: No such weights, or they are of another architecture.
    """
    model = load(weights, own=type(module.generator))
    if changed := differences(config_of(model), config_of(module.generator), {"goal_protocol", "noise"}):
        raise UserError(
            f"--weights {weights} are of another architecture ({'; '.join(changed)}): "
            "leave out --config and --model.generator options that change it"
        )
    module.generator.load_state_dict(model.state_dict())


def config_beside(checkpoint: str | Path) -> Path | None:
    """Return the configuration of the run in whose folder a checkpoint lies, None where there is none."""
    path = Path(checkpoint)
    config = path.parent.parent / "config.yaml"
    return config if path.suffix == ".ckpt" and config.is_file() else None


def options_of(weights: str) -> list[str]:
    """Return the options of ``pedzoo fit`` for a training like the one that ``weights`` come from.

    For a checkpoint in a run folder these are the run's, see `pedzoo.train.run_settings`. For other weights
    they are the shipped config of their training, with model and data as their metadata have them.

    Raises:
        UserError: No such weights, or it is unknown how they were trained.
    """
    config = _trained(weights)
    if run := config_beside(weights):
        return ["--config", str(run)]
    name = config.get("training", {}).get("config")
    if name not in config_names():
        raise UserError(
            f"--weights {weights} do not say with which shipped config they were trained "
            f"(they say {name}): add --config NAME ({', '.join(config_names())}) or a file"
        )
    return ["--config", name, *(architecture_options(weights, name) or _architecture(config))]


def options_to_continue(run: RunFolder) -> list[str]:
    """Return the options of ``pedzoo fit`` that go on with a run.

    Earlier versions trained in the loop without dropout for every config; such a run continues without it.

    Raises:
        UserError: Its checkpoint cannot be read.
    """
    options = ["--config", str(run.path / "config.yaml"), "--ckpt_path", str(run.last)]
    checkpoint = read_checkpoint(run.last)
    if copied_keys(checkpoint) and checkpoint["pedzoo"]["init"].get("map_dropout"):
        options += ["--model.generator.losses.map_dropout", "0"]
    return options


def architecture_options(weights: str, config: str) -> list[str]:
    """Return what a training that begins with weights does otherwise than its ``config`` says, as options.

    A config with ``weights``, such as those in ``closed_loop``, is for any generator. It takes architecture,
    losses and data of the weights that it is given, and decides itself how a model walks and about dropout.
    To other configs weights have to fit.
    """
    settings = load_config(config)
    if not settings.get("weights"):
        return []
    generator = settings["model"]["init_args"]["generator"]
    decided = generator.get("init_args", {})
    dropout = {key: value for key, value in decided.get("losses", {}).items() if key == "map_dropout"}
    given = _architecture(_trained(weights), walking=decided.get("walking", {}), losses=dropout)
    if json.loads(given[1])["class_path"] == generator["class_path"]:
        return given
    # jsonargparse would keep groups of the config's class: the base class has none
    return ["--model.generator", f"{Forecaster.__module__}.{Forecaster.__qualname__}", *given]


def _trained(weights: str) -> dict[str, Any]:
    """Return what weights say of themselves; those of robots, and what has none, are refused."""
    config = saved_config(weights)
    if not config:
        raise UserError(
            f"--weights {weights}: expected a trained model, such as sgan_goal.zara1: "
            "leave out --weights, and train from the beginning with --config NAME"
        )
    if config["architecture"] in ROBOT_POLICIES.names():
        raise of_robots(weights)
    return config


def _architecture(config: dict[str, Any], **decided: dict[str, Any]) -> list[str]:
    with torch.device("meta"):  # its settings alone are asked for
        model = build(config)
    cls = type(model)
    # all options, also those that weights of an earlier version do not know: a config may set them
    options = grouped(cls, model.config)
    options |= {group: options[group] | changes for group, changes in decided.items() if group in options}
    written = {"class_path": f"{cls.__module__}.{cls.__qualname__}", "init_args": options}
    protocol = config.get("protocol", {})
    data = [f"--data.{key}={protocol[key]}" for key in PROTOCOL if key in protocol]
    return ["--model.generator", json.dumps(written), *data]
