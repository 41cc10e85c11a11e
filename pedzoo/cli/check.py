"""Misspelt options and names of a command line, refused before anything heavy is imported.

`pedzoo.cli.parsing` checks types and values, so what is doubtful passes here.
"""

import json
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

from pedzoo.core.errors import UserError, unknown
from pedzoo.core.paths import config_names
from pedzoo.core.registry import MODELS, POLICIES, ROBOT_POLICIES, SCENARIOS, names_code
from pedzoo.core.spec import name_of, split, unquoted

ROBOT_MODULES = "pedzoo.train.ppo.robots."
"""Where the classes are that train robots."""

TRAININGS = ("fit", "validate", "test")

_STARTS = ("--config", "-c", "--model", "--weights", "--resume", "--ckpt_path", "--print_config")
"""Options of trainings that say what is trained, or may."""

_POLICIES = {"rollout": slice(None), "evaluate": slice(None), "score": slice(None), "view": slice(1, 2)}
"""Which words before the options are names of policies, by command."""


@cache
def known() -> dict[str, list[str]]:
    """Return the options of every command that pedzoo parses; `tools.pages.command_options` writes them."""
    return json.loads(Path(__file__).with_name("options.json").read_text())


def check_names(command: str, argv: list[str]) -> None:
    """Refuse a misspelt option, policy, model, scenario or config.

    Raises:
        UserError: There is no such name; the message has the nearest one.
    """
    if {"-h", "--help"} & set(argv):
        return
    if command in known():
        _check_options(command, argv)
    if command in TRAININGS and not any(word.startswith(_STARTS) for word in argv):
        raise no_model_chosen()
    from pedzoo.data.text_format import is_recording

    words = list(takewhile(lambda word: not word.startswith("-"), argv))
    for name in words if command == "forecast" else []:
        check_model(name)
    for name in words[_POLICIES.get(command, slice(0))]:
        if command != "score" or not is_recording(name):
            _check_policy(name, command)
    for name in split_names(given(argv, "--people") or ""):
        if name_of(name) != "replay":  # the scenario
            _check_policy(name)
    for name in [given(argv, "--scenario"), *(words[:1] if command == "view" else [])]:
        scenario = name_of(name or "")
        if scenario and not (scenario.endswith((".yaml", ".yml")) or _is_code(scenario)):
            if scenario not in SCENARIOS.names():
                raise unknown(SCENARIOS.kind, scenario, SCENARIOS.names())
    if command == "fit" and (weights := given(argv, "--weights")) not in (None, "", "null"):
        check_model(weights)


def check_model(name: str, kind: str = "model", others: Sequence[str] = ()) -> None:
    """Refuse the name of a model that there is not; files are not looked for, but for checkpoints."""
    from pedzoo.models.zoo.store import ROBOTS, find, is_file, no_model, of_robots

    name = name_of(name)
    if is_file(name) or _is_code(name):
        if name.endswith(".ckpt") and not Path(name).is_file():
            raise UserError(f"no checkpoint at {name!r}")
    elif name.startswith(ROBOTS) and find(name):
        raise of_robots(name)
    elif name not in MODELS.names() and "://" not in name and find(name) is None:
        raise no_model(name, [*others, *known()["baselines"]], kind)


def _check_policy(text: str, command: str = "") -> None:
    """Refuse the name of a policy, or of one of a crowd."""
    from pedzoo.models.zoo.store import ROBOTS
    from pedzoo.policies.crowd_names import members, parts

    for one in [policy for policy, _ in members(text)] if len(parts(text)) > 1 else [text]:
        name = name_of(one)
        of_robot = name in ROBOT_POLICIES.names() or name.startswith(ROBOTS)
        if not (_is_code(name) or name in POLICIES.names() or (command == "evaluate" and of_robot)):
            check_model(name, "policy", POLICIES.names())


def _is_code(name: str) -> bool:
    return names_code(name) or name.endswith(".py")


def _check_options(command: str, argv: list[str]) -> None:
    model = given(argv, "--model") or (trained_class(argv) if command in TRAININGS else "")
    options = known()["fit robot" if command == "fit" and model.startswith(ROBOT_MODULES) else command]
    groups = {name.rpartition(".")[0] for name in options}
    leaves = {name.rpartition(".")[2] for name in options}
    for word in argv:
        flag = word.partition("=")[0]
        place = f"--{flag[2:].replace('-', '_')}".replace(".init_args", "")
        above = [place[:i] for i, letter in enumerate(place) if letter == "."]
        if not flag.startswith("--") or flag == "--" or place in options or flag.endswith((".help", "+")):
            continue
        own = place.startswith(("--trainer.", *(() if model.startswith("pedzoo.") else ("--model.",))))
        opened = any(name in options and name not in groups for name in above)
        if not (own or opened or (above and place.rpartition(".")[2] in leaves)):
            raise UserError(unknown_option(flag, options))


def trained_class(argv: list[str]) -> str:
    """Return the class that a training's config names, or that of the run it resumes; '' where none does."""
    from pedzoo.core.configs import load_config

    resumed = Path(given(argv, "--resume") or "", "config.yaml")
    name = resumed if given(argv, "--resume") else given(argv, "--config") or given(argv, "-c")
    model: Any = None
    if name and (name != resumed or resumed.is_file()):
        model = load_config(name).get("model")
    path = model.get("class_path") if isinstance(model, dict) else None
    return path if isinstance(path, str) else ""


def given(argv: list[str], flag: str) -> str | None:
    """Return the value that ``flag`` has on the command line, None where it is not there."""
    for i, word in enumerate(argv):
        name, joined, value = word.partition("=")
        if name == flag and (joined or i + 1 < len(argv)):
            return value if joined else argv[i + 1]
    return None


def whole_numbers(option: str, text: str) -> list[int]:
    """Return the numbers of ``0,1,2``.

    Raises:
        UserError: Something else is among them.
    """
    try:
        return [int(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise UserError(f"{option} {text}: expected whole numbers between commas") from None


def split_names(text: str) -> list[str]:
    """Split at commas, but for those between the settings behind a name's colon."""
    result: list[str] = []
    for part in filter(None, map(str.strip, split(text))):
        if result and ":" in result[-1] and "=" in part.partition(":")[0]:
            result[-1] += f",{part}"
        else:
            result.append(part)
    return [unquoted(part) for part in result]


def unknown_option(given: str, known: Iterable[str]) -> str:
    """Return the message for an option that does not exist, with the nearest one."""
    known = list(known)
    if given in known:  # it belongs to a model, and there is none yet
        return f"{given} needs a model: choose one with --config NAME ({shipped_configs()}) or --model CLASS"
    parent, _, leaf = given.rpartition(".")
    below = [name for name in known if name.startswith(f"{parent}.") or name.rpartition(".")[0] == parent]
    below.sort(key=lambda name: name.count("."))
    # of two with one name, the first of those that are nested least
    siblings = {name.rpartition(".")[2].lstrip("-"): name for name in reversed(below)}
    near = [siblings[name] for name in get_close_matches(leaf.lstrip("-"), siblings, n=1)]
    # `--lr` for `--model.lr`, then a misspelt parent
    near += [name for name in known if name.rpartition(".")[2] == leaf.lstrip("-")]
    near += get_close_matches(given, known, n=1, cutoff=0.7)
    return f"unknown option {given}" + (f": did you mean {near[0]}?" if near else "; --help lists all")


def no_model_chosen() -> UserError:
    """Return the error for a training without a model."""
    return UserError(f"no model: choose one with --config NAME ({shipped_configs()}) or --model CLASS")


def shipped_configs() -> str:
    """Return the names of all shipped configs, as messages list them."""
    return ", ".join(config_names()) or "none shipped"
