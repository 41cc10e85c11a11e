"""``pedzoo models``: what can be trained and what can be loaded, read without importing torch."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from pedzoo.cli.arguments import Arguments
from pedzoo.cli.output import write_json
from pedzoo.models.header import read_config
from pedzoo.paths import weight_files
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
    files = weight_files().items()
    weights = [_weights_row(name, path) for name, path in files if fnmatch(name, options.pattern)]
    _print("architectures (pedzoo fit --config ...)", architectures)
    _print("weights (pedzoo.load(name), pedzoo forecast NAME)", weights)
    if options.json:
        write_json(options.json, {"command": "models", "architectures": architectures, "weights": weights})
    return 0


def _weights_row(name: str, path: Path) -> dict[str, Any]:
    config = read_config(path)
    facts = ", ".join(
        f"{key} {value}" for key, value in config.items() if isinstance(value, str | int | float)
    )
    return {"name": name, "kB": path.stat().st_size // 1000, "about": facts}


def _print(title: str, rows: list[dict[str, Any]]) -> None:
    print(f"{title}:")
    width = max((len(row["name"]) for row in rows), default=0)
    for row in rows:
        size = f"{row['kB']:>7} kB  " if "kB" in row else ""
        print(f"  {row['name']:<{width}}  {size}{row['about']}")
    if not rows:
        print("  none")
    print()
