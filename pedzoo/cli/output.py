"""What several commands write: results as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from pedzoo.errors import UserError


def write_json(file: str | Path, content: dict[str, Any]) -> None:
    """Write ``content`` to ``file`` (``-`` for the terminal).

    Raises:
        UserError: The file's folder does not exist or cannot be written.
    """
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if str(file) == "-":
        sys.stdout.write(text)
        return
    try:
        Path(file).write_text(text)
    except OSError as error:
        raise UserError(f"cannot write {str(file)!r}: {error.strerror}") from error
