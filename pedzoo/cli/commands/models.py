"""``pedzoo models``: what can be trained and what can be loaded, read without importing torch."""

from __future__ import annotations

import json
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from pedzoo.cli.arguments import Arguments
from pedzoo.cli.output import write_json
from pedzoo.errors import UserError
from pedzoo.paths import shipped
from pedzoo.registry import MODELS

HELP = "list architectures and released weights"
EXAMPLE = "pedzoo models 'sgan*'"


def run(argv: list[str]) -> int:
    """Print both tables; returns the exit code."""
    parser = Arguments("models", HELP, EXAMPLE)
    parser.add_argument("pattern", nargs="?", default="*", help="which names, with * and ?")
    parser.add_argument("--json", metavar="FILE", help="also write the tables to this file")
    options = parser.parse_args(argv)
    architectures = [
        {"name": name, "about": MODELS.describe(name)}
        for name in MODELS.names()
        if fnmatch(name, options.pattern)
    ]
    files = sorted(shipped("checkpoints").glob("*.safetensors"))
    weights = [_weights_row(path) for path in files if fnmatch(path.stem, options.pattern)]
    _print("architectures (pedzoo fit --config ...)", architectures)
    _print("weights (pedzoo.load(name), pedzoo forecast NAME)", weights)
    if options.json:
        write_json(options.json, {"command": "models", "architectures": architectures, "weights": weights})
    return 0


def read_metadata(path: Path) -> dict[str, Any]:
    """Return the ``config`` that a safetensors file carries, reading its header only.

    Raises:
        UserError: The file is cut off or no safetensors file.
    """
    try:
        with path.open("rb") as file:
            # The format: eight bytes of little-endian length, then that much JSON.
            size = int.from_bytes(file.read(8), "little")
            if size > path.stat().st_size:
                raise ValueError("header longer than the file")
            header = json.loads(file.read(size))
        return json.loads(header.get("__metadata__", {}).get("config", "{}"))
    except (ValueError, AttributeError) as error:
        raise UserError(f"{path} is not a readable safetensors file ({error}): download it again") from error


def _weights_row(path: Path) -> dict[str, Any]:
    config = read_metadata(path)
    facts = ", ".join(
        f"{key} {value}" for key, value in config.items() if isinstance(value, str | int | float)
    )
    return {"name": path.stem, "kB": path.stat().st_size // 1000, "about": facts}


def _print(title: str, rows: list[dict[str, Any]]) -> None:
    print(f"{title}:")
    width = max((len(row["name"]) for row in rows), default=0)
    for row in rows:
        size = f"{row['kB']:>7} kB  " if "kB" in row else ""
        print(f"  {row['name']:<{width}}  {size}{row['about']}")
    if not rows:
        print("  none")
    print()
