"""Parsing with errors that a person can act on: one line, with the option's full name and its right spelling.

jsonargparse checks everything; what it says about nested options is long, so it is translated here.
"""

import inspect
import json
import re
from argparse import ArgumentError
from collections.abc import Iterable
from difflib import get_close_matches
from itertools import takewhile
from pydoc import locate
from typing import Any, get_args, get_origin

from jsonargparse import ArgumentParser, Namespace

from pedzoo.cli.suggestions import NO_POLICIES, shipped_configs, split_names, unknown_option, without_model
from pedzoo.core.adapters import option_types
from pedzoo.core.errors import UserError
from pedzoo.core.paths import find_config
from pedzoo.core.spec import homes, split

PARSER_SETTINGS: dict[str, Any] = {"exit_on_error": False, "allow_abbrev": False}
"""For every parser used with `parse`: errors are raised, and ``--trainer.max_epoch`` is a misspelling."""


_TRUTH = ("true", "false", "yes", "no", "on", "off")


def parse(parser: ArgumentParser, argv: list[str], classes: Iterable[tuple[str, type]] = ()) -> Namespace:
    """Return the parsed options.

    Args:
        parser: Made with `PARSER_SETTINGS`.
        argv: The command line; ``--config`` may name a shipped config.
        classes: Option prefixes and the base class whose subclasses they configure, for suggestions.

    Raises:
        UserError: An option or value is refused.
    """
    try:
        return parser.parse_args(_written_out(parser, _config_files(argv)))
    except ArgumentError as error:
        raise UserError(explain(str(error), known_options(parser, classes))) from error


def explain(message: str, known: list[str]) -> str:
    """Return jsonargparse's ``message`` in one line, with the nearest of the ``known`` options."""
    if match := re.search(r"unrecognized arguments: (\S+)", message):
        given = match[1].partition("=")[0]
        path, owner = _place(message[: match.start()])
        if owner:  # one of a group in it
            return unknown_option(f"{path}.{given.lstrip('-')}", _options_of(path, owner))
        return unknown_option(given, known) if given.startswith("-") else f"unexpected argument {given!r}"
    if re.search(r"arguments are required: model\b", message):
        return without_model()
    if re.search(r"arguments are required: policies\b", message):
        return NO_POLICIES
    if match := re.search(r"Group '([^']*)' does not accept option '([^']*)'", message):
        return unknown_option("--" + ".".join(filter(None, match.groups())), known)
    if match := re.search(r"Option '([^']*)' is not accepted", message):
        path, owner = _place(message[: match.start()])
        options = _options_of(path, owner) if owner else []
        return unknown_option(_below(path, match[1]), options or known)
    if match := re.search(r"Expected an? (.+?)\. Got value: (.*)", message):
        path, _ = _place(message[: match.start()])
        return _mismatch(path, _plain(match[1]), match[2])
    if match := re.search(r"Not of type \w+: (.*) does not conform to restriction v(.*)", message):
        path, _ = _place(message[: match.start()])
        return f"{path}: expected a number {match[2]}, not {match[1]}"
    if match := re.search(r"Expected a dot import path string: (.*)", message):
        path, _ = _place(message[: match.start()])
        return f"{path}: no class {match[1]!r}; PACKAGE.CLASS names any, and {path}.help CLASS explains one"
    if match := re.search(
        r"given class_path '([^']*)':\s+the following arguments are required: (.*)", message
    ):
        path, _ = _place(message[: match.start()])
        return f"{path} {match[1]} needs {match[2]}, too: start from --config NAME ({shipped_configs()})"
    if match := re.search(r"given class_path '([^']*)':\s+(.*)", message):
        path, _ = _place(message[: match.start()])
        return f"{path} {match[1]}: {match[2]}"
    if match := re.search(r"Subtypes: \[(.*)\]", message):
        path, _ = _place(message[: match.start()])
        value = re.search(r"Given value: (.*)", message)
        expected = " or ".join(_plain(part.strip()) for part in split(match[1]))
        return _mismatch(path, expected, value[1] if value else "?")
    return message


def parameters(owner: object) -> list[str]:
    """Return the names that a class accepts, in its groups too, and in its bases where it passes them on."""
    names: list[str] = []
    for cls in inspect.getmro(owner) if isinstance(owner, type) else ():
        if "__init__" not in vars(cls):
            continue
        taken = inspect.signature(cls.__init__).parameters.values()
        names += [item.name for item in taken if item.kind not in (item.VAR_POSITIONAL, item.VAR_KEYWORD)][1:]
        names += [f"{group}.{name}" for name, group in homes(cls).items()]
        if all(item.kind != item.VAR_KEYWORD for item in taken):
            break
    return names


def _options_of(path: str, owner: str) -> list[str]:
    return [_below(path, name) for name in parameters(locate(owner))]


def _below(path: str, name: str) -> str:
    return f"{path}{name}" if path == "--" else f"{path}.{name}"


def _place(text: str) -> tuple[str, str]:
    """Return the option that the nested ``text`` has come down to, and the class that takes it."""
    owners = re.findall(r"given class_path '([^']*)'", text)
    return "--" + ".".join(re.findall(r'Parser key "([^"]*)"', text)), owners[-1] if owners else ""


def _mismatch(option: str, expected: str, given: str) -> str:
    near = get_close_matches(given, re.findall(r"'([^']*)'", expected), n=1)
    return f"{option}: expected {expected}, not {given!r}" + (f": did you mean {near[0]!r}?" if near else "")


def _plain(name: str) -> str:
    name = re.sub(r"<class '(?:\w+\.)*(\w+)'>", r"\1", name).replace("NoneType", "null")
    return re.sub(r"(?:typing\.)?Literal\[(.*)\]", r"one of \1", name)


def known_options(parser: ArgumentParser, classes: Iterable[tuple[str, type]]) -> list[str]:
    """Return the options of a parser, and of the subclasses that it configures; arguments as of `parse`."""
    known = [name for name in option_types(parser) if name.startswith("--")]
    for prefix, base in classes:
        family = [base, *base.__subclasses__()]
        family += [cls for child in family[1:] for cls in child.__subclasses__()]
        known += [f"--{prefix}.{name}" for cls in family for name in parameters(cls)]
    return known


def _config_files(argv: list[str]) -> list[str]:
    """Replace the names of shipped configs by their files."""
    result = list(argv)
    for i, word in enumerate(argv):
        flag, _, value = word.partition("=")
        if flag in ("--config", "-c") and value:
            result[i] = f"{flag}={find_config(value)}"
        elif word in ("--config", "-c") and i + 1 < len(argv):
            result[i + 1] = str(find_config(argv[i + 1]))
    return result


def _written_out(parser: ArgumentParser, argv: list[str]) -> list[str]:
    """Return a command line as jsonargparse reads it, from one as people type it.

    ``--video-view`` stands for ``--video_view``, and ``--quick`` alone for ``--quick=true``.
    ``a.csv,b.csv`` gets brackets where a list is expected. What could be something else too, as
    ``--trainer.devices 2``, is a list only where it has a comma. Settings stay with their name:
    ``door:width=0.9,people=4,circle`` is two scenarios.
    """
    known, result = option_types(parser), list(argv)
    for i, word in enumerate(argv):
        flag, joined, value = word.partition("=")
        plain = f"--{flag[2:].replace('-', '_')}"
        if flag.startswith("--") and flag not in known and plain in known:
            flag, result[i] = plain, plain + joined + value
        hint, follows = known.get(flag), argv[i + 1 : i + 2]
        if hint is bool and not joined and not (follows and follows[0].lower() in _TRUTH):
            result[i] = f"{flag}=true"
        kind, alone = _list_type(hint)
        if kind is None or not (joined or follows):
            continue
        item = get_args(kind)[0]
        value = value if joined else follows[0]
        if not value.startswith(("[", "-", "{")) and value != "null" and (alone or "," in value):
            if get_origin(kind) is tuple and ... not in get_args(kind):
                _check_count(flag, len(get_args(kind)), value, argv[i + 1 + (not joined) :])
            listed = json.dumps(split_names(value)) if item is str else f"[{value}]"
            result[i if joined else i + 1] = f"{flag}={listed}" if joined else listed
    return result


def _check_count(option: str, count: int, value: str, behind: list[str]) -> None:
    """Refuse another number of values than ``count``; words ``behind`` were meant as further ones."""
    given = value.split(",")
    if len(given) == count:
        return
    further = takewhile(lambda word: not word.startswith("--"), behind)
    example = [*given, *further, *given * count][:count]
    expected = f"{count} values with a comma between them, as {option} {','.join(example)}"
    raise UserError(f"{option} {value}: expected {expected}")


def _list_type(hint: object) -> tuple[object | None, bool]:
    """Return the list or tuple type in a type, or None, and whether it is the only choice."""
    options = (hint, *get_args(hint))
    for option in options:
        if get_origin(option) in (list, tuple):
            others = [one for one in options if one not in (hint, option, type(None))]
            return option, hint is option or not others
    return None, False
