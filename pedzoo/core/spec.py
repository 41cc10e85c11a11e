"""Things that are named with their settings behind a colon: ``orca:radius=0.3,walls=true``.

A value with commas is written in quotes: ``goals:map='/a,b/plan.yaml'``.

A class may take settings in groups. A group is an argument whose default is a frozen dataclass, which has the
defaults of the class's settings. Texts and weights name settings without their groups, configs with them.
"""

import inspect
import re
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, NamedTuple, get_args, get_type_hints

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.registry import Registry

_ADDRESS = re.compile(r"(hf|https?|file)://[^/:]*(:\d+(?=/))?[^:]*")
"""An address on the net: the colons of its scheme and its port are its own."""

_SHORT = 200
"""Characters: shorter settings without a ``*`` (a YAML reference) need no size check."""

_QUOTES = "'\""
_BEGINS = ("", *"=[,:+")


class Spec(NamedTuple):
    """A name and its settings as values, which may hold any sign: a path may have commas and colons."""

    name: str
    settings: Mapping[str, Any]


class SpecText(NamedTuple):
    """A name and the settings that were written behind it, as text: in quotes if they were written so."""

    name: str
    settings: Mapping[str, str]


def name_of(text: str) -> str:
    """Return the name in a text with settings: a word, a path, an address or ``path/to/file.py:Class``."""
    address = _ADDRESS.match(text)
    name = address[0] if address else text.partition(":")[0]
    inside = text.removeprefix(name).removeprefix(":").partition(":")[0]
    return f"{name}:{inside}" if name.endswith(".py") else name


def parse(text: str) -> SpecText:
    """Return the parts of ``name``, ``name:key=value,key=[a,b]`` or ``path/to/file.py:Class:key=value``.

    A name may be an address: ``hf://owner/repo:key=value``.

    Raises:
        UserError: A setting without ``=``, or given twice.
    """
    name = name_of(text)
    _, colon, rest = text.removeprefix(name).partition(":")
    settings: dict[str, str] = {}
    for part in split(rest) if colon else []:
        key, equals, value = part.partition("=")
        if not equals or not key.strip():
            expected = f"expected {name:.200}:key=value,key=value"
            if settings:
                before, value = settings.popitem()
                value = quoted(f"{unquoted(value).lstrip(_QUOTES)},{part}")
                expected += f"; a value with commas needs quotes: {before:.200}={value:.200}"
            raise UserError(f"{text!r:.200}: {part!r:.200} is no setting: {expected}")
        if key.strip() in settings:
            raise UserError(f"{text!r:.200}: {key.strip()!r:.200} is given twice")
        settings[key.strip()] = value.strip()
    return SpecText(name, settings)


def with_settings(text: str, settings: Mapping[str, Any]) -> str:
    """Return a name, or a text with settings, with further settings behind it: `parse` reads it again.

    Raises:
        UserError: A value is no number, text, truth, None or list of these.
    """
    parts = [f"{key}={_as_text(f'{text}:{key}', plain(value))}" for key, value in settings.items()]
    if not parts:
        return text
    return f"{text}{',' if parse(text).settings else ':'}{','.join(parts)}"


def plain(value: Any) -> Any:
    """Return a value with Python's own numbers where it has those of NumPy or torch."""
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _as_text(where: str, value: Any) -> str:
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, str):
        return quoted(value) if set(value) & set(f"{_QUOTES},[]") else value
    if isinstance(value, list):
        return f"[{','.join(_as_text(where, one) for one in value)}]"
    raise UserError(f"{where}: expected a number, a text or a list of these, not {value!r:.60}")


def build(registry: Registry, what: str | Spec | SpecText, base: type, **given: Any) -> Any:
    """Return an instance of what is named, every setting checked for its type.

    Args:
        registry: Where the name is looked up.
        what: A text as `parse` takes it, or a name with values.
        base: The class that it must be a subclass of.
        given: Further arguments, which the settings override.

    Raises:
        UserError: An unknown name or setting, or a value of the wrong type.
    """
    spec = parse(what) if isinstance(what, str) else what
    return make(registry.get(spec.name, base), registry.kind, spec, **given)


def make(cls: type, kind: str, spec: Spec | SpecText, **given: Any) -> Any:
    """Return ``cls`` built from the settings of ``spec`` and from ``given`` values; errors as in `build`."""
    from pedzoo.core.untrusted import check_yaml  # imports YAML

    name, settings = spec
    if any("*" in (text := str(value)) or len(text) > _SHORT for value in settings.values()):
        check_yaml(dict(settings))
    types = setting_types(cls)
    written = isinstance(spec, SpecText)
    arguments = {key: value for key, value in given.items() if key in types}
    for key, value in settings.items():
        if key not in types:
            raise unknown(f"setting of {kind} {name}", key, types)
        arguments[key] = _typed(f"{name}:{key}", plain(value), types[key], written)
    try:
        inspect.signature(cls).bind(**grouped(cls, arguments))
    except TypeError as error:
        raise UserError(
            f"{kind} {name!r:.200}: {error}; its settings: {', '.join(types) or 'none'}"
        ) from error
    return build_ungrouped(cls, arguments)


def _typed(where: str, value: Any, hint: Any, written: bool) -> Any:
    """Return a value of the type ``hint``: read from text if it was written, else checked as it is."""
    from argparse import ArgumentError

    from jsonargparse import ArgumentParser

    if written:
        plain = unquoted(value)
        if hint is str:
            return plain
        # what stands in quotes is a text where one is expected, and is not read as YAML
        written, value = plain == value or str not in get_args(hint), plain
    parser = ArgumentParser(exit_on_error=False)
    # a text that stands alone would be read as YAML
    parser.add_argument("--value", type=hint if written else list[hint])
    try:
        if written:
            return parser.parse_args([f"--value={value}"]).value
        return parser.parse_object({"value": [value]}).value[0]
    except (ArgumentError, OverflowError) as error:  # the latter: a number with hundreds of digits
        shown = value if written else repr(value)
        is_one = written and _short(hint).startswith("list[") and not shown.startswith("[")
        cure = f"; write a list of one as [{shown:.200}]" if is_one else ""
        raise UserError(f"{where:.200}={shown:.200}: expected {_short(hint)}{cure}") from error


def _short(hint: Any) -> str:
    """Return a type as people write it: without the modules of its parts."""
    name = hint.__name__ if isinstance(hint, type) else str(hint)
    return name.replace("typing.", "").replace("collections.abc.", "")


def split(text: str, at: str = ",") -> list[str]:
    """Split at every letter ``at`` outside brackets and quotes.

    A quote opens where a value begins; a pair of quotes inside a value, or one alone, are letters.
    """
    parts, depth, closing = [""], 0, -1
    for place, letter in enumerate(text):
        if place > closing:
            if letter in _QUOTES and text[:place].rstrip()[-1:] in _BEGINS:
                closing = text.find(letter, place + 1)
            depth += (letter == "[") - (letter == "]")
            if letter == at and depth == 0:
                parts.append("")
                continue
        parts[-1] += letter
    return parts


def quoted(text: str) -> str:
    """Return a value in quotes that it does not have itself."""
    quote = _QUOTES[_QUOTES[0] in text]
    return f"{quote}{text}{quote}"


def unquoted(text: str) -> str:
    """Return a value without the quotes around it, if there are any."""
    inner = text[1:-1]
    return inner if len(text) > 1 and text == f"{text[0]}{inner}{text[0]}" and text[0] in _QUOTES else text


def setting_groups(cls: type) -> dict[str, Any]:
    """Return the groups that a class takes, by the name of the argument, each with its default."""
    taken = inspect.signature(cls).parameters.values()
    return {item.name: item.default for item in taken if is_dataclass(item.default)}


def groups_by_setting(cls: type) -> dict[str, str]:
    """Return the group of every setting that is in one."""
    return {field.name: group for group, default in setting_groups(cls).items() for field in fields(default)}


def setting_types(cls: type) -> dict[str, Any]:
    """Return the type of every setting of a class by its name, those of groups in the place of the group."""
    hints, own, result = get_type_hints(cls.__init__), setting_groups(cls), {}
    for name in inspect.signature(cls).parameters:
        if name in own:
            inner = get_type_hints(type(own[name]))
            result |= {field.name: inner[field.name] for field in fields(own[name])}
        else:
            result[name] = hints.get(name, str)
    return result


def grouped(cls: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of a class, those of a group in a mapping under its name; others stay as they are.

    Mappings of groups may be among the given; a name without its group wins.

    Raises:
        UserError: A group is no mapping.
    """
    home = groups_by_setting(cls)
    result = {key: value for key, value in given.items() if key not in home}
    for key in given:
        if key in home:
            group = result.get(home[key]) or {}
            if not isinstance(group, Mapping):
                raise UserError(f"{home[key]}: expected settings by name, such as {key}, not {group!r:.60}")
            result[home[key]] = {**group, key: given[key]}
    return result


def build_ungrouped(cls: type, given: Mapping[str, Any]) -> Any:
    """Return an instance of a class with settings that are named without their groups.

    Raises:
        UserError: The class lacks a method of its base class, or a group is no mapping.
    """
    if lacks := sorted(getattr(cls, "__abstractmethods__", ())):
        base = next(one for one in cls.__mro__ if lacks[0] in vars(one))
        method = getattr(base, lacks[0])
        expected = f"{lacks[0]}{inspect.signature(method)}" if callable(method) else lacks[0]
        raise UserError(
            f"{cls.__name__} has no {' and no '.join(lacks)}: a {base.__name__} needs {expected}, "
            f"see {base.__module__}"
        )
    own, given = setting_groups(cls), grouped(cls, given)
    return cls(**{key: _changed(own[key], value) if key in own else value for key, value in given.items()})


def _changed(default: Any, values: Mapping[str, Any]) -> Any:
    """Return a group with new values, and those in which the class's default differs from the group's.

    Not `dataclasses.replace`: a group may choose values by others, such as a preset.
    """
    usual = type(default)()
    own = {field.name: getattr(default, field.name) for field in fields(default)}
    return type(default)(**{k: v for k, v in own.items() if v != getattr(usual, k)} | dict(values))


def flattened(*given: Any) -> dict[str, Any]:
    """Return the settings of some dataclasses without their groups, as plain values."""
    return {key: value for group in given for key, value in asdict(group).items()}
