"""Models by name: weights as safetensors, with all that is needed to build the model in their metadata.

Settings and tensors of a file are checked before a model is built of them, which takes memory.
"""

import hashlib
import inspect
import json
import sys
from collections.abc import Callable, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from zipfile import ZIP_STORED, ZipFile

import torch
from safetensors.torch import save
from torch import Tensor, nn

from pedzoo.core.configs import load_config
from pedzoo.core.errors import UserError, unknown
from pedzoo.core.paths import config_names, write_atomically
from pedzoo.core.registry import MODELS, ROBOT_POLICIES, names_code
from pedzoo.core.spec import Spec, grouped, make, parse, plain, setting_groups, setting_types, unquoted
from pedzoo.core.types import GoalProtocol
from pedzoo.core.untrusted import check, check_plain, refuse_code
from pedzoo.models.base import Forecaster, has_parameters
from pedzoo.models.zoo import store
from pedzoo.models.zoo.card import Config, ModelCard, read_file
from pedzoo.models.zoo.store import find, no_model, of_robots, weights_of

HALVED = 1000  # numbers: smaller matrices stay as they are in half precision

LARGEST = 1e3
"""Of a weight. Those that ship are below 20; steps from layers of ten times as large ones are no numbers."""

Module = TypeVar("Module", bound=nn.Module)


class Weights(NamedTuple):
    """What is in a file of weights."""

    source: str  # its name, for messages
    config: dict[str, Any]  # as of `config_of`
    state: dict[str, Tensor]
    card: ModelCard | None = None


def list_models(pattern: str = "*") -> list[str]:
    """Return the names of all models on this machine that match ``pattern``, as ``architecture.tag``.

    Those are the shipped ones, those in folders of the variable ``PEDZOO_ZOO``, and those fetched before.
    """
    return [name for name in store.names() if fnmatch(name, pattern) and not name.startswith(store.ROBOTS)]


def baselines() -> list[str]:
    """Return the names of the architectures that have nothing to train."""
    return [name for name in MODELS.names() if not has_parameters(MODELS.get(name))]


def load(
    name: str | Path, goal: GoalProtocol | None = None, own: type[Forecaster] | None = None
) -> Forecaster:
    """Return a model in eval mode.

    Args:
        name: A zoo name (``sgan_goal.zara1``), a folder with its card (``FOLDER/sgan_goal.mall``), an address
            (``hf://OWNER/REPO``, ``https://HOST/FOLDER/sgan_goal.mall``), a ``.safetensors`` or Lightning
            ``.ckpt`` file, a baseline (``bent_line``), an untrained class ``path/to/file.py:Class``, or with
            weights, ``path/to/file.py:Class:weights=best.ckpt``, or settings, ``file.py:Class:width=8``.
        goal: The goal protocol for untrained models that ask for it; trained ones keep their own.
        own: The caller's class, for weights of a class in a file of code: these never make that file run.

    Raises:
        UserError: No such model, its files are damaged or cannot be had, or they are not what its card says.
    """
    name = str(name)
    if weights := read_weights(name):
        if weights.config["architecture"] in ROBOT_POLICIES.names():
            raise of_robots(name)
        model = filled(weights, lambda: build(weights.config, own, weights.source), on_meta=own is None)
        model.card = weights.card
        model.name = weights.card.name if weights.card else name
        return model
    if names_code(name):
        model = _own(name, goal)
    elif name not in MODELS.names():
        raise no_model(name, baselines())
    elif has_parameters(type(model := untrained(name, goal))):
        known = ", ".join(list_models(f"{name}*.*")) or "none yet"
        raise UserError(
            f"{name!r} is an architecture; name its weights: {known}; or pretrained=False for new ones"
        )
    model.name = model.name or name
    return model


def read_weights(name: str) -> Weights | None:
    """Return the weights behind a name, of a model or of a robot; None for a name without any.

    Args:
        name: As of `load`.

    Raises:
        UserError: They are damaged, cannot be had, or are not those of their card.
    """
    if store.is_file(name):
        if names_code(name):
            return None
        if name.endswith(".safetensors"):
            return Weights(name, *read_file(name))
        checkpoint = read_checkpoint(name)
        config, state = checkpoint["pedzoo"], checkpoint["state_dict"]
        prefix = "mean.policy." if config["architecture"] in ROBOT_POLICIES.names() else "generator."
        state = {key.removeprefix(prefix): state[key] for key in state if key.startswith(prefix)}
        return Weights(name, config, state)
    if (entry := find(name)) is None:
        return None
    card, path = entry.card, weights_of(entry)
    config, state = read_file(path)
    if card.config != config:
        other = sorted(k for k in card.config | config if card.config.get(k) != config.get(k))
        raise UserError(
            f"the card of {card.name!r} is not that of its weights: they differ in config {', '.join(other)}"
        )
    return Weights(str(path), config, state, card)


def filled(weights: Weights, make: Callable[[], Module], on_meta: bool = True) -> Module:
    """Return the network that ``make`` builds with weights in it, in eval mode.

    Unless ``on_meta`` is false, it is built without memory at first, which finds out whether they fit.

    Raises:
        UserError: They are of another architecture, or are no finite numbers of a usual size.
    """
    name = weights.config["architecture"]
    _check_tensors(weights.state, weights.source, names_code(name))
    try:
        if on_meta:  # a class of one's own may need real tensors to be built
            with torch.device("meta"):
                like = {key: value.to("meta") for key, value in weights.state.items()}
                make().load_state_dict(like, assign=True)
        model = make()
        model.load_state_dict(weights.state)
    except (TypeError, RuntimeError) as error:
        raise UserError(
            f"{weights.source!r} holds weights of another architecture than {name!r}: {_first(error)}"
        ) from error
    return model.eval()


def _own(name: str, goal: GoalProtocol | None) -> Forecaster:
    """Return a model of a class in a person's own file: with its weights, or else with its settings."""
    spec = parse(name)
    (code, settings), own = spec, MODELS.get(spec.name, Forecaster)
    known = {"weights", *setting_types(own)}
    if wrong := sorted(settings.keys() - known):
        raise unknown(f"setting of {code}", wrong[0], known)
    if "weights" not in settings:
        return make(own, "model", spec, **({"goal_protocol": goal} if goal else {})).eval()
    if more := sorted(settings.keys() - {"weights"}):
        raise UserError(f"{code}: {more[0]}: its weights say how it is built: leave out one of the two")
    weights = unquoted(settings["weights"])
    model = load(weights, own=own)
    if not isinstance(model, own):
        raise UserError(f"{weights!r} holds weights of {architecture_of(model)!r}, not of {code!r}")
    return model


def untrained(name: str, goal: GoalProtocol | None = None, **settings: Any) -> Forecaster:
    """Return a model whose weights are drawn anew, in eval mode.

    Args:
        name: An architecture (``sgan``), a config whose generator is meant (``sgan_goal``), a zoo name whose
            architecture and settings are meant (``sgan_goal.zara1``), or ``path/to/file.py:Class``.
        goal: The goal protocol, for models that ask for it.
        settings: Of the architecture, without their groups: ``noise_dim=4``.

    Raises:
        UserError: No such model, or it has no such setting or takes another kind of value.
    """
    init: dict[str, Any] = {}
    if name in MODELS.names() or names_code(name):
        pass
    elif name in config_names():  # one in a folder is no path
        generator = load_config(name)["model"]["init_args"].get("generator")
        if generator is None:
            raise UserError(f"{name!r} trains robots, and no model of people: pedzoo fit --config {name}")
        name = generator["class_path"].rpartition(".")[0].rpartition(".")[2]
        for key, part in generator["init_args"].items():
            init |= part if isinstance(part, dict) else {key: part}
    elif entry := find(name):
        name, init = entry.card.config["architecture"], entry.card.config["init"]
    else:
        raise no_model(name, [*MODELS.names(), *config_names()])
    model, settings = MODELS.get(name, Forecaster), {key: plain(value) for key, value in settings.items()}
    if not names_code(name):  # what others take is their own
        check_settings(model, settings)
    init |= {"goal_protocol": goal} if goal else {}
    result = make(model, "model", Spec(name, settings), **init).eval()
    result.name = name
    return result


def build(config: dict[str, Any], own: type[Forecaster] | None = None, source: str = "weights") -> Forecaster:
    """Return an untrained model of a config from `config_of`.

    Args:
        config: It may come from a file, and never makes a file of code run.
        own: The caller's class, for a config that names a class so called in a file of code.
        source: Where the config is from, for the message.

    Raises:
        UserError: There is no such architecture, it is in a file of code, or takes other arguments.
    """
    name, init = config["architecture"], config["init"]
    cls = own if own and names_code(name) and name.rpartition(":")[2] == own.__name__ else None
    if cls is None:
        refuse_code(name, f"{source}: architecture", f"name it yourself, as in {name}:weights={source}")
        cls = MODELS.get(name, Forecaster)
        try:
            check_settings(cls, init)
        except UserError as error:
            raise UserError(f"{source!r}: {name}: {error}") from error
    try:
        inspect.signature(cls).bind(**grouped(cls, init))
        return cls.of(**init)
    except UserError:
        raise
    except (TypeError, ValueError, ArithmeticError, RuntimeError) as error:  # other kinds, impossible sizes
        raise UserError(
            f"{name!r} cannot be built with the arguments {init!s:.2000}: {_first(error):.200}; is it of "
            "another version?"
        ) from error


def config_of(model: Forecaster, **more: Any) -> dict[str, Any]:
    """Return what has to be known to build ``model`` again, and whatever else is worth keeping."""
    if not hasattr(model, "config"):
        name = type(model).__name__
        raise UserError(
            f"{name} cannot be saved: keep its arguments in __init__, self.config = arguments(locals())"
        )
    return {"architecture": architecture_of(model), "init": model.config, "goal": model.goal_protocol, **more}


def architecture_of(model: Forecaster) -> str:
    """Return the registered name of a model's class, or ``file.py:Class`` for one from outside."""
    module = type(model).__module__
    package, _, stem = module.rpartition(".")
    if package == MODELS.package:
        return stem
    return f"{sys.modules[module].__file__}:{type(model).__name__}"


def architecture_in(config: dict[str, Any]) -> dict[str, Any]:
    """Return the settings in a config that its weights depend on: all of them in a model without groups."""
    cls, init = MODELS.get(config["architecture"]), config["init"]
    return grouped(cls, init)["architecture"] if "architecture" in setting_groups(cls) else init


def save_weights(model: Forecaster, path: str | Path, half: bool = False, **known: dict[str, Any]) -> str:
    """Write ``model`` to a file, whole or not at all, and return its sha256; it gives the same bytes again.

    Args:
        model: The model.
        path: The file, ``.safetensors``.
        half: Write matrices of more than `HALVED` numbers in half precision; they are read as float32.
        known: What is said of it beside: its ``protocol`` and ``training``.

    Raises:
        UserError: The model does not keep its arguments, or something else is to be said.
    """
    config = config_of(model, **known)
    check(config, Config, "config")
    # one metadata key: with several, their order, and so the sum, would vary
    metadata = {"config": json.dumps(config, sort_keys=True)}
    state = {key: value.contiguous().cpu() for key, value in model.state_dict().items()}
    if half:
        large = [key for key in state if key.endswith("weight") and state[key].numel() > HALVED]
        state |= {key: state[key].half() for key in large}
    data = save(state, metadata)
    write_atomically(Path(path), data)
    return hashlib.sha256(data).hexdigest()


def saved_config(name: str) -> dict[str, Any]:
    """Return architecture, settings, ``protocol`` and, of published weights, ``training`` of a model.

    Nothing is said of a baseline or a class in a file. Names and errors as of `load`.
    """
    if names_code(name):
        name = unquoted(parse(name).settings.get("weights", ""))
        return saved_config(name) if name else {}
    if weights := read_weights(name):
        return weights.config
    if name in MODELS.names():
        return {}
    raise no_model(name)


def read_checkpoint(path: str | Path) -> dict[str, Any]:
    """Return what ``pedzoo fit`` wrote, without running it. Raises UserError: it is damaged, or of others."""
    path, what = Path(path), f"checkpoint {str(path)!r}"
    if not path.is_file():
        raise UserError(f"no checkpoint at {str(path)!r}")
    try:
        with ZipFile(path) as archive:
            entries = archive.infolist()
        packed = any(entry.compress_type != ZIP_STORED for entry in entries)
        # unpacked it could be of any size
        if packed or sum(entry.file_size for entry in entries) > path.stat().st_size:
            raise UserError(f"{what} is compressed, and torch does not compress: is it one?")
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except UserError:
        raise
    except Exception as error:  # a pickle that was tampered with can end in any
        raise UserError(f"{what} cannot be read ({_first(error)}): is it cut off?") from error
    if not isinstance(checkpoint, dict) or "pedzoo" not in checkpoint:
        raise UserError(f"{what} was not written by pedzoo fit")
    try:
        check_plain(checkpoint["pedzoo"])
        check(checkpoint["pedzoo"], Config, "config")
    except UserError as error:
        raise UserError(f"{what}: {error}") from error
    state = checkpoint.get("state_dict")
    if not isinstance(state, dict) or not all(isinstance(key, str) for key in state):
        raise UserError(f"{what} has no weights by name")
    return checkpoint


def _first(error: Exception) -> str:
    return " ".join([line.strip() for line in str(error).splitlines() if line.strip()][:2])


def check_settings(cls: type, init: Mapping[str, Any]) -> None:
    """Check that settings of a file are of the kinds that a class takes. Raises UserError: one is not."""
    types = setting_types(cls)
    for key in init.keys() & types.keys():
        check(init[key], types[key], key)


def _check_tensors(state: Mapping[str, Any], source: str, own: bool) -> None:
    """Check that a state has finite real numbers by name, of at most `LARGEST` but in a user's own class."""
    for key, value in state.items():
        wrong, largest = "", 0.0
        if not isinstance(value, Tensor) or value.layout != torch.strided:
            wrong = "is no dense tensor"
        elif not (value.is_floating_point() or value.dtype == torch.bool):
            wrong = f"is of {value.dtype}, expected floating point numbers or truth values"
        elif not torch.isfinite(value).all():
            wrong = "has NaN or infinite values: its training failed"
        elif value.numel() and value.is_floating_point() and not own:
            largest = float(value.abs().max())
        if largest > LARGEST:
            wrong = f"has a weight of {largest:.3g}, at most {LARGEST:g} are read: its training diverged"
        if wrong:
            raise UserError(f"{source!r}: {key:.80} {wrong}")
