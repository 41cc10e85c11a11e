"""Functions compiled by numba: the one decorator, and where the machine code is kept."""

import hashlib
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any


def compiled(signature: str | None = None) -> Callable[[Any], Any]:
    """Return a decorator that compiles a function: at once for a signature, else when it is first called.

    Machine code is kept in the package, or in numba's own folder where that cannot be written.
    """
    import numba

    njit: Any = numba.njit

    def decorate(function: Any) -> Any:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _cache_folder()  # pyright: ignore
        try:
            return njit(signature, cache=True, error_model="numpy")(function)
        except RuntimeError:  # numba finds no folder at all to keep it in
            return njit(signature, error_model="numpy")(function)
        finally:
            numba.config.CACHE_DIR = before  # pyright: ignore

    return decorate


@cache
def _cache_folder() -> str:
    """Return a folder named by all files with compiled functions and what they import; numba compares one."""
    root = Path(__file__).parents[1]
    imports = re.compile(rb"^from pedzoo\.([\w.]+) import", re.MULTILINE)
    loops = [
        text for path in sorted(root.rglob("*.py")) if b"core.compiled import" in (text := path.read_bytes())
    ]
    names = {name.decode() for text in loops for name in imports.findall(text)}
    files = [root.joinpath(*name.split(".")).with_suffix(".py") for name in sorted(names)]
    texts = [*loops, *(file.read_bytes() for file in files if file.is_file())]
    folder = root / "__pycache__" / f"numba-{hashlib.sha256(b''.join(texts)).hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return ""
    return str(folder) if os.access(folder, os.W_OK) else ""


jit = compiled()
"""For functions that other compiled functions call."""
