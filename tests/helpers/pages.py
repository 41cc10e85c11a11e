"""The pages that a user reads, and the code blocks in them."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text()
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
"""Their texts, by their paths."""


def blocks(page: str, language: str) -> list[str]:
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], re.DOTALL)


def commands(page: str) -> list[list[str]]:
    """Return the words of all ``pedzoo`` commands behind ``pedzoo``, in order."""
    lines = [line.partition("#")[0].strip() for block in blocks(page, "bash") for line in block.splitlines()]
    lines = [line.removeprefix("PYTHONPATH=. ") for line in lines]
    return [shlex.split(line)[1:] for line in lines if line.startswith("pedzoo ")]


def files(page: str) -> dict[str, str]:
    """Return the files that a page lets its reader write: blocks whose first line is ``# NAME``."""
    texts = [*blocks(page, "python"), *blocks(page, "yaml")]
    named = (re.match(r"# (\S+\.(?:py|yaml))\n", text) for text in texts)
    return {name[1]: text for name, text in zip(named, texts, strict=True) if name}


def snippets(page: str) -> list[str]:
    """Return the Python code that is not a file."""
    return [code for code in blocks(page, "python") if code not in files(page).values()]


def sentences(text: str) -> list[str]:
    """Return the sentences of a page's prose; a piece of code counts as one word, a Python file as none.

    Code blocks and tables are left out: they are no sentences, and most tables are generated.
    """
    prose = re.sub(r"```.*?```|^[|#][^\n]*|<!--.*?-->", "\n", text, flags=re.DOTALL | re.MULTILINE)
    prose = re.sub(r"`[\w/]+\.py`,?", "", prose)
    prose = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "code", prose))
    return [" ".join(one.split()) for one in re.split(r"(?<=[.?!])\s+|\n\s*\n|\n\s*(?=[-*] |\d+\. )", prose)]
