"""The settings that a checkpoint brings from the configuration of its run: data, not orders.

A checkpoint may come from anywhere, and so may the configuration beside it. It says which model was trained
on which data, for how long and how it was measured. It names no code, no place to write to, no logger.
"""

from collections.abc import Iterable, Mapping
from inspect import signature
from pathlib import Path
from pydoc import locate
from typing import Any, get_args, get_type_hints

from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError
from pedzoo.core.spec import setting_groups
from pedzoo.data.datamodule import TrajectoryDataModule
from pedzoo.models.zoo.typed_fields import refuse_code
from pedzoo.train.modules.module import ForecastModule
from pedzoo.train.validation.rollout_validation import ClosedLoopValidation

PLAIN = ("seed_everything", "monitor", "monitor_mode")
"""Settings that are a text or a number."""

SCHEDULE = (
    *("max_epochs", "max_steps", "limit_train_batches", "limit_val_batches", "limit_test_batches"),
    *("check_val_every_n_epoch", "val_check_interval", "num_sanity_val_steps", "accumulate_grad_batches"),
)
"""Settings of the trainer, all of them numbers."""

GROUPS = {"data": TrajectoryDataModule, "rollout": ClosedLoopValidation}

DATA = tuple(
    name
    for name in signature(TrajectoryDataModule).parameters
    if name != "root" and name not in setting_groups(TrajectoryDataModule)
)
"""Settings of the data that say what is trained and tested; others say where they lie and how they load."""


def check_unchanged(
    run: Path, settings: Mapping[str, Any], path: str, names: Iterable[str], owner: type
) -> None:
    """Check that a run goes on with the data and the seed that it began with: its card has one of each.

    Args:
        run: Its folder.
        settings: Those with which it is to go on.
        path: Group of settings that are compared, such as ``model.init_args``.
        names: Of these settings.
        owner: Class that takes them: an earlier version may not have written what has a default.

    Raises:
        UserError: A setting has another value.
    """
    earlier, defaults = load_config(run / "config.yaml"), signature(owner).parameters
    pairs = [("seed_everything", earlier.get("seed_everything", 0), settings["seed_everything"])]
    before, now = _group(earlier, path), _group(settings, path)
    option = path.removesuffix(".init_args")
    pairs += [
        (f"{option}.{name}", before.get(name, defaults[name].default), now.get(name, defaults[name].default))
        for name in names
    ]
    for name, old, new in pairs:
        if old != new:
            raise UserError(
                f"--{name} {_typed(new)}: the run {str(run)!r} goes on with {_typed(old)}, with which it "
                "began: leave it out, or begin another run without --resume"
            )


def _group(settings: Any, path: str) -> Mapping[str, Any]:
    for key in path.split("."):
        settings = settings.get(key) if isinstance(settings, Mapping) else None
    return settings if isinstance(settings, Mapping) else {}


def _typed(value: Any) -> str:
    """Return a value as people type it."""
    if isinstance(value, list):
        return ",".join(map(str, value))
    return "null" if value is None else str(value)


def reusable_settings(settings: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Return what a run's configuration lends to another command: model, data, schedule, measurements.

    Args:
        settings: All that the configuration says.
        file: Where it is, for messages.

    Raises:
        UserError: What it lends names a file of code or a class of another package than pedzoo.
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
    remedy = f"if it is yours, add --config {file}"
    refuse_code(result, f"config {str(file)!r}", remedy)
    try:
        _check_class(ForecastModule, result.get("model"), "model")
        for key, cls in GROUPS.items():
            _check_arguments(cls, result.get(key), key)
    except UserError as error:
        raise UserError(f"config {str(file)!r}: {error}: {remedy}") from error
    return result


def _check_class(hint: type, value: Any, place: str) -> None:
    """Check a value in the place of a class or a group of settings: a text would be imported, or read."""
    for one in value if isinstance(value, list) else [value]:
        if one is None:
            continue
        if not isinstance(one, Mapping):
            raise UserError(f"{place} is {one!r:.80}, and such a file may not name classes or files there")
        path = one.get("class_path")
        if path is not None and not str(path).startswith("pedzoo."):
            raise UserError(f"{place} is of the class {path!r:.80}, and such a file may name pedzoo's alone")
        cls = locate(str(path)) if path else hint
        if not isinstance(cls, type):
            raise UserError(f"{place} is of the class {path!r:.80}, which pedzoo does not have")
        _check_arguments(cls, one.get("init_args", {}) if path else one, place)


def _check_arguments(cls: type, values: Any, place: str) -> None:
    if values is None:
        return
    if not isinstance(values, Mapping):
        raise UserError(f"{place} is {values!r:.80}, expected a mapping")
    hints = {
        key: hint for base in reversed(cls.__mro__) for key, hint in get_type_hints(base.__init__).items()
    }
    for key, value in values.items():
        for kind in _classes(hints.get(key)):
            _check_class(kind, value, f"{place}.{key}")


def _classes(hint: Any) -> list[type]:
    """Return pedzoo's own classes in a type."""
    if isinstance(hint, type) and hint.__module__.startswith("pedzoo."):
        return [hint]
    return [kind for inner in get_args(hint) for kind in _classes(inner)]
