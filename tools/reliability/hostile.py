"""Hostile contents: sound ones with mistakes, and the question what a reader does with them."""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np

from pedzoo.core.errors import UserError
from tools.reliability.readers import Reader

ODD = (
    *(
        b"",
        b"\0",
        b"\xff\xfe",
        b"\n",
        b"nan",
        b"-inf",
        b"1e300",
        b"-1",
        b"9" * 40,
        b"1" * 5000,
        b"no",
        b"null",
    ),
    *(
        b"2026-11-99",
        b"*a",
        b"&a [*a]",
        b"[" * 50,
        b"{" * 50,
        b"!!python/name:os.system",
        b"/dev/zero",
        b"0x10",
    ),
    *(
        b"../../etc/passwd",
        b"x.py:C",
        b"\x1b[2J",
        b"'",
        b'"',
        b",",
        b":",
        b"+",
        b"=",
        b"%s",
        b"\xf0\x9f\x9a\xb6",
    ),
)
"""What is put between."""

SECONDS = 2.0
"""Of the processor that a reader may take, once it is warm: about 1 s on a quiet machine."""


def warm(reader: Reader, folder: Path) -> None:
    """Read the sound examples in an empty folder, with all the imports that this takes."""
    path = folder / reader.file
    for content in reader.examples():
        path.write_bytes(content)
        reader.read(path)
    for file in folder.iterdir():
        file.unlink()


def mistaken(content: bytes, draw: np.random.Generator) -> bytes:
    """Return a content with one to four mistakes: cuts, repeats, other bytes, odd values."""
    for _ in range(draw.integers(1, 5)):
        begin, end = sorted(draw.integers(0, len(content) + 1, 2).tolist())
        end = min(end, begin + int(draw.integers(1, 40)))
        match int(draw.integers(5)):
            case 0:
                content = content[:begin] + content[end:]
            case 1:
                content = content[:end] + content[begin:]
            case 2:
                content = content[:begin] + draw.bytes(end - begin) + content[end:]
            case 3:
                content = content[:begin] + ODD[draw.integers(len(ODD))] + content[end:]
            case _:
                content = content[:begin]
    return content


def complaint(reader: Reader, content: bytes, folder: Path) -> str | None:
    """Return what is wrong with how a reader takes a content; None where it reads or refuses it in words.

    Args:
        reader: The reader.
        content: What its file has.
        folder: An empty folder for the file; it is empty again afterwards.
    """
    path = folder / reader.file
    path.write_bytes(content)
    allowed = {reader.file, "plan.png"}
    began = time.process_time()
    try:
        with warnings.catch_warnings(action="ignore"):
            reader.read(path)
    except UserError as error:
        if len(str(error)) > 5000:
            return f"a long message: {len(str(error))} signs"
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {str(error)[:200]}"
    seconds = time.process_time() - began
    left = {file.name for file in folder.iterdir()}
    for file in folder.iterdir():
        file.unlink()
    if left - allowed:
        return f"wrote {sorted(left - allowed)}"
    return f"took {seconds:.1f} s" if seconds > SECONDS else None
