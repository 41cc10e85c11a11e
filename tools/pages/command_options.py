"""Writes the options of all commands for `pedzoo.cli.check`, which looks for misspelt ones.

``python -m tools.pages.command_options`` after a change of options; a test holds the file.
"""

import contextlib
import json
from pathlib import Path
from pydoc import locate
from typing import Any
from unittest.mock import patch

from pedzoo.cli import check, parsing, training
from pedzoo.cli.commands import forecast
from pedzoo.core.configs import load_config
from pedzoo.core.paths import config_names
from pedzoo.core.registry import COMMANDS
from pedzoo.models.zoo.loading import baselines

FILE = Path(check.__file__).with_name("options.json")

ROBOT = ("fit robot", "fit", ["--config", "robot/ppo"])


def known() -> dict[str, list[str]]:
    """Return the options of each command, and the models that need no weights."""
    for name in config_names():  # subclasses are known once they are imported
        locate(str(load_config(name).get("model", {}).get("class_path")))
    asked = [(name, name, []) for name in COMMANDS.names() if name not in ("bench", "reproduce")]
    result = {title: _options(name, words) for title, name, words in sorted([*asked, ROBOT])}
    return result | {"baselines": baselines()}


def _options(command: str, argv: list[str]) -> list[str]:
    seen: list[str] = []

    def look(parser: Any, argv: list[str], classes: Any = ()) -> None:
        seen.extend(parsing.known_options(parser, classes))
        raise SystemExit

    with contextlib.suppress(SystemExit), contextlib.ExitStack() as stack:
        for module in (training, forecast, parsing):
            stack.enter_context(patch.object(module, "parse", look))
        parsing.call(COMMANDS.get(command), argv)
    return list(dict.fromkeys(name for name in seen if not name.startswith("--trainer.")))


if __name__ == "__main__":
    FILE.write_text(json.dumps(known(), indent=1) + "\n")
