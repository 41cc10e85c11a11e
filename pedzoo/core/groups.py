"""Settings in groups: a class takes frozen dataclasses, and each setting also has a name without its group.

A group is an argument whose default is a dataclass: that default has the defaults of the class's settings.
Specs (``orca:radius=0.3``) and files of weights name settings without groups, configs with them.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

T = TypeVar("T")


def groups(cls: type) -> dict[str, Any]:
    """Return the groups that a class takes, by the name of the argument, each with its default."""
    taken = inspect.signature(cls).parameters.values()
    return {item.name: item.default for item in taken if is_dataclass(item.default)}


def homes(cls: type) -> dict[str, str]:
    """Return the group of every setting that is in one."""
    return {field.name: group for group, default in groups(cls).items() for field in fields(default)}


def settings(cls: type) -> dict[str, Any]:
    """Return the type of every setting of a class by its name, those of groups in the place of the group."""
    hints, own, result = get_type_hints(cls.__init__), groups(cls), {}
    for name in inspect.signature(cls).parameters:
        if name in own:
            inner = get_type_hints(type(own[name]))
            result |= {field.name: inner[field.name] for field in fields(own[name])}
        else:
            result[name] = hints.get(name, str)
    return result


def grouped(cls: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with those of a group in a mapping under its name; others stay as they are.

    Args:
        cls: The class that takes them.
        given: Values by name. Mappings of groups may be among them; a name without its group wins.
    """
    home = homes(cls)
    result = {key: value for key, value in given.items() if key not in home}
    for key in given:
        if key in home:
            result[home[key]] = {**(result.get(home[key]) or {}), key: given[key]}
    return result


def made(cls: type[T], given: Mapping[str, Any]) -> T:
    """Return an instance of a class with settings that are named without their groups."""
    own, given = groups(cls), grouped(cls, given)
    return cls(**{key: _changed(own[key], value) if key in own else value for key, value in given.items()})


def _changed(default: Any, values: Mapping[str, Any]) -> Any:
    """Return a group with new values beside those in which the class's default differs from the group's.

    Not `dataclasses.replace`: a group may choose values of its own by others, such as those of a preset.
    """
    usual = type(default)()
    own = {field.name: getattr(default, field.name) for field in fields(default)}
    return type(default)(**{k: v for k, v in own.items() if v != getattr(usual, k)} | dict(values))


def flat(*given: Any) -> dict[str, Any]:
    """Return the settings of some dataclasses without their groups, as plain values."""
    return {key: value for group in given for key, value in asdict(group).items()}
