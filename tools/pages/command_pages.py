"""Writes what the command line knows without importing anything heavy: help pages, options and settings.

``python tools/pages/command_pages.py`` after a change of options or settings; a test holds the files.
"""

import contextlib
import io
import json
import os
import re
from importlib import import_module
from pathlib import Path
from pydoc import locate
from typing import Any, get_args
from unittest.mock import patch

from pedzoo.cli import parsing
from pedzoo.cli.main import COMMANDS
from pedzoo.core.configs import load_config
from pedzoo.core.paths import config_names
from pedzoo.core.registry import PHYSICS, POLICIES, ROBOT_POLICIES, SCENARIOS, Registry
from pedzoo.core.spec import setting_types
from pedzoo.core.types import GoalProtocol
from pedzoo.maps.plans import FILES
from pedzoo.maps.procedural.plan import KINDS
from pedzoo.models.zoo.loading import baselines
from pedzoo.policies.learned.walker import Walker

PAGES = Path(parsing.__file__).with_name("pages")
HEAVY = ("evaluate", "fit", "forecast", "rollout", "score", "test", "validate")
"""Commands whose options are read from signatures of heavy modules."""

_TRAINER = re.compile("Customize every aspect of training via flags:.*?\n\n", re.DOTALL)
_SUBCLASSES = re.compile(r",\s+known\s+subclasses:[^)]*")
_IN_SHORT = """\
Lightning's trainer, as --trainer.max_epochs 20; `pedzoo {} --config NAME --help` explains all:
  max_epochs, max_steps, max_time, devices, accelerator, strategy, precision, check_val_every_n_epoch,
  limit_train_batches, limit_val_batches, log_every_n_steps, enable_progress_bar, callbacks, ...

"""
"""Stands for 300 lines, which differ from one version of Lightning to the next."""

_GIVEN = {"model", "bank", "body_radius"}
"""Arguments that no setting of a name is for."""


def pages() -> dict[str, str]:
    """Return the help of every heavy command."""
    return {name: _page(name) for name in HEAVY}


def known() -> dict[str, Any]:
    """Return the options of every heavy command, and the settings of everything that is named with some."""
    for name in config_names():  # subclasses are known once they are imported
        locate(str(load_config(name).get("model", {}).get("class_path")))
    options = {name: _options(name, []) for name in HEAVY}
    options["fit robot"] = _options("fit", ["--config", "robot/ppo"])
    registries = (POLICIES, ROBOT_POLICIES, SCENARIOS, PHYSICS)
    settings = {registry.kind: _settings(registry) for registry in registries}
    settings["walker"] = {"": sorted(setting_types(Walker).keys() - _GIVEN)}
    choices = {"--data.goal": list(get_args(GoalProtocol))}
    return {
        "options": options,
        "settings": settings,
        "choices": choices,
        "plans": list(KINDS),
        "plan_files": list(FILES),
        "baselines": baselines(),
    }


def write() -> None:
    """Write all files."""
    PAGES.mkdir(exist_ok=True)
    for name, text in pages().items():
        (PAGES / f"{name}.txt").write_text(text)
    (PAGES / "known.json").write_text(json.dumps(known(), indent=1) + "\n")


def _page(command: str) -> str:
    text = io.StringIO()
    with patch.dict(os.environ, COLUMNS="100"), contextlib.redirect_stdout(text):
        with contextlib.suppress(SystemExit):
            _run(command, ["--help"])
    return _TRAINER.sub(_IN_SHORT.format(command), _SUBCLASSES.sub("", text.getvalue()))


def _options(command: str, argv: list[str]) -> list[str]:
    seen: list[str] = []

    def look(parser: Any, argv: list[str], classes: Any = ()) -> None:
        seen.extend(parsing.known_options(parser, classes))
        raise SystemExit

    training = [import_module(f"pedzoo.cli.{name}") for name in ("training", "robot_training")]
    with contextlib.ExitStack() as patched, contextlib.suppress(SystemExit):
        for module in (parsing, *training):
            patched.enter_context(patch.object(module, "parse", look))
        _run(command, argv)
    return list(dict.fromkeys(name for name in seen if not name.startswith("--trainer.")))


def _run(command: str, argv: list[str]) -> None:
    import_module(f"{COMMANDS.package_of(command)}.{command}").run(argv)


def _settings(registry: Registry) -> dict[str, list[str]]:
    return {name: sorted(setting_types(registry.get(name)).keys() - _GIVEN) for name in registry.names()}


if __name__ == "__main__":
    write()
