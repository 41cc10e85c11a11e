"""A command's options from the signature of its function, and errors that say what to type instead.

jsonargparse checks everything; what it says about nested options is long, so it is translated here.
"""

import inspect
import json
import re
from argparse import ArgumentError
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from itertools import takewhile
from pydoc import locate
from typing import Any, TypeVar, get_args, get_origin

from docstring_parser import parse_from_object
from jsonargparse import ArgumentParser, Namespace

from pedzoo.cli.check import no_model_chosen, shipped_configs, split_names, unknown_option
from pedzoo.core.adapters import option_types
from pedzoo.core.errors import UserError
from pedzoo.core.paths import find_config
from pedzoo.core.registry import COMMANDS
from pedzoo.core.spec import groups_by_setting, split

Function = TypeVar("Function", bound=Callable[..., int])

PARSER_SETTINGS: dict[str, Any] = {"exit_on_error": False, "allow_abbrev": False}
"""For every parser used with `parse`: errors are raised, and ``--trainer.max_epoch`` is a misspelling."""

_TRUTH = ("true", "false", "yes", "no", "on", "off")

_POSITIONAL = inspect.Parameter.POSITIONAL_ONLY


def command(example: str) -> Callable[[Function], Function]:
    """Declare a function in `pedzoo.cli.commands` as the command of its name; it returns the exit code.

    A function of ``argv`` parses the words itself. Of any other one the options are the arguments, with the
    texts of its docstring: positional-only arguments are words, ``data_root`` is ``--data.root``, a list has
    commas between its values, a tuple spaces. A further argument ``argv`` gets the words as they were typed.
    The first line of the docstring and the ``example``, both literals, are read without an import.
    """
    return lambda function: function


def call(function: Callable[..., int], argv: list[str]) -> int:
    """Run the function of a command with a command line, and return its exit code."""
    arguments = inspect.signature(function, eval_str=True).parameters
    if next(iter(arguments), "") == "argv":
        return function(argv)
    options = parse(parser_of(function), argv)
    words = [options[name] for name, one in arguments.items() if one.kind is _POSITIONAL]
    settings = {name: options[_option(name)] for name in list(arguments)[len(words) :] if name != "argv"}
    if "argv" in arguments:
        settings["argv"] = argv
    return function(*words, **settings)


def parser_of(function: Callable[..., Any]) -> ArgumentParser:
    """Return a parser whose options are the arguments of a function, for the command of its name."""
    name = function.__name__.lstrip("_")
    parser = ArgumentParser(
        prog=f"pedzoo {name}",
        usage="",
        description=COMMANDS.describe(name),
        **PARSER_SETTINGS,
    )
    about = {one.arg_name: one.description for one in parse_from_object(function).params}
    words = ""
    for item in inspect.signature(function, eval_str=True).parameters.values():
        kind, required = item.annotation, item.default is item.empty
        if item.name == "argv" or item.kind is item.VAR_KEYWORD:
            continue
        settings: dict[str, Any] = {"help": about.get(item.name)}
        if item.kind is _POSITIONAL:
            several = get_origin(kind) is list
            settings |= {"nargs": "+" if required else "*"} if several else {} if required else {"nargs": "?"}
            kind = get_args(kind)[0] if several else kind
            word = f"{item.name.upper()}{'...' if several else ''}"
            words += f"{word} " if required else f"[{word}] "
            names = [item.name]
        else:
            names = [*(["-o"] if item.name == "out" else []), f"--{_option(item.name)}"]
            if get_origin(kind) is tuple and ... in get_args(kind):
                settings["nargs"], kind = "+", get_args(kind)[0]
            settings["required"] = required
        if not required:
            settings["default"] = list(item.default) if item.default == () else item.default
        parser.add_argument(*names, type=kind, **settings)
    parser.usage = f"%(prog)s {words}[options]\nexample: {COMMANDS.declared(name)[0]}"
    return parser


def _option(argument: str) -> str:
    return argument.replace("data_", "data.", 1) if argument.startswith("data_") else argument


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
        return parser.parse_args(_as_jsonargparse_reads(parser, argv))
    except ArgumentError as error:
        said = explain(str(error), known_options(parser, classes))
        raise UserError(said if said != str(error) else f"{said} (see {parser.prog} --help)") from error


def explain(message: str, known: list[str]) -> str:
    """Return jsonargparse's ``message`` in one line, with the nearest of the ``known`` options."""
    for pattern, words in _MESSAGES:
        if found := re.search(pattern, message):
            # nested texts come down to an option, and to the class that takes it
            above = message[: found.start()]
            path = "--" + ".".join(re.findall(r'Parser key "([^"]*)"', above))
            owners = re.findall(r"given class_path '([^']*)'", above)
            options = [_below(path, name) for name in parameters(locate(owners[-1]))] if owners else []
            if isinstance(words, str):
                return words.format(*found.groups(), path=path, configs=shipped_configs())
            if text := words(found, path, options, known):
                return text
    return message


def _unrecognized(found: re.Match[str], path: str, options: list[str], known: list[str]) -> str:
    given = found[1].partition("=")[0]
    if options:  # one of a group in a class
        return unknown_option(_below(path, given.lstrip("-")), options)
    return unknown_option(given, known) if given.startswith("-") else f"unexpected argument {given!r}"


def _mismatch(found: re.Match[str], path: str, *_: object) -> str:
    expected = " or ".join(_plain(part.strip()) for part in split(found[1]))
    near = get_close_matches(found[2], re.findall(r"'([^']*)'", expected), n=1)
    return f"{path}: expected {expected}, not {found[2]!r}" + (f": did you mean {near[0]!r}?" if near else "")


def _plain(name: str) -> str:
    name = re.sub(r"<class '(?:\w+\.)*(\w+)'>", r"\1", name).replace("NoneType", "null")
    return re.sub(r"(?:typing\.)?Literal\[(.*)\]", r"one of \1", name)


def _below(path: str, name: str) -> str:
    return f"{path}{name}" if path == "--" else f"{path}.{name}"


_CLASS = r"given class_path '([^']*)':\s+"

_MESSAGES: tuple[tuple[str, str | Callable[..., str]], ...] = (
    (r"unrecognized arguments: (\S+)", _unrecognized),
    (r"arguments are required: model\b", lambda *all: str(no_model_chosen()) if "--model" in all[-1] else ""),
    (
        r"arguments are required: policies\b",
        "no policies: name them before the options, as in orca go_to_goal --episodes 20",
    ),
    (
        r"Group '([^']*)' does not accept option '([^']*)'",
        lambda found, _, __, known: unknown_option("--" + ".".join(filter(None, found.groups())), known),
    ),
    (
        r"Option '([^']*)' is not accepted",
        lambda found, path, options, known: unknown_option(_below(path, found[1]), options or known),
    ),
    (r"Expected an? (.+?)\. Got value: (.*)", _mismatch),
    (
        r"Expected a dot import path string: (.*)",
        "{path}: no class {0!r}; PACKAGE.CLASS names any, and {path}.help CLASS explains one",
    ),
    (
        rf"{_CLASS}the following arguments are required: (.*)",
        "{path} {0} needs {1}, too: start from --config NAME ({configs})",
    ),
    (rf"{_CLASS}(.*)", "{path} {0}: {1}"),
    (r"Subtypes: \[(.*)\](?:.|\n)*Given value: (.*)", _mismatch),
)
"""What jsonargparse says and what we say: a text, or a function of match, option, options there and all."""


def parameters(owner: object) -> list[str]:
    """Return the names that a class accepts, in its groups too, and in its bases where it passes them on."""
    if not isinstance(owner, type):
        return []
    names = ArgumentParser(exit_on_error=False).add_class_arguments(owner, fail_untyped=False)
    return [*names, *(f"{group}.{name}" for name, group in groups_by_setting(owner).items())]


def known_options(parser: ArgumentParser, classes: Iterable[tuple[str, type]] = ()) -> list[str]:
    """Return the options of a parser, and of the subclasses that it configures; arguments as of `parse`."""
    known = [name for name in option_types(parser) if name.startswith("--")]
    for prefix, base in classes:
        family = [base, *base.__subclasses__()]
        family += [cls for child in family[1:] for cls in child.__subclasses__()]
        known += [f"--{prefix}.{name}" for cls in family for name in parameters(cls)]
    return known


def _as_jsonargparse_reads(parser: ArgumentParser, argv: list[str]) -> list[str]:
    """Return a command line as jsonargparse reads it, from one as people type it.

    ``--video-view`` stands for ``--video_view``, ``--quick`` alone for ``--quick=true``, and a shipped
    config's name for its file. ``a.csv,b.csv`` gets brackets where a list is expected. What could be
    something else too, as ``--trainer.devices 2``, is a list only where it has a comma. Settings stay with
    their name: ``door:width=0.9,people=4,circle`` is two scenarios.
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
        if not (joined or follows):
            continue
        value, place = (value, i) if joined else (follows[0], i + 1)
        new = value
        if flag in ("--config", "-c") and value:
            new = str(find_config(value))
        options = [one for one in (hint, *get_args(hint)) if one is not type(None)]
        kind = next((one for one in options if get_origin(one) in (list, tuple)), None)
        alone = hint is kind or all(one in (hint, kind) for one in options)
        is_list = kind is not None and not value.startswith(("[", "-", "{")) and value != "null"
        if is_list and (alone or "," in value):
            if get_origin(kind) is tuple and ... not in get_args(kind):
                _check_count(flag, len(get_args(kind)), value, argv[place + 1 :])
            new = json.dumps(split_names(value)) if get_args(kind)[0] is str else f"[{value}]"
        if new != value:
            result[place] = f"{flag}={new}" if joined else new
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
