"""Writes the options of commands whose parsers are slow to make, for `pedzoo.cli.check`.

``python -m tools.pages.command_options`` after a change of options; a test holds the file.
"""

import contextlib
import json
from pathlib import Path
from pydoc import locate
from typing import Any
from unittest.mock import patch

from pedzoo.cli import check, training
from pedzoo.cli.commands import fit, forecast, test, validate
from pedzoo.cli.parsing import known_options
from pedzoo.core.configs import load_config
from pedzoo.core.paths import config_names
from pedzoo.models.zoo.loading import baselines

FILE = Path(check.__file__).with_name("options.json")


def known() -> dict[str, list[str]]:
    """Return the options of each of these commands, and the models that need no weights."""
    for name in config_names():  # subclasses are known once they are imported
        locate(str(load_config(name).get("model", {}).get("class_path")))
    result = {name: _options(*one) for name, one in COMMANDS.items()}
    return result | {"baselines": baselines()}


COMMANDS = {
    "fit": (fit, []),
    "fit robot": (fit, ["--config", "robot/ppo"]),
    "forecast": (forecast, []),
    "test": (test, []),
    "validate": (validate, []),
}


def _options(command: Any, argv: list[str]) -> list[str]:
    seen: list[str] = []

    def look(parser: Any, argv: list[str], classes: Any = ()) -> None:
        seen.extend(known_options(parser, classes))
        raise SystemExit

    with contextlib.suppress(SystemExit), patch.object(training, "parse", look):
        with patch.object(forecast, "parse", look):
            command.run(argv)
    return list(dict.fromkeys(name for name in seen if not name.startswith("--trainer.")))


if __name__ == "__main__":
    FILE.write_text(json.dumps(known(), indent=1) + "\n")
