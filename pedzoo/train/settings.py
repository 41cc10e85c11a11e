"""What a training takes from weights and earlier runs: data, not orders.

A run may come from anywhere. Its configuration says which model was trained on which data, for how long and
how it was measured. It names no code, no place to write to, no logger.
"""

import json
import re
from collections.abc import Iterable, Mapping
from inspect import signature
from pathlib import Path
from pydoc import locate
from typing import Any, get_args, get_type_hints

import torch
from lightning.pytorch.utilities import rank_zero_only

from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.paths import config_names
from pedzoo.core.registry import ROBOT_POLICIES, names_code
from pedzoo.core.spec import grouped, setting_groups
from pedzoo.core.untrusted import refuse_code
from pedzoo.data.datamodule import PROTOCOL, TrajectoryDataModule
from pedzoo.models.base import Forecaster
from pedzoo.models.zoo.loading import build, config_of, load, saved_config
from pedzoo.models.zoo.store import of_robots
from pedzoo.train.module import ForecastModule, differences
from pedzoo.train.validation import ClosedLoopValidation

PLAIN = ("seed_everything", "monitor", "monitor_mode")  # settings that are a text or a number

SCHEDULE = (
    *("max_epochs", "max_steps", "limit_train_batches", "limit_val_batches", "limit_test_batches"),
    *("check_val_every_n_epoch", "val_check_interval", "num_sanity_val_steps", "accumulate_grad_batches"),
)
"""Settings of the trainer, all of them numbers."""

_OF_A_CALL = ("config", "ckpt_path", "resume")
"""Keys that belong to one command line: a configuration with the first one would read another."""

_OF_A_PLACE = {"runs", "weights", "data.root", "trainer.enable_progress_bar"}
"""Options that change nothing of what is learned."""

_CLASSES = (
    "pedzoo.",
    *(f"lightning.pytorch.{part}." for part in ("callbacks", "strategies", "accelerators", "profilers")),
    *("torch.nn.", "torch.optim."),
)
"""How the classes begin that a configuration may name."""

_GIVES_ORDERS = ("logger", "plugins")
"""Settings of the trainer that send data elsewhere, or take the place of its parts."""

_PLACE = re.compile(r"[/\\~]|^\w+(\.\w+)+$")
"""A text of a class that is not pedzoo's, which would be imported or written to."""

GROUPS = {"data": TrajectoryDataModule, "rollout": ClosedLoopValidation}

DATA = tuple(
    name
    for name in signature(TrajectoryDataModule).parameters
    if name != "root" and name not in setting_groups(TrajectoryDataModule)
)
"""Settings of the data that say what is trained and tested; others say where they lie and how they load."""


def check_unchanged(
    run: Path, settings: Mapping[str, Any], group: str, names: Iterable[str], owner: type
) -> None:
    """Check that a run goes on with the data and the seed that it began with: its card has one of each.

    What else is different is printed.

    Args:
        run: Its folder.
        settings: Those with which it is to go on.
        group: Group of the settings that must be the same, ``data`` or ``model``.
        names: Of these settings.
        owner: Class that takes them: an earlier version may not have written what has a default.

    Raises:
        UserError: A setting has another value.
    """
    before, now = (_leaves(one) for one in (load_config(run / "config.yaml"), settings))
    defaults = {f"{group}.{name}": signature(owner).parameters[name].default for name in names}
    for name, default in {"seed_everything": 0, **defaults}.items():
        old, new = before.get(name, default), now.get(name, default)
        if old != new:
            raise UserError(
                f"--{name} {_typed(new)}: the run {str(run)!r} goes on with {_typed(old)}, with which it "
                "began: leave it out, or begin another run without --resume"
            )
    for name in () if rank_zero_only.rank else before.keys() & now.keys() - _OF_A_PLACE:
        if before[name] != now[name]:
            print(f"note: goes on with --{name} {_typed(now[name])}, it was {_typed(before[name])}")


def _leaves(settings: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Return all values that are no mappings, by the names of their options."""
    result: dict[str, Any] = {}
    for key, value in settings.items():
        place = above if key == "init_args" else f"{above}.{key}".removeprefix(".")
        result |= _leaves(value, place) if isinstance(value, Mapping) else {place: value}
    return result


def _typed(value: Any) -> str:
    """Return a value as people type it."""
    if isinstance(value, list):
        return ",".join(map(str, value))
    return "null" if value is None else str(value)


def reusable_settings(settings: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Return what the ``settings`` of a run's configuration ``file`` lend to another command.

    These are model, data, schedule and measurements.

    Raises:
        UserError: They name a file of code or a class of another package than pedzoo.
    """
    result: dict[str, Any] = {
        key: value for key in PLAIN if isinstance(value := settings.get(key), str | int | float)
    }
    trainer = settings.get("trainer")
    if isinstance(trainer, Mapping):
        result["trainer"] = {
            key: value for key in SCHEDULE if isinstance(value := trainer.get(key), int | float)
        }
    result |= {key: settings[key] for key in ("model", *GROUPS) if settings.get(key) is not None}
    _check(result, file)
    return result


def resumable_settings(settings: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Return what a run's configuration says to the command that goes on with it: all but that of a call.

    Raises:
        UserError: It names code, a class of another package than pedzoo's, or a place to write to.
    """
    result = {key: value for key, value in settings.items() if key not in _OF_A_CALL}
    _check(result, file)
    return result


def _check(result: Mapping[str, Any], file: Path) -> None:
    """Check all of a configuration that would run, or be imported, read or written, as it becomes objects."""
    remedy = f"if it is yours, add --config {file}"
    refuse_code(result, f"config {str(file)!r}", remedy)
    try:
        _check_keys(result)
        for key, kind in {"model": ForecastModule, **GROUPS}.items():
            _check_value(result.get(key), key, kind)
        _check_trainer(result.get("trainer"))
    except UserError as error:
        raise UserError(f"config {str(file)!r}: {error}: {remedy}") from error


def _check_trainer(values: Any) -> None:
    if not isinstance(values, Mapping | None):
        raise UserError(f"trainer is {values!r:.80}, expected a mapping")
    for key, value in (values or {}).items():
        if key == "default_root_dir":  # a run's own folder takes its place
            continue
        for one in value if isinstance(value, list) else [value]:
            path = one.get("class_path") if isinstance(one, Mapping) else one
            if key in _GIVES_ORDERS and isinstance(path, str):
                raise UserError(f"trainer.{key} is {path!r:.80}, which gives orders")
            _check_value(one, f"trainer.{key}", object if key == "callbacks" else None)


def _check_value(value: Any, place: str, kind: type | None = None, own: bool = False) -> None:
    """Check a value of an object, or group of settings, of a kind; None where that is not known.

    ``own``: it is a setting of one of pedzoo's classes, which take texts as they are.
    """
    if isinstance(value, list):
        for one in value:
            _check_value(one, place, kind, own)
    elif isinstance(value, Mapping):
        settings = value
        if "class_path" in value:
            if more := sorted(value.keys() - {"class_path", "init_args"}):
                raise UserError(f"{place} has {more[0]!r:.80} beside its class")
            kind, settings = _named(value["class_path"], place), value.get("init_args")
            if not isinstance(settings, Mapping | None):
                raise UserError(f"{place} is {settings!r:.80}, expected a mapping")
        own = kind.__module__.startswith("pedzoo.") if kind else own
        bases = reversed(kind.__mro__) if kind and own else ()
        hints = {key: hint for base in bases for key, hint in get_type_hints(base.__init__).items()}
        for key, inner in (settings or {}).items():
            for part in _classes(hints.get(key)) or [None]:
                _check_value(inner, f"{place}.{key}", part, own)
    elif kind and value is not None:  # a text would be imported, or read
        raise UserError(f"{place} is {value!r:.80}, and such a file may not name classes or files there")
    elif isinstance(value, str) and not own and not place.endswith(".monitor"):
        to_disk = re.search("dir|path|file", place.rpartition(".")[2])
        if to_disk or _PLACE.search(value):
            raise UserError(f"{place} is {value!r:.80}, and such a file may not name code or places there")


def _named(path: Any, place: str) -> type:
    if not isinstance(path, str) or not path.startswith(_CLASSES):
        raise UserError(f"{place} is of the class {path!r:.80}, and such a file may name pedzoo's alone")
    cls = locate(path)
    # a path may lead through the imports of a module
    if not isinstance(cls, type) or not cls.__module__.startswith(_CLASSES):
        raise UserError(f"{place} is of the class {path!r:.80}, which pedzoo does not have")
    return cls


def _check_keys(value: Any) -> None:
    """Refuse keys that stand for several ones, or for more of a list: they would pass by the other checks."""
    if isinstance(value, list | Mapping):
        for inner in value.values() if isinstance(value, Mapping) else value:
            _check_keys(inner)
    for key in value if isinstance(value, Mapping) else ():
        if set(key) & set(".+") and not names_code(key):
            raise UserError(f"{key!r:.80} is no key: write one level for each dot")


def _classes(hint: Any) -> list[type]:
    """Return pedzoo's own classes in a type."""
    if isinstance(hint, type) and hint.__module__.startswith("pedzoo."):
        return [hint]
    return [kind for inner in get_args(hint) for kind in _classes(inner)]


def start_from(module: ForecastModule, weights: str) -> None:
    """Fill the generator of ``module`` with ``weights``, a name that `pedzoo.load` accepts.

    All else begins anew. The goal protocol, the noise and the losses may differ from theirs.

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

    For a checkpoint in a run folder these are the run's, see `reusable_settings`. For other weights
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
