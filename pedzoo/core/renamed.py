"""Old spellings that still work, each with the new one."""

import sys
from collections.abc import Callable, Mapping
from functools import cache, wraps
from pydoc import locate
from types import MappingProxyType
from typing import Any, TypeVar, cast

from pedzoo.core.errors import UserError
from pedzoo.core.spec import grouped, homes

Function = TypeVar("Function", bound=Callable[..., Any])

OLD_BACKENDS = {"grid": "compiled"}
OLD_SUITES = {"cards": "encounters"}
OLD_WEIGHTS = {
    **{f"{arch}.indoor_b": f"{arch}.indoor-seed1" for arch in ("sgan_goal", "sgan_goal_map")},
    **{f"{arch}.indoor_c": f"{arch}.indoor-seed2" for arch in ("sgan_goal", "sgan_goal_map")},
    **{f"{arch}.eth_ucy_way": f"{arch}.controller_open" for arch in ("sgan_goal", "sgan_goal_map")},
    **{
        f"sgan_goal_map.{fold}_way": f"sgan_goal_map.controller_open_{fold}"
        for fold in ("eth", "hotel", "univ", "zara1", "zara2")
    },
}
"""Shipped weights."""

OLD_SETTINGS = {"pace": "extend_goal"}
"""Settings of a learned policy."""

OLD_PROTOCOL = {"people": "keep_people"}
"""Options of the data, as weights and reports have them in their protocols."""

OLD_INIT = {"sgan": {"pace": "extend_goal"}}
"""Arguments of architectures, as weights and cards have them."""

OLD_OPTIONS = {
    "data.batch_size": "loading.batch_size",
    "data.max_pairs": "loading.max_pairs",
    "data.rotate": "loading.rotate",
    "data.mirror": "loading.mirror",
    "data.seed": "loading.seed",
    "data.people": "keep_people",
    "data.unroll": "imitated.steps",
    "data.unroll_batch_size": "imitated.batch_size",
    "data.one_recording_per_batch": "imitated.one_recording_per_batch",
    "data.unroll_apart": "imitated.one_recording_per_batch",
    "model.keep": "max_segments",
    "model.lenient": "collision_ramp",
    "model.world": "collection.physics",
    "model.reward.people": "person_cost",
    "model.walking.people": "person_distance",
    "model.walking.corrected": "safety_correction",
    "model.walking.trait": "assertiveness",
    "model.walking.side": "passing_side",
    "model.generator.pace": "walking.extend_goal",
}
"""Options of a training by their place in a configuration, without ``init_args``, and their new last part."""


@cache
def say(old: str, new: str) -> None:
    """Tell the new spelling on stderr, once in a process."""
    print(f"pedzoo: {old} is now {new}", file=sys.stderr)


def backend(name: str) -> str:
    """Return a physics backend's name as it is now."""
    new = OLD_BACKENDS.get(name, name)
    if new != name:
        say(f"physics {name!r}", repr(new))
    return new


def suite(name: str) -> str:
    """Return a suite's name as it is now."""
    new = OLD_SUITES.get(name, name)
    if new != name:
        say(f"suite {name!r}", repr(new))
    return new


def weights(name: str) -> str:
    """Return the name of shipped weights as it is now."""
    new = OLD_WEIGHTS.get(name, name)
    if new != name:
        say(f"model {name!r}", repr(new))
    return new


def old_world(world: str, physics: str | None = None) -> str:
    """Return the backend that the setting ``world`` stands for.

    Raises:
        UserError: ``physics`` is given, too.
    """
    if physics is not None:
        raise UserError(f"world {world!r} is the old spelling of physics {physics!r}: leave out world")
    new = OLD_BACKENDS.get(world, world)
    say(f"world={world!r}", f"physics={new!r}")
    return new


def takes_world(function: Function) -> Function:
    """Let ``function`` take its keyword argument ``physics`` by the old name ``world``, too."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if (world := kwargs.pop("world", None)) is not None:
            kwargs["physics"] = old_world(world, kwargs.get("physics"))
        return function(*args, **kwargs)

    return cast("Function", call)


def old_classes(module: dict[str, Any], names: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` by which files of others import its classes by their old names.

    Args:
        module: The module's ``globals()``.
        names: Old names, and the new ones.
    """

    def get(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module['__name__']!r} has no attribute {name!r}")
        say(f"{module['__name__']}.{name}", names[name])
        return module[names[name]]

    return get


def new_words(argv: list[str]) -> list[str]:
    """Return a command line with ``--world`` written as ``--physics``."""
    result = list(argv)
    for i, word in enumerate(argv):
        flag, joined, value = word.partition("=")
        if flag != "--world":
            continue
        result[i] = "--physics" + joined + OLD_BACKENDS.get(value, value)
        old = value
        if not joined and i + 1 < len(argv):
            old = argv[i + 1]
            result[i + 1] = OLD_BACKENDS.get(old, old)
        say(f"--world {old}", f"--physics {OLD_BACKENDS.get(old, old)}")
    return result


def new_keys(protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return a protocol, as a card has it, with today's names of keys, backends and suites."""
    # ``people`` beside a robot are a list
    result = {
        OLD_PROTOCOL.get(key, key) if isinstance(value, str) else key: value
        for key, value in protocol.items()
    }
    if "world" in result:
        world = result.pop("world")
        result["physics"] = OLD_BACKENDS.get(world, world)
    if isinstance(suites := result.get("suites"), list):
        result["suites"] = [OLD_SUITES.get(name, name) if isinstance(name, str) else name for name in suites]
    return result


def new_init(config: Any) -> Any:
    """Return a model's config, as weights have it, with today's names of arguments and of the protocol.

    Values that are no config are returned as they are: checks of their form come later.
    """
    if isinstance(config, dict) and isinstance(protocol := config.get("protocol"), dict):
        config = {**config, "protocol": new_keys(protocol)}
    if not isinstance(config, dict) or not isinstance(init := config.get("init"), dict):
        return config
    names = OLD_INIT.get(str(config.get("architecture")), {})
    return {**config, "init": {names.get(key, key): value for key, value in init.items()}}


def new_settings(settings: Mapping[str, str]) -> dict[str, str]:
    """Return the settings of a learned policy with their names as they are now."""
    for old in settings.keys() & OLD_SETTINGS.keys():
        say(f"setting {old}={settings[old]}", f"{OLD_SETTINGS[old]}={settings[old]}")
    return {OLD_SETTINGS.get(key, key): value for key, value in settings.items()}


def class_paths(config: Any, place: str = "") -> dict[str, str]:
    """Return the classes that a configuration names, by their place without ``init_args``."""
    if not isinstance(config, dict):
        return {}
    result = {place: path} if isinstance(path := config.get("class_path"), str) else {}
    for key, value in config.items():
        result |= class_paths(value, _inside(place, key))
    return result


def new_options(argv: list[str], classes: Mapping[str, str] = MappingProxyType({})) -> list[str]:
    """Return a command line of a training with the names of options of today; classes as of `class_paths`."""
    words = list(argv)
    for i, word in enumerate(argv):
        flag, joined, value = word.partition("=")
        parent, dot, _ = flag.rpartition(".")
        place = flag.removeprefix("--").replace("-", "_").replace(".init_args", "")
        if not flag.startswith("--") or not dot:
            continue
        above, _, leaf = place.rpartition(".")
        group = _homes(classes.get(above)).get(leaf)
        if new := OLD_OPTIONS.get(place, f"{group}.{leaf}" if group else None):
            words[i] = f"{parent}.{new}{joined}{value}"
            say(flag, f"{parent}.{new}")
    return words


def new_config(
    config: Any, say_so: bool = False, place: str = "", classes: Mapping[str, str] = MappingProxyType({})
) -> Any:
    """Return the configuration of a training with the names of options as they are now.

    Args:
        config: Its values, of any kind; what is no mapping is returned as it is.
        say_so: Whether to say each new name on stderr.
        place: Where these values stand, as keys of `OLD_OPTIONS`.
        classes: The classes at places where the configuration itself names none, as of `class_paths`.
    """
    if not isinstance(config, dict):
        return config
    path = config.get("class_path", classes.get(place))
    values: dict[str, Any] = {}
    for key, value in config.items():
        inner = _inside(place, key)
        new = key if inner == place else str(OLD_OPTIONS.get(inner, key))
        value = new_config(value, say_so, inner, classes)
        if key == "init_args" and isinstance(value, dict) and isinstance(path, str):
            value = _in_groups(path, value, place if say_so else "")
        if new != key and say_so:
            say(inner, f"{place}.{new}")
        new, dot, leaf = new.partition(".")
        value = {leaf: value} if dot else value
        both = isinstance(value, dict) and isinstance(values.get(new), dict)
        values[new] = values[new] | value if both else value
    return values


def _inside(place: str, key: str) -> str:
    return place if key == "init_args" else f"{place}.{key}".removeprefix(".")


def _in_groups(path: str, values: dict[str, Any], place: str) -> dict[str, Any]:
    """Return the arguments of a class with those in groups that are written without; says so at a place."""
    home = _homes(path)
    moved: dict[str, list[str]] = {}
    for key in values.keys() & home.keys():
        moved.setdefault(home[key], []).append(key)
    if moved and place:
        now = "; ".join(f"{place}.{group}: {', '.join(sorted(moved[group]))}" for group in sorted(moved))
        say(f"{place} without groups", now)
    return grouped(_class(path), values) if moved else values


def _homes(path: str | None) -> dict[str, str]:
    """Return the groups of the settings of one of pedzoo's classes; another class has none."""
    return homes(result) if path and isinstance(result := _class(path), type) else {}


def _class(path: str) -> Any:
    return locate(path) if path.startswith("pedzoo.") else None
