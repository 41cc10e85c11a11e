"""Mistakes that are refused before anything heavy is imported: options, names, settings and files.

The command checks all of it again. So a doubtful case passes here.
"""

import json
import os
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pedzoo.cli.file_checks import (
    check_checkpoint,
    check_code,
    check_file,
    check_recording,
    check_run,
    check_seconds,
    is_code,
)
from pedzoo.cli.main import PAGES
from pedzoo.cli.output import check_outputs
from pedzoo.cli.suggestions import NO_POLICIES, given, split_names, unknown_option, without_model
from pedzoo.core.configs import read_config
from pedzoo.core.errors import UserError, at_least_one, need, unknown
from pedzoo.core.paths import expanded, find_config
from pedzoo.core.registry import (
    METRICS,
    MODELS,
    PHYSICS,
    POLICIES,
    ROBOT_POLICIES,
    ROBOTS,
    SCENARIOS,
    SUITES,
    Registry,
    datasets_of_folds,
)
from pedzoo.core.spec import name_of, parse, unquoted
from pedzoo.data.text_format import is_recording
from pedzoo.models.zoo.store import ROBOTS as ROBOT_WEIGHTS
from pedzoo.models.zoo.store import find, is_file, no_model, of_robots
from pedzoo.policies.crowd_names import members, parts
from pedzoo.sim.scenario_parts.in_yaml import scenario_spec

ROBOT_MODULES = "pedzoo.train.robots."
"""Where the classes are that train robots."""

_TRAININGS = ("fit", "validate", "test")
_STARTS = ("--config", "-c", "--model", "--weights", "--resume", "--ckpt_path", "--print_config")
"""Options of trainings that say what is trained, or may."""

_NEEDS = {"--plot": "video", "--video": "video"}  # extras


@cache
def known() -> dict[str, Any]:
    """Return the options of commands, and the settings of what is named with some."""
    return json.loads((PAGES / "known.json").read_text())


def check(command: str, argv: list[str]) -> None:
    """Refuse a command line of a heavy command that is certainly wrong; others pass.

    Raises:
        UserError: An option, a name, a setting or a file that there is not.
    """
    if {"-h", "--help"} & set(argv):
        return
    if command == "view":
        for place, name in enumerate(_positional(argv)):
            _check_policy(name) if place else _check_scenario("", name)
    if command not in known()["options"]:
        return
    _check_options(command, argv)
    if command in ("rollout", "evaluate") and all(word.startswith("-") for word in argv):
        raise UserError(NO_POLICIES)
    if command in _TRAININGS and not any(word.startswith(_STARTS) for word in argv):
        raise UserError(without_model())
    for option, extra in _NEEDS.items():
        if given(argv, option) not in (None, "", "null"):
            need(extra, option)
    check_outputs(
        **{name: given(argv, f"--{name}") for name in ("json", "markdown", "plot", "video", "html")}
    )
    if command == "score":
        _check_times(argv)
    for name in _positional(argv):
        if command == "forecast":
            check_model(name)
        elif command == "score" and is_recording(name):
            check_recording("crowd", name)
        elif command in ("rollout", "evaluate", "score"):
            _check_policy(name, command)
    for option, look in _VALUES.items():
        value = given(argv, option)
        if value in (None, "", "null") or value.startswith("["):  # lists of YAML are read later
            continue
        # elsewhere it names a file; with --weights, one of both is too much
        if option == "--resume" and (command != "fit" or "--weights" in argv):
            continue
        for one in [value] if option in _SINGLE else split_names(value):
            if one:
                look(option, unquoted(one))


def _positional(argv: list[str]) -> list[str]:
    """Return the words before the first option."""
    return argv[: next((i for i, word in enumerate(argv) if word.startswith("-")), len(argv))]


def _model_class(command: str, argv: list[str]) -> str:
    """Return the class that is trained: of the command line, of its config, or of a base of that."""
    if path := given(argv, "--model"):
        return path
    name = given(argv, "--config") or given(argv, "-c")
    while command in _TRAININGS and name:
        file = find_config(name)
        settings = read_config(file)
        model, base = settings.get("model"), settings.get("base")
        path = model.get("class_path") if isinstance(model, dict) else None
        if path or not isinstance(base, str):
            return path if isinstance(path, str) else ""
        beside = file.parent / base
        name = str(beside) if beside.is_file() else base
    return ""


def _check_options(command: str, argv: list[str]) -> None:
    model = _model_class(command, argv)
    robots = command == "fit" and model.startswith(ROBOT_MODULES)
    options = known()["options"]["fit robot" if robots else command]
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


def _check_policy(text: str, command: str = "rollout") -> None:
    """Refuse the name of a policy, or of one of a crowd, and its settings."""
    for one in [part.policy for part in members(text)] if len(parts(text)) > 1 else [text]:
        spec = parse(one)
        settings = {key: value for key, value in spec.settings.items() if key != "share"}
        if is_code(spec.name):
            check_code("policy", spec.name)
        elif spec.name in POLICIES.names():
            _check_settings(POLICIES, spec.name, settings)
        elif command == "evaluate" and (
            spec.name in ROBOT_POLICIES.names() or spec.name.startswith(ROBOT_WEIGHTS)
        ):
            continue
        else:
            check_model(spec.name, "policy", POLICIES.names())
            _check_known("walker", "", spec.name, settings)


def check_model(name: str, kind: str = "model", others: Sequence[str] = ()) -> None:
    """Refuse the name of a model that there is not, or of a file; a class in a file is not looked for."""
    name = name_of(name)
    if is_file(name):
        if name.endswith(".ckpt") and not Path(name).is_file():
            raise UserError(f"no checkpoint at {name!r}")
        check_code(kind, name) if is_code(name) else check_file(kind, name)
    elif name.startswith(ROBOT_WEIGHTS) and find(name):
        raise of_robots(name)
    elif name not in MODELS.names() and "://" not in name and find(name) is None:
        raise no_model(name, [*others, *known()["baselines"]], kind)


def _check_name(kind: str, text: str, names: Iterable[str]) -> None:
    """Refuse a name that is none of ``names``, and no class or function in a file."""
    if is_code(text):
        check_code(kind, text, "function" if kind == METRICS.kind else "class")
    elif text not in names:
        raise unknown(kind, text, names)


def _check_settings(registry: Registry, name: str, settings: dict[str, str]) -> None:
    _check_name(registry.kind, name, registry.names())
    _check_known(registry.kind, name, name, settings)


def _check_known(kind: str, name: str, said: str, settings: dict[str, str]) -> None:
    expected = known()["settings"][kind].get(name)
    if expected is not None and (wrong := [key for key in settings if key not in expected]):
        raise unknown(f"setting of {kind} {said}", wrong[0], expected)


def _check_scenario(option: str, text: str) -> None:
    spec = scenario_spec(text)
    _check_settings(SCENARIOS, spec.name, dict(spec.settings))
    plan = spec.settings.get("map")
    shipped = spec.name in known()["settings"]["scenario"]  # what others call a map is their own
    if shipped and isinstance(plan, str) and plan != "null" and not plan.startswith("["):
        _check_plan(option, unquoted(plan))


def _check_plan(option: str, text: str) -> None:
    kinds, (kind, _, seed) = known()["plans"], text.partition(".")
    if text != "flat" and kind not in kinds and not os.path.exists(expanded(text)):
        if Path(text).suffix.lower() in known()["plan_files"]:
            raise UserError(f"no map file {text!r}")
        raise unknown("floor plan", text, ["flat", *(f"{kind}.{seed or 7}" for kind in kinds)])


def _check_physics(option: str, text: str) -> None:
    spec = parse(text)
    _check_settings(PHYSICS, spec.name, dict(spec.settings))


def _check_suite(option: str, text: str) -> None:
    _check_name("suite", text, SUITES.names())


def _check_fold(option: str, text: str) -> None:
    _check_name("fold", text, datasets_of_folds())


def _check_metric(option: str, text: str) -> None:
    _check_name(METRICS.kind, text, METRICS.names())


def _check_robot(option: str, text: str) -> None:
    _check_name("robot", name_of(text), ROBOTS.names())


def _check_times(argv: list[str]) -> None:
    """Refuse a score of files without the seconds between their frame numbers."""
    against, dt = given(argv, "--against"), given(argv, "--dt")
    if against and is_recording(against):
        check_seconds("--data.dt", given(argv, "--data.dt"), "the file of --against", [against])
    if dt not in (None, "", "null"):
        check_seconds("--dt", dt, "the scored files")


def _check_against(option: str, text: str) -> None:
    check_recording("recording", text) if is_recording(text) else _check_fold(option, text)


def _check_choice(option: str, text: str) -> None:
    if text not in (expected := known()["choices"][option]):
        raise unknown(option, text, expected)


def _check_whole(option: str, text: str) -> None:
    try:
        int(text)
    except ValueError:
        raise UserError(f"{option} {text}: expected a whole number") from None


def _check_count(option: str, text: str) -> None:
    _check_whole(option, text)
    at_least_one(option, int(text))


def _check_people(option: str, text: str) -> None:
    if name_of(text) != "replay":  # the scenario
        _check_policy(text)


def _check_weights(option: str, text: str) -> None:
    check_model(text)


_VALUES: dict[str, Callable[[str, str], None]] = {
    "--scenario": _check_scenario,
    "--rollout.scenarios": _check_scenario,
    "--physics": _check_physics,
    "--rollout.physics": _check_physics,
    "--suite": _check_suite,
    "--maps": _check_plan,
    "--metrics": _check_metric,
    "--robot": _check_robot,
    "--against": _check_against,
    "--episodes": _check_count,
    "--rollouts": _check_count,
    "--people": _check_people,
    "--trainer.max_epochs": _check_whole,
    "--data.goal": _check_choice,
    "--data.fold": _check_fold,
    "--data.files": check_recording,
    "--data.homography": check_file,
    "--weights": _check_weights,
    "--ckpt_path": check_checkpoint,
    "--resume": check_run,
}
_SINGLE = ("--scenario", "--physics", "--weights", "--ckpt_path", "--resume", "--data.homography")
