"""What a file of weights says about itself, read without its tensors and without torch."""

import json
from pathlib import Path
from typing import Any, NotRequired

from safetensors import SafetensorError, safe_open
from typing_extensions import TypedDict

from pedzoo.core.errors import UserError
from pedzoo.models.zoo.typed_fields import check, check_plain


class Config(TypedDict, closed=True):
    """Keys of a config; the first two are all that a model is built from."""

    architecture: str
    init: dict[str, Any]
    goal: NotRequired[str | None]
    protocol: NotRequired[dict[str, Any]]
    training: NotRequired[dict[str, Any]]


def opened(path: Path, framework: str = "np") -> Any:
    """Return an open file of weights whose tensors are of ``framework``.

    Raises:
        UserError: No such file, or it is damaged.
    """
    if not path.is_file():
        raise UserError(f"no weights at {str(path)!r}")
    try:
        return safe_open(path, framework)
    except SafetensorError as error:
        raise UserError(f"weights {str(path)!r} cannot be read ({error}): is the file cut off?") from error


def config_in(file: Any, path: Path) -> dict[str, Any]:
    """Return the config in the metadata of an open file.

    Raises:
        UserError: There is none that pedzoo wrote.
    """
    metadata = file.metadata() or {}
    if "config" not in metadata:
        raise UserError(
            f"weights {str(path)!r} have no pedzoo config in their metadata: not a file of this zoo"
        )
    try:
        config = json.loads(metadata["config"])
        check_plain(config)
        check(config, Config, "config")
    except (ValueError, RecursionError) as error:
        raise UserError(f"weights {str(path)!r} have a pedzoo config that cannot be read: {error}") from error
    return config


def read_config(path: str | Path) -> dict[str, Any]:
    """Return the config in a weight file's metadata; errors as `opened` and `config_in`."""
    with opened(Path(path)) as file:
        return config_in(file, Path(path))
